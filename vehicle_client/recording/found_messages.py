"""What the car found, was told and showed: boxes for Foxglove's 3D view, and JSON for whoever wants to understand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from contract.obstacle import ObstacleFeature
from detector.types import DetectedObstacle, FrameDetection
from vehicle_client.alerts import Alerts, Hazard
from vehicle_client.frames import Matrix, Vector, rigid, rotation_about_z
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.positioning.pose import Pose
from vehicle_client.recording.sensor_messages import pose as pose_message
from vehicle_client.recording.sensor_messages import timestamp
from vehicle_client.tracking import Track

OWN, TOLD = Color(r=0.9, g=0.2, b=0.1, a=0.6), Color(r=1.0, g=0.8, b=0.0, a=0.6)
"""Red is what this car's LiDAR sees (the paper's colour of a recognised obstacle), yellow what the server told."""

TRACK_HEIGHT_M = 0.1
"""Tracks carry no height; a flat box shows the place."""

TEXT_M = 0.5


def scene(time_ns: int, tracks: tuple[Track, ...], known: ObstacleMap, here: Pose | None) -> SceneUpdate:
    """Boxes in `odom`: confirmed tracks of what stands, and, where a pose places it, what the server told."""
    entities = [_track_box(time_ns, track) for track in tracks if track.confirmed and track.is_static]
    if here is not None:
        entities += [_told_box(time_ns, entry.feature, here) for entry in known.obstacles.values()]
    clear = SceneEntityDeletion(timestamp=timestamp(time_ns), type=SceneEntityDeletion.ALL)
    return SceneUpdate(deletions=[clear], entities=entities)


def detections_json(detection: FrameDetection, found: Sequence[DetectedObstacle]) -> dict[str, object]:
    """Obstacles of the sweep alone and of the last ones together, in `sensor`, and whether a road was seen at all."""
    return {
        "road_seen": detection.road_seen,
        "of_the_sweep": [_detected(o) for o in detection.obstacles],
        "found": [_detected(o) for o in found],
    }


def alerts_json(alerts: Alerts) -> dict[str, object]:
    """What the driver was shown."""
    return {"fresh": alerts.fresh, "chime": alerts.chime, "hazards": [_hazard(h) for h in alerts.hazards]}


def pose_json(here: Pose | None, reason: str | None) -> dict[str, object]:
    """What the pose said, if there was one, and why nothing may be reported or shown with it."""
    if here is None:
        return {"known": False, "reason": reason}
    return {
        "known": True,
        "reason": reason,
        "latitude_deg": here.position.latitude_deg,
        "longitude_deg": here.position.longitude_deg,
        "altitude_m": here.altitude_m,
        "heading_rad": here.heading_rad,
        "sd_m": here.sd_m,
        "speed_mps": here.speed_mps,
    }


def _detected(found: DetectedObstacle) -> dict[str, object]:
    return {
        "kind": found.kind.value,
        "centre_m": [float(v) for v in found.centre_m],
        "length_m": float(found.length_m),
        "width_m": float(found.width_m),
        "yaw_rad": float(found.yaw_rad),
        "relief_m": float(found.relief_m),
        "confidence": float(found.confidence),
        "hits": int(found.hits),
    }


def _hazard(hazard: Hazard) -> dict[str, object]:
    return {
        "kind": hazard.kind.value,
        "stage": hazard.stage.name.lower(),
        "distance_m": float(hazard.distance_m),
        "arrival_s": float(hazard.arrival_s),
        "obstacle_id": None if hazard.obstacle_id is None else str(hazard.obstacle_id),
        "track_id": hazard.track_id,
    }


def _track_box(time_ns: int, track: Track) -> SceneEntity:
    size = (track.length_m, track.width_m, TRACK_HEIGHT_M)
    name = f"track-{track.track_id}"
    return _box(time_ns, name, f"{track.kind.value} {track.sightings}x", track.centre_odom_m, track.yaw_rad, size, OWN)


def _told_box(time_ns: int, feature: ObstacleFeature, here: Pose) -> SceneEntity:
    box = feature.properties.box
    vehicle = here.in_vehicle(feature.position, feature.properties.altitude_m)
    odom_from_vehicle = here.odom_from_vehicle
    centre = odom_from_vehicle[:3, :3] @ vehicle + odom_from_vehicle[:3, 3]
    yaw = box.yaw_rad - math.atan2(here.enu_from_odom[1, 0], here.enu_from_odom[0, 0])
    size = (box.length_mm / 1000, box.width_mm / 1000, max(box.relief_mm / 1000, 0.01))
    return _box(time_ns, str(feature.id), feature.properties.kind.value, centre, yaw, size, TOLD)


def _box(
    time_ns: int,
    name: str,
    text: str,
    centre: Vector,
    yaw_rad: float,
    size_m: tuple[float, float, float],
    colour: Color,
) -> SceneEntity:
    at: Matrix = rigid(rotation_about_z(yaw_rad), np.asarray(centre, dtype=np.float64))
    above = rigid(np.eye(3), at[:3, 3] + [0.0, 0.0, 1.0])
    x, y, z = (float(v) for v in size_m)
    label = TextPrimitive(pose=pose_message(above), billboard=True, font_size=TEXT_M, color=colour, text=text)
    return SceneEntity(
        timestamp=timestamp(time_ns),
        frame_id="odom",
        id=name,
        cubes=[CubePrimitive(pose=pose_message(at), size=Vector3(x=x, y=y, z=z), color=colour)],
        texts=[label],
    )
