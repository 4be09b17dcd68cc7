from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from simulator.mesh import box, pose
from simulator.motion import Standing
from simulator.scene.mover import Model, Mover
from simulator.scene.scenery import Part, Surface
from simulator.sensors.beam import Beam, _strongest_echo
from simulator.sensors.lidar import Laser, LidarModel, azimuths
from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.sensors.returns import REFLECTIVITY, CarlaReturns, MeasuredReturns, reflectivity_table
from simulator.streets.street import Street, fill, first_light_street
from simulator.world import World

HOLE_X_M = first_light_street(seed=3).obstacle(1).x_m
STREET_FROM_SENSOR = pose(HOLE_X_M - 6.0, -1.75, 2.36, yaw_rad=0.05, roll_rad=0.02)
EXACT = LidarModel(range_sd_m=0.0)


def in_street(points_m: np.ndarray) -> np.ndarray:
    return points_m.astype(np.float64) @ STREET_FROM_SENSOR[:3, :3].T + STREET_FROM_SENSOR[:3, 3]


def test_a_turn_has_the_papers_number_of_rays() -> None:
    assert len(azimuths(LidarModel(), 0.0)) * 64 == pytest.approx(800_000 / 30, rel=0.005)


def test_rings_lie_at_their_elevations_from_below_to_above(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    points = sweep.points_m.astype(np.float64)
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    assert elevation == pytest.approx(EXACT.elevations_rad[sweep.ring], abs=1e-5)
    assert np.degrees(EXACT.elevations_rad[[0, -1]]) == pytest.approx([-30, 10])
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    assert np.cos(azimuth - sweep.azimuth_rad) == pytest.approx(np.ones(len(points)), abs=1e-6)


def test_only_returns_within_range_are_given(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    assert len(sweep.points_m) < 64 * EXACT.columns
    assert np.linalg.norm(sweep.points_m, axis=1).max() <= EXACT.range_m + 0.01
    assert np.isfinite(sweep.points_m).all()
    assert Surface.NOTHING not in sweep.surface


def test_the_pothole_is_labelled_where_it_is_and_lies_below_the_road(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(1))
    points = in_street(sweep.points_m)
    hole = world.street.obstacle(1)
    labelled = sweep.obstacle_id == 1
    assert labelled.sum() > 20
    assert hole.covers(points[labelled, 0], points[labelled, 1]).mean() > 0.97
    height = points[:, 2] - world.street.sound_height(points[:, 0].astype(float), points[:, 1].astype(float))
    assert (height[labelled] < 0.015).all()
    assert height[labelled].min() < -0.5 * hole.shape.relief_m
    road = (sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)
    assert np.abs(height[road]).max() < 0.03


def test_bump_and_debris_are_labelled_above_the_road(world: World) -> None:
    for number, x in ((2, 236.0), (3, 259.0)):
        at = pose(x, -1.75, 2.36)
        sweep = world.sweep(EXACT, Standing(at), 0.0, np.random.default_rng(1))
        points = sweep.points_m[sweep.obstacle_id == number] + at[:3, 3]
        height = points[:, 2] - world.street.sound_height(points[:, 0].astype(float), points[:, 1].astype(float))
        assert len(points) > 10
        assert height.max() > 0.6 * world.street.obstacle(number).shape.relief_m
        assert height.min() > -0.01


def test_points_on_the_road_see_its_crown(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(1))
    points = in_street(sweep.points_m)[(sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)]
    slope = np.polyfit(np.abs(points[:, 1]), points[:, 2], 1)[0]
    assert slope == pytest.approx(-world.street.main.section.crown_slope, abs=0.002)


def test_the_range_noise_is_as_wide_as_stated(world: World) -> None:
    exact = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(5))
    noisy = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(5))
    error = np.linalg.norm(noisy.points_m, axis=1) - np.linalg.norm(exact.points_m, axis=1)
    assert error.std() == pytest.approx(0.01, rel=0.03)
    assert abs(error.mean()) < 3 * 0.01 / np.sqrt(len(error))


def test_the_same_seed_gives_the_same_bytes_and_each_turn_another_phase(world: World) -> None:
    one = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(7))
    again = World(first_light_street(seed=3)).sweep(
        LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(7)
    )
    other = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(8))
    for field in dataclasses.fields(one):
        assert getattr(one, field.name).tobytes() == getattr(again, field.name).tobytes()
    assert one.azimuth_rad[0] != other.azimuth_rad[0]


def test_a_filled_pothole_has_no_label_and_no_depth(world: World) -> None:
    street = fill(fill(world.street, 1), 3)
    repaired = World(street)
    for at, number in ((STREET_FROM_SENSOR, 1), (pose(257.0, -1.75, 2.36), 3)):
        sweep = repaired.sweep(EXACT, Standing(at), 0.0, np.random.default_rng(1))
        assert number not in sweep.obstacle_id
        points = sweep.points_m @ at[:3, :3].T + at[:3, 3]
        there = street.obstacle(number).covers(*points[:, :2].T) & (points[:, 2] < 1.0)
        assert there.sum() > 10
        assert (
            np.abs(
                points[there, 2] - street.sound_height(points[there, 0].astype(float), points[there, 1].astype(float))
            ).max()
            < 0.02
        )


def test_a_street_without_obstacles_can_be_scanned() -> None:
    sweep = World(Street(seed=1)).sweep(LidarModel(), Standing(pose(10.0, 0.0, 2.4)), 0.0, np.random.default_rng(0))
    assert not sweep.obstacle_id.any()
    assert len(sweep.points_m) > 10_000


FLAT = LidarModel(range_sd_m=0.0, rolling=True, rate_hz=10.0, points_per_second=200_000)


@dataclasses.dataclass(frozen=True)
class Sliding:
    """Along the street's x at a constant speed from a pose at time 0."""

    street_from_start: np.ndarray
    speed_mps: float

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        poses = np.tile(self.street_from_start, (len(time_s), 1, 1))
        poses[:, 0, 3] += self.speed_mps * time_s
        return poses


@pytest.mark.parametrize("clockwise", [True, False])
@given(phase=st.floats(0, 0.999))
def test_a_turn_begins_and_ends_behind_the_car_and_goes_once_round(clockwise: bool, phase: float) -> None:
    lidar = LidarModel(clockwise=clockwise)
    azimuth, step = azimuths(lidar, phase), 2 * np.pi / lidar.columns
    assert np.diff(azimuth) == pytest.approx(np.full(lidar.columns - 1, -step if clockwise else step))
    assert np.abs(azimuth[[0, -1]]).min() >= np.pi - step - 1e-9
    assert np.abs(azimuth).max() <= np.pi


def test_times_lie_before_the_stamp_and_the_last_column_at_it(world: World) -> None:
    sweep = world.sweep(FLAT, Standing(STREET_FROM_SENSOR), 5.0, np.random.default_rng(0))
    assert sweep.time_offset_s.max() == 0
    assert -0.1 < sweep.time_offset_s.min() < -0.099
    assert (np.diff(sweep.time_offset_s) >= 0).all()
    at_once = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 5.0, np.random.default_rng(0))
    assert not at_once.time_offset_s.any()


def test_a_moving_sensor_distorts_its_turn_as_each_columns_own_place_says(world: World) -> None:
    motion = Sliding(STREET_FROM_SENSOR, 15.0)
    sweep = world.sweep(FLAT, motion, 2.0, np.random.default_rng(0))
    poses = motion.poses(2.0 + sweep.time_offset_s.astype(np.float64))
    points = (poses[:, :3, :3] @ sweep.points_m[:, :, None])[:, :, 0] + poses[:, :3, 3]
    road = (sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)
    height = points[road, 2] - world.street.sound_height(points[road, 0], points[road, 1])
    assert np.abs(height).max() < 0.03
    # As if all were fired at the end: what lies on the road's wall moves by the way driven since.
    late = points[:, 0] - (poses[-1, :3, :3] @ sweep.points_m.T)[0] - poses[-1, 0, 3]
    assert late.min() == pytest.approx(15.0 * sweep.time_offset_s.min(), abs=1e-3)


@pytest.mark.parametrize("name", ["hdl64", "hdl32"])
def test_points_lie_on_their_lasers_cones(world: World, name: str) -> None:
    lidar = LIDAR_PRESETS[name]()
    sweep = world.sweep(lidar, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    points = sweep.points_m.astype(np.float64)
    above = points[:, 2] - lidar.heights_m[sweep.ring]
    elevation = np.arctan2(above, np.hypot(points[:, 0], points[:, 1]))
    assert elevation == pytest.approx(lidar.elevations_rad[sweep.ring], abs=1e-5)
    assert (np.diff(lidar.elevations_rad) > 0).all()
    assert len(np.unique(sweep.ring)) == lidar.channels


def test_what_is_reported_agrees_with_the_truth_beside_it(world: World) -> None:
    sweep = world.sweep(LIDAR_PRESETS["hdl64"](), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    assert ((sweep.intensity >= 0) & (sweep.intensity <= 1)).all()
    assert ((sweep.cos_incidence >= 0) & (sweep.cos_incidence <= 1)).all()
    assert Surface.NOTHING not in sweep.surface
    road = (sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)
    flat = -sweep.points_m[road, 2] / np.linalg.norm(sweep.points_m[road], axis=1)
    assert np.median(np.abs(sweep.cos_incidence[road] - flat)) < 0.06  # the sensor is tilted by 0.02 rad
    hole = world.street.obstacle(1)
    inside = in_street(sweep.points_m)[sweep.obstacle_id == 1]
    assert len(inside) > 50
    assert hole.covers(inside[:, 0], inside[:, 1]).mean() > 0.95


def test_a_beam_at_an_edge_reports_a_surface_or_a_mixture_of_near_ones(world: World) -> None:
    line = dataclasses.replace(EXACT, channels=64, points_per_second=3_000_000)
    wide = dataclasses.replace(line, beam=Beam(divergence_rad=0.003, echo_separation_m=0.75))
    one = world.sweep(line, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    other = world.sweep(wide, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    both = {(a, b): i for i, (a, b) in enumerate(zip(one.azimuth_rad, one.ring, strict=True))}
    pairs = np.array(
        [(both[key], j) for j, key in enumerate(zip(other.azimuth_rad, other.ring, strict=True)) if key in both]
    )
    ranges = [np.linalg.norm(s.points_m[k], axis=1) for s, k in zip((one, other), pairs.T, strict=True)]
    apart = np.abs(ranges[1] - ranges[0])
    assert (apart < 0.002).mean() > 0.9
    mixed = (apart > 0.01) & (apart < 0.75)
    jumped = apart > 0.75
    assert mixed.sum() > 50
    assert jumped.sum() > 20
    assert (jumped.mean(), mixed.mean()) < (0.02, 0.05)


def test_the_strongest_of_two_far_echoes_is_reported_and_near_ones_are_averaged() -> None:
    rim = np.full(6, 10.4, dtype=np.float32)
    power = np.full(1, 1.0, dtype=np.float32)
    for apart_m, expected in ((0.75, 10.2), (0.3, 10.0)):
        range_m, strength, winner = _strongest_echo(
            np.array([10.0], dtype=np.float32), power * 1.2, rim, np.repeat(power, 6), apart_m
        )
        assert range_m[0] == pytest.approx(expected, abs=0.03)
        assert strength[0] == pytest.approx(1.1 if apart_m == 0.75 else 0.6)
        assert winner[0] == -1
    nothing = np.full(1, np.inf, dtype=np.float32)
    range_m, strength, winner = _strongest_echo(nothing, power * 0, rim, np.repeat(power, 6), 0.75)
    assert range_m[0] == pytest.approx(10.4)
    assert strength[0] == pytest.approx(0.5)
    assert 0 <= winner[0] < 6
    range_m, strength, _ = _strongest_echo(nothing, power * 0, np.repeat(nothing, 6), np.repeat(power * 0, 6), 0.75)
    assert np.isinf(range_m[0])
    assert strength[0] == 0


def test_carlas_dropoff_loses_the_stated_shares() -> None:
    near, far = np.full(40_000, 10.0, dtype=np.float32), np.full(40_000, 90.0, dtype=np.float32)
    returns = CarlaReturns(0.004, general_dropoff=0.2, dropoff_intensity_limit=0.8, zero_intensity_dropoff=0.5)
    for range_m, passed in ((near, 0.8), (far, 0.8 * (0.5 + 0.5 / 0.8 * np.exp(-0.36)))):
        intensity, kept = returns.receive(range_m, range_m, np.random.default_rng(0))
        assert intensity[0] == pytest.approx(np.exp(-0.004 * range_m[0]))
        assert kept.mean() == pytest.approx(passed, abs=0.01)
    assert CarlaReturns().receive(far, far, np.random.default_rng(0))[1].all()


@given(reflectivity=st.floats(0.02, 1), range_m=st.floats(1, 200))
def test_a_target_is_seen_half_of_the_time_at_the_reach_that_its_reflectivity_gives(
    reflectivity: float, range_m: float
) -> None:
    returns = MeasuredReturns(reach_m=50.0, fluctuation=0.5, gain=1.0)
    ranges = np.full(4_000, range_m, dtype=np.float32)
    power = np.full(4_000, reflectivity / range_m**2, dtype=np.float32)
    intensity, kept = returns.receive(ranges, power, np.random.default_rng(0))
    reach_m = 50 * np.sqrt(reflectivity / 0.1)
    expected = ndtr(2 * np.log(reach_m / range_m) / 0.5)
    assert kept.mean() == pytest.approx(expected, abs=0.04)
    if kept.all() and reflectivity < 0.1:
        assert np.median(intensity) == pytest.approx(reflectivity, rel=0.05)


def test_every_surface_but_nothing_gives_something_back() -> None:
    table = reflectivity_table()
    assert table[Surface.NOTHING] == 0
    assert (table[1:] > 0).all()
    assert set(Surface) == set(REFLECTIVITY)


@pytest.mark.parametrize(
    "fields",
    [
        {"channels": 0},
        {"rate_hz": 0.0},
        {"range_m": -1.0},
        {"near_m": 200.0},
        {"range_sd_m": np.nan},
        {"points_per_second": 10},
        {"lasers": (Laser(0.0),)},
    ],
)
def test_impossible_sensors_are_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="LiDAR"):
        LidarModel(**fields)  # type: ignore[arg-type]


def test_a_moving_thing_is_seen_where_it_is_at_each_columns_time_and_the_carrier_not_at_all() -> None:
    box_m, speed_mps = 4.0, 20.0
    model = Model((Part(Surface.CAR, box(box_m, 2.0, 1.6)),), middle_m=0.8, radius_m=2.5)
    car = Mover(7, model, Sliding(pose(30.0, 1.75, 0.0), speed_mps))
    world = World(Street(seed=1), [car])
    rolling = dataclasses.replace(EXACT, rolling=True, rate_hz=10.0, points_per_second=400_000)
    stands = pose(20.0, -1.75, 2.0)
    sweep = world.sweep(rolling, Standing(stands), 0.3, np.random.default_rng(0))
    on_car = sweep.mover_id == 7
    assert on_car.sum() > 30
    assert set(sweep.surface[on_car]) == {Surface.CAR}
    middle_m = 30.0 + speed_mps * (0.3 + sweep.time_offset_s[on_car].astype(float))
    along_m = sweep.points_m[on_car, 0] + 20.0 - middle_m
    assert np.abs(along_m).max() < box_m / 2 + 0.01
    carried = world.sweep(rolling, Standing(stands), 0.3, np.random.default_rng(0), ignored_mover=7)
    assert not carried.mover_id.any()
