"""What operators' actions make of an obstacle."""

from __future__ import annotations

from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.history import Confirm, Dismiss, Inspect, Repaired
from contract.observation import State
from contract.obstacle import InspectionState
from server.errors import ObstacleRemovedError
from server.life.obstacle import Obstacle
from server.life.operating import Deed, decide
from tests.unit.server.making import NOON, Road, detection

CONFIRM, DISMISS, REPAIRED = Confirm(action="confirm"), Dismiss(action="dismiss"), Repaired(action="repaired")
deeds = st.one_of(
    st.sampled_from([CONFIRM, DISMISS, REPAIRED, "delete"]),
    st.builds(Inspect, action=st.just("inspection_state"), inspection_state=st.sampled_from(InspectionState)),
)


def candidate() -> Obstacle:
    road = Road()
    seen = detection().model_copy(update={"points_cm": ((1, 2, 3), (4, 5, 6))})
    road.sees("ego1", NOON - timedelta(hours=1), seen)
    return road.only


def after(*done: Deed) -> Obstacle:
    obstacle = candidate()
    for number, deed in enumerate(done):
        obstacle = decide(obstacle, deed, NOON + timedelta(minutes=number))
    return obstacle


@given(st.lists(deeds, max_size=4), deeds)
def test_the_same_action_again_changes_nothing(before: list[Deed], deed: Deed) -> None:
    obstacle = candidate()
    for earlier in [*before, deed]:
        try:
            obstacle = decide(obstacle, earlier, NOON)
        except ObstacleRemovedError:
            assert obstacle.state is State.REMOVED
            return
    assert decide(obstacle, deed, NOON + timedelta(days=1)) is obstacle


@given(st.lists(deeds, max_size=5))
def test_a_revision_is_counted_for_every_change_and_nothing_comes_back(done: list[Deed]) -> None:
    obstacle = candidate()
    for deed in done:
        try:
            changed = decide(obstacle, deed, NOON)
        except ObstacleRemovedError:
            continue
        assert changed.revision == obstacle.revision + (0 if changed is obstacle else 1)
        assert changed.is_live <= obstacle.is_live
        assert changed.version == obstacle.version
        obstacle = changed


def test_a_confirmed_obstacle_has_been_inspected() -> None:
    confirmed = after(CONFIRM)
    assert (confirmed.state, confirmed.inspection_state) == (State.CONFIRMED, InspectionState.INSPECTED)
    scheduled = Inspect(action="inspection_state", inspection_state=InspectionState.SCHEDULED)
    assert after(scheduled, CONFIRM).inspection_state is InspectionState.SCHEDULED


@pytest.mark.parametrize(
    ("deed", "inspection_state"),
    [(DISMISS, InspectionState.NOT_AN_ISSUE), (REPAIRED, InspectionState.REPAIRED), ("delete", InspectionState.OPEN)],
)
def test_three_ways_of_removing(deed: Deed, inspection_state: InspectionState) -> None:
    gone = after(deed)
    assert (gone.state, gone.removed_reason, gone.removed_at) == (State.REMOVED, "operator", NOON)
    assert gone.inspection_state is inspection_state


def test_only_deleting_erases_what_was_measured() -> None:
    assert len(after(REPAIRED).shape.points_cm) == 2
    erased = after(REPAIRED, "delete").shape
    assert (erased.points_cm, erased.descriptor.values) == ((), {})
    assert erased.box == candidate().shape.box


def test_a_removed_obstacle_is_not_confirmed_and_keeps_why_it_went() -> None:
    absent = candidate()._replace(state=State.REMOVED, removed_at=NOON - timedelta(minutes=5), removed_reason="absent")
    with pytest.raises(ObstacleRemovedError):
        decide(absent, CONFIRM, NOON)
    dismissed = decide(absent, DISMISS, NOON)
    assert (dismissed.removed_reason, dismissed.removed_at) == ("absent", absent.removed_at)
    assert dismissed.inspection_state is InspectionState.NOT_AN_ISSUE
