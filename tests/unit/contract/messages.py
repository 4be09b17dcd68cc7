"""Arbitrary valid messages, for hypothesis."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from hypothesis import strategies as st

from contract.events import MAX_RADIUS_M, MIN_RADIUS_M, Appeared, Left, Moved, Position, Removed, Snapshot, Updated
from contract.geometry import Box, BoxSd, Kind, LatLon, Message, PlaneCovariance
from contract.observation import (
    DecisionKind,
    Descriptor,
    Detection,
    DetectionResult,
    Inspection,
    InspectionResult,
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    Origin,
    Outcome,
    ReportResult,
    ReportStatus,
    State,
    View,
)
from contract.obstacle import ObstacleCollection, ObstacleFeature, ObstacleProperties, PointGeometry

uuids = st.uuids()
revisions = st.integers(1, 10**9)
names = st.from_regex(r"\A[A-Za-z0-9][A-Za-z0-9._:-]{0,63}\Z")
times = st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1), timezones=st.just(UTC))


def reals(least: float, greatest: float) -> st.SearchStrategy[float]:
    return st.floats(least, greatest)


positions = st.builds(LatLon, latitude_deg=reals(-90, 90), longitude_deg=reals(-180, 180))


@st.composite
def covariances(draw: st.DrawFn) -> PlaneCovariance:
    east, north, correlation = draw(reals(0, 1e3)), draw(reals(0, 1e3)), draw(reals(-1, 1))
    return PlaneCovariance(
        east_m2=east**2, north_m2=north**2, east_north_m2=correlation * east * north if east**2 * north**2 else 0.0
    )


@st.composite
def boxes(draw: st.DrawFn) -> Box:
    length_mm = draw(st.integers(1, 50_000))
    return Box(
        length_mm=length_mm,
        width_mm=draw(st.integers(1, length_mm)),
        yaw_rad=draw(st.floats(0, math.pi, exclude_max=True)),
        relief_mm=draw(st.integers(0, 10_000)),
    )


box_sds = st.builds(BoxSd, ln_length=reals(0, 3), ln_width=reals(0, 3), ln_area=reals(0, 3), relief_mm=reals(0, 5_000))
views = st.builds(
    View,
    front=st.booleans(),
    rear=st.booleans(),
    hits=st.integers(1, 10_000_000),
    frames=st.integers(1, 100_000),
    least_range_m=reals(0, 500),
)
descriptors = st.builds(
    Descriptor,
    name=names,
    version=st.integers(1, 1_000),
    values=st.dictionaries(names, st.floats(allow_nan=False, allow_infinity=False), max_size=4),
)
centimetres = st.integers(-5_000, 5_000)
detections = st.builds(
    Detection,
    kind=st.sampled_from(Kind),
    east_m=reals(-500, 500),
    north_m=reals(-500, 500),
    up_m=reals(-100, 100),
    covariance=covariances(),
    box=boxes(),
    box_sd=box_sds,
    volume_m3=reals(0, 1_000),
    confidence=reals(0, 1),
    view=views,
    descriptor=descriptors,
    points_cm=st.lists(st.tuples(centimetres, centimetres, centimetres), max_size=4).map(tuple),
)
origins = st.builds(
    Origin,
    position=positions,
    altitude_m=reals(-1_000, 10_000),
    altitude_sd_m=reals(0, 1_000),
    heading_rad=st.floats(0, 2 * math.pi, exclude_max=True),
    covariance=covariances(),
)
inspections = st.builds(Inspection, obstacle_id=uuids, outcome=st.sampled_from(Outcome), visible_fraction=reals(0, 1))
reports = st.builds(
    ObservationReport,
    report_id=uuids,
    observed_at=times,
    pseudonym=names,
    sensor=names,
    estimator=names,
    origin=origins,
    detections=st.lists(detections, max_size=2).map(tuple),
    inspections=st.lists(inspections, max_size=2).map(tuple),
)
batches = st.builds(ObservationBatch, sent_at=times, reports=st.lists(reports, min_size=1, max_size=2).map(tuple))
detection_results = st.builds(
    DetectionResult,
    decision=st.sampled_from(DecisionKind),
    reason=st.text(),
    obstacle_id=st.none() | uuids,
    version=st.none() | revisions,
    revision=st.none() | revisions,
    state=st.none() | st.sampled_from(State),
    position=st.none() | positions,
    position_sd_m=st.none() | reals(0, 100),
    box=st.none() | boxes(),
)
inspection_results = st.builds(
    InspectionResult, obstacle_id=uuids, counted=st.booleans(), why=st.text(), removed=st.booleans()
)
report_results = st.builds(
    ReportResult,
    report_id=uuids,
    status=st.sampled_from(ReportStatus),
    reason=st.none() | st.text(),
    detections=st.lists(detection_results, max_size=2).map(tuple),
    inspections=st.lists(inspection_results, max_size=2).map(tuple),
)
batch_results = st.builds(ObservationBatchResult, results=st.lists(report_results, max_size=2).map(tuple))


@st.composite
def features(draw: st.DrawFn) -> ObstacleFeature:
    kind = draw(st.sampled_from(Kind))
    properties = ObstacleProperties(
        kind=kind,
        sign=kind.sign,
        state=draw(st.sampled_from(State)),
        version=draw(revisions),
        revision=draw(revisions),
        box=draw(boxes()),
        box_sd=draw(box_sds),
        volume_m3=draw(reals(0, 1_000)),
        position_covariance=draw(covariances()),
        altitude_m=draw(reals(-1_000, 10_000)),
        confidence=draw(reals(0, 1)),
        as_of=draw(times),
        half_life_s=draw(reals(1, 1e9)),
        expires_at=draw(times),
        first_seen=draw(times),
        last_seen=draw(times),
        sightings=draw(revisions),
        witnesses=draw(revisions),
        succeeds=draw(st.none() | uuids),
        merged_into=draw(st.none() | uuids),
    )
    return ObstacleFeature(id=draw(uuids), geometry=PointGeometry.at(draw(positions)), properties=properties)


several_features = st.lists(features(), max_size=2).map(tuple)
numbers = st.integers(1, 2**40)
server_messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(Snapshot, position_seq=numbers, obstacles=several_features),
    st.builds(Moved, position_seq=numbers),
    st.builds(Appeared, position_seq=numbers, obstacle=features()),
    st.builds(Updated, position_seq=numbers, obstacle=features()),
    st.builds(
        Removed,
        position_seq=numbers,
        obstacle_id=uuids,
        revision=revisions,
        reason=st.sampled_from(["absent", "merged", "expired", "operator"]),
        merged_into=st.none() | uuids,
    ),
    st.builds(Left, position_seq=numbers, obstacle_id=uuids),
)
any_message: st.SearchStrategy[Message] = st.one_of(
    batches,
    batch_results,
    features(),
    st.builds(ObstacleCollection, features=several_features),
    st.builds(Position, position_seq=numbers, position=positions, radius_m=reals(MIN_RADIUS_M, MAX_RADIUS_M)),
    server_messages,
)
