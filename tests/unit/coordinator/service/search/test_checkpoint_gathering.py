"""Checkpoints: how far apart they lie, which ones follow, how their states are gathered, and what is stored."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_coordinator.service.search import checkpoint_schedule as checkpoints
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import States
from atoll_core.wire.messages.workers import Placement, Schedule
from atoll_core.wire.state_pieces import IslandState, split_states

STATES = {island: IslandState.of(bytes([island]) * 30) for island in range(4)}
PLACEMENT = Placement(
    incarnation=1,
    term=3,
    job="j",
    variable="x",
    workers=("a", "b", "a", "b"),
    epoch=16,
    epochs=100,
    interval=8,
    commit_order=CommitOrder(generations=100, stride=10, joining=8),
)


@given(st.floats(1e-4, 1e3), st.integers(0, 10**10), st.integers(4, 1000))
def test_checkpoints_cost_no_more_than_their_share_unless_epochs_are_long(
    epoch_s: float, size: int, former: int
) -> None:
    interval = checkpoints.interval_of(epoch_s, size, former)
    assert checkpoints.LEAST_INTERVAL <= interval <= max(checkpoints.LEAST_INTERVAL, checkpoints.MOST_GROWTH * former)
    if interval not in (checkpoints.LEAST_INTERVAL, checkpoints.MOST_GROWTH * former):
        seconds = (interval + 0.5) * epoch_s
        assert seconds >= checkpoints.PAUSE_S
        assert (checkpoints.COST_S + checkpoints.COST_S_PER_BYTE * size) <= checkpoints.SHARE * seconds


def test_epochs_that_took_no_time_let_the_interval_grow() -> None:
    assert checkpoints.interval_of(0.0, 100, 8) == 8 * checkpoints.MOST_GROWTH


@given(st.lists(st.tuples(st.booleans(), st.integers(4, 50), st.booleans()), min_size=1, max_size=20))
def test_no_epoch_that_may_have_begun_becomes_a_checkpoint_or_a_barrier(steps: list[tuple[bool, int, bool]]) -> None:
    """Whoever knows only the former schedule can have come as far as that allows."""
    schedule = Schedule(next=8, last=16)
    for skips, interval, wants_barrier in steps:
        after = checkpoints.schedule_after(schedule, schedule.last if skips else schedule.next, interval, wants_barrier)
        for epoch in {after.next, after.last} - {schedule.last}:
            assert epoch > schedule.limit
        if after.holds:
            assert after.last >= schedule.limit + 1
        assert schedule.next <= after.next <= after.last
        schedule = after


def test_a_barrier_lies_one_epoch_behind_what_is_known_and_stays() -> None:
    assert checkpoints.schedule_after(Schedule(next=8, last=16), 8, 20, wants_barrier=True) == Schedule(
        next=16, last=17, holds=True
    )
    assert checkpoints.schedule_after(Schedule(next=8, last=16), 16, 20, wants_barrier=True) == Schedule(
        next=17, last=17, holds=True
    )
    barrier = Schedule(next=16, last=17, holds=True)
    assert checkpoints.schedule_after(barrier, 16, 20, wants_barrier=False) == Schedule(next=17, last=17, holds=True)


def answered(islands: tuple[int, ...], offset: int = 0, room: int = 1000) -> States:
    return States(pieces=split_states(islands, offset, STATES.__getitem__, room))


def test_every_worker_is_asked_one_question_at_a_time_until_all_states_are_there() -> None:
    gathering = checkpoints.Gathering(PLACEMENT, 24)
    ((worker, pull),) = gathering.next_pulls(1)
    assert (worker, pull.islands, pull.epoch, pull.term) == ("a", (0, 2), 24, 3)
    ((other, _),) = gathering.next_pulls(5)
    assert other == "b"
    assert gathering.next_pulls(5) == []
    gathering.add("a", answered((0, 2), room=40))
    ((_, rest),) = gathering.next_pulls(5)
    assert (rest.islands, rest.offset) == ((2,), 10)
    gathering.add("a", answered((2,), offset=10))
    gathering.add("b", None)
    assert not gathering.is_complete
    assert [worker for worker, _ in gathering.next_pulls(5)] == ["b"]
    gathering.add("stranger", answered((1, 3)))
    gathering.add("b", answered((1, 3)))
    assert gathering.is_complete
    assert gathering.states == STATES


def test_a_damaged_state_is_asked_for_again() -> None:
    gathering = checkpoints.Gathering(PLACEMENT, 24)
    gathering.next_pulls(5)
    (piece, *_) = answered((0, 2)).pieces
    with pytest.raises(RemoteProtocolError, match="damaged"):
        gathering.add("a", States(pieces=(piece.model_copy(update={"data": b"x" * 30}),)))
    ((worker, pull),) = gathering.next_pulls(5)
    assert (worker, pull.islands, pull.offset) == ("a", (0, 2), 0)
