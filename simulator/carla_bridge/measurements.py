"""What CARLA's sensors hand over, as our readings: bytes become arrays, left-handed becomes right-handed.

Layouts of the bytes: CARLA's documentation, "Sensors reference" (0.9.16).
"""

from __future__ import annotations

import logging
import math

import carla
import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from simulator.readings import GnssReading, ImageReading, ImuReading, LidarReading, Reading, SensorName, Sweep
from simulator.recording.handedness import CarlaTransform, mirrored_points, right_handed_transform
from simulator.recording.semantic_tags import TAGS_FROM
from simulator.sensors.gnss import CarlaGnss
from simulator.sensors.sensor_config import RigSensor
from simulator.streets.street import GeoReference

LOG = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

SEMANTIC_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("cosine", "<f4"), ("object", "<u4"), ("tag", "<u4")]
)

DEFAULT_PLACE_DEG = (42.0, 2.0)
"""Where CARLA puts maps whose georeference it cannot read."""

LEAST_SD_M = 0.01
"""What a receiver without noise states: a weight of infinity helps nobody."""


def reading_of(sensor: RigSensor, data: carla.SensorData, carla_map: carla.Map, origin: GeoReference) -> Reading:
    """A measurement of a sensor of the rig; the time of fixes and inertia is CARLA's."""
    name, street_from_sensor = sensor.name, street_from(data.transform)
    match name.type:
        case "sensor.lidar.ray_cast":
            return LidarReading(name, street_from_sensor, lidar_sweep(data))
        case "sensor.lidar.ray_cast_semantic":
            return LidarReading(name, street_from_sensor, semantic_sweep(data))
        case "sensor.camera.rgb":
            return ImageReading(name, street_from_sensor, np.ascontiguousarray(_pixels(data)[..., :3]))
        case "sensor.camera.semantic_segmentation":
            return ImageReading(name, street_from_sensor, np.ascontiguousarray(_pixels(data)[..., 2]))
        case "sensor.other.gnss":
            return _fix(sensor, data, carla_map, origin)
    return _inertia(name, data)


def street_from(transform: carla.Transform) -> FloatArray:
    """(4, 4) right-handed pose of a CARLA transform in its world."""
    place, turn = transform.location, transform.rotation
    return right_handed_transform(CarlaTransform(place.x, place.y, place.z, turn.pitch, turn.yaw, turn.roll))


def lidar_sweep(data: carla.LidarMeasurement) -> Sweep:
    """A turn of the ray-cast LiDAR: x, y, z, intensity as float32, channel by channel."""
    rows = np.frombuffer(data.raw_data, dtype="<f4").reshape(-1, 4)
    nothing = np.zeros(len(rows), dtype=np.float32)
    return _sweep(data, rows[:, :3], rows[:, 3].copy(), nothing, nothing.astype(np.uint8), nothing.astype(np.int32))


def semantic_sweep(data: carla.SemanticLidarMeasurement) -> Sweep:
    """A turn of the semantic LiDAR: its objects are moving things to us, its tags surfaces from `TAGS_FROM` on."""
    points = np.frombuffer(data.raw_data, dtype=SEMANTIC_POINT)
    places = np.stack([points["x"], points["y"], points["z"]], axis=1)
    surface = (np.minimum(points["tag"], 127) + TAGS_FROM).astype(np.uint8)
    intensity = np.zeros(len(points), dtype=np.float32)
    return _sweep(data, places, intensity, points["cosine"].copy(), surface, points["object"].astype(np.int32))


def _sweep(
    data: carla.LidarMeasurement,
    left_handed_m: NDArray[np.float32],
    intensity: NDArray[np.float32],
    cosine: NDArray[np.float32],
    surface: NDArray[np.uint8],
    mover_id: NDArray[np.int32],
) -> Sweep:
    points = mirrored_points(left_handed_m)
    # CARLA's channel 0 looks up most, our ring 0 looks down most.
    counts = [data.get_point_count(channel) for channel in range(data.channels)]
    ring = np.repeat(np.arange(data.channels - 1, -1, -1, dtype=np.uint16), counts)
    return Sweep(
        points_m=points,
        ring=ring,
        azimuth_rad=np.arctan2(points[:, 1], points[:, 0]),
        time_offset_s=np.zeros(len(points), dtype=np.float32),  # CARLA casts a whole turn at the tick
        intensity=intensity,
        cos_incidence=cosine,
        surface=surface,
        obstacle_id=np.zeros(len(points), dtype=np.int32),
        mover_id=mover_id,
    )


def _pixels(image: carla.Image) -> NDArray[np.uint8]:
    """(H, W, 4) BGRA."""
    return np.frombuffer(image.raw_data, dtype=np.uint8).reshape(image.height, image.width, 4)


def _fix(sensor: RigSensor, data: carla.GnssMeasurement, carla_map: carla.Map, origin: GeoReference) -> GnssReading:
    """The fix where it belongs: CARLA takes its y, which points south, for north."""
    stated = carla.GeoLocation(data.latitude, data.longitude, data.altitude)
    place = carla_map.geolocation_to_transform(stated)
    position, altitude_m = origin.geodetic_from_enu(np.array([place.x, -place.y, place.z]))
    model = sensor.model.at(data.latitude) if isinstance(sensor.model, CarlaGnss) else None
    east, north, up = model.total_sd_m.tolist() if model else (0.0, 0.0, 0.0)
    sd_m, altitude_sd_m = max(east, north, LEAST_SD_M), max(up, LEAST_SD_M)
    return GnssReading(sensor.name, data.timestamp, position, altitude_m, sd_m, altitude_sd_m)


def _inertia(name: SensorName, data: carla.IMUMeasurement) -> ImuReading:
    """Mirroring y turns rotations about x and z round, and keeps those about y."""
    force, rate = data.accelerometer, data.gyroscope
    compass = data.compass % (2 * math.pi)
    return ImuReading(
        name, data.timestamp, np.array([force.x, -force.y, force.z]), np.array([-rate.x, rate.y, -rate.z]), compass
    )


def map_origin(carla_map: carla.Map) -> GeoReference:
    """Where the map's origin lies, with a warning where it is only CARLA's default."""
    place = carla_map.transform_to_geolocation(carla.Location(0.0, 0.0, 0.0))
    if math.hypot(place.latitude - DEFAULT_PLACE_DEG[0], place.longitude - DEFAULT_PLACE_DEG[1]) < 1e-6:
        LOG.warning("the map has no georeference that CARLA reads: the recording lies at latitude 42, longitude 2")
    return GeoReference(LatLon(latitude_deg=place.latitude, longitude_deg=place.longitude), place.altitude)
