"""Obstacles as they are served."""

from __future__ import annotations

from datetime import UTC, datetime
from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import Descriptor, State
from contract.obstacle import InspectionState
from server.life.obstacle import Obstacle, Place, Shape
from server.life.policy import COOPERATION
from server.storage.features import ObstacleEvent, event_of, feature_of, feature_text
from tests.unit.server.making import NOON, PATRAS, Road, detection

moments = st.datetimes(datetime(1, 1, 2), datetime(9000, 1, 1), timezones=st.just(UTC))
variances = st.floats(0, 1e6)
ids = st.uuids() | st.none()
places = st.builds(
    Place,
    position=st.builds(LatLon, latitude_deg=st.floats(-90, 90), longitude_deg=st.floats(-180, 180)),
    covariance=st.builds(PlaneCovariance, east_m2=variances, north_m2=variances),
    altitude_m=st.floats(-500, 9_000),
    altitude_sd_m=st.floats(0, 100),
)
shapes = st.builds(
    Shape,
    box=st.integers(1, 50_000).map(lambda side: Box(length_mm=side, width_mm=side, yaw_rad=side / 1e6, relief_mm=3)),
    box_sd=st.builds(
        BoxSd,
        ln_length=st.floats(0, 3),
        ln_width=st.floats(0, 3),
        ln_area=st.floats(0, 3),
        relief_mm=st.floats(0, 5_000),
    ),
    volume_m3=st.floats(-1e9, 1e9),
    descriptor=st.just(Descriptor(name="shape", version=1, values={})),
    points_cm=st.just(()),
    observed_at=moments,
)
obstacles = st.builds(
    Obstacle,
    id=st.uuids(),
    kind=st.sampled_from(Kind),
    state=st.sampled_from(State),
    version=st.integers(1, 2**31),
    revision=st.integers(1, 2**31),
    place=places,
    shape=shapes,
    references=st.just(()),
    pending=st.none(),
    born_at=st.just(PATRAS),
    kind_votes=st.just({}),
    evidence=st.just(()),
    confidence=st.floats(0, 1),
    as_of=moments,
    first_seen=moments,
    last_seen=moments,
    sightings=st.integers(1, 2**31),
    witness_count=st.integers(1, 2**31),
    succeeds=ids,
    merged_into=ids,
    removed_reason=st.sampled_from(("absent", "merged", "expired", "operator", None)),
    inspection_state=st.sampled_from(InspectionState),
)


@given(obstacles)
def test_the_text_of_a_feature_is_that_of_the_model_byte_for_byte(obstacle: Obstacle) -> None:
    assert feature_text(obstacle, COOPERATION.life) == feature_of(obstacle, COOPERATION.life).model_dump_json()


def test_an_event_tells_the_same_from_an_obstacle_and_from_its_logged_feature() -> None:
    road = Road()
    road.sees("ego1", NOON, detection())
    (obstacle,) = road.obstacles.values()
    gone = obstacle._replace(revision=2, removed_reason="merged", merged_into=UUID(int=7))
    made = event_of(gone, feature_text(gone, COOPERATION.life))
    logged = ObstacleEvent.of(feature_of(gone, COOPERATION.life))
    assert made.feature == logged.feature
    for name in ("obstacle_id", "revision", "position", "removed_reason", "merged_into"):
        assert getattr(made, name) == getattr(logged, name)
