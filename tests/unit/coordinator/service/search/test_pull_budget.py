"""How many states of checkpoints are pulled at a time, over all archipelagos."""

import pytest

from atoll_coordinator.service.search import pull_budget as module
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.search.checkpoint_schedule import FIRST_INTERVAL
from atoll_coordinator.service.search.collector import SearchState
from atoll_coordinator.service.search.ending import SearchLimits, Stagnation
from atoll_coordinator.service.search.pull_budget import PullBudget
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.workers import AssignmentStatus, Placement
from atoll_core.wire.state_pieces import IslandState, split_states

COMMIT_ORDER = CommitOrder(generations=10, stride=10, joining=8)
STATE = b"a state of an island"


def archipelago(variable: str, workers: int) -> Archipelago:
    """Return an archipelago with an island on each worker, all of which have a snapshot for the first checkpoint."""
    names = tuple(f"w{number}" for number in range(workers))
    limits = SearchLimits(islands=workers, epochs=100, stagnation=Stagnation(100), commit_order=COMMIT_ORDER)
    made = Archipelago("job", variable, limits, lambda front: 0.0, lambda program: None)
    placement = Placement(
        incarnation=1, term=1, job="job", variable=variable, workers=names, epochs=100, interval=FIRST_INTERVAL,
        commit_order=COMMIT_ORDER,
    )  # fmt: skip
    made.place(placement, 0.0)
    for name in names:
        assignment_status = AssignmentStatus(
            job="job", variable=variable, term=1, islands=1, reported=8, commit=0, snapshots=(FIRST_INTERVAL,)
        )
        made.update_assignment_status(name, assignment_status)
    made.collector._past[FIRST_INTERVAL] = SearchState(epochs=FIRST_INTERVAL)
    return made


def reply(coordinator: PullBudget, made: Archipelago, worker: str, pull: PullStates) -> None:
    pieces = split_states(pull.islands, pull.offset, lambda island: IslandState.of(STATE))
    coordinator.add_states(made, worker, pull, States(pieces=pieces))


def complete(coordinator: PullBudget, made: Archipelago) -> Checkpoint:
    """Pull all states of an archipelago and return its checkpoint."""
    while pulls := coordinator.next_pulls(made):
        for worker, pull in pulls:
            reply(coordinator, made, worker, pull)
    checkpoint = coordinator.take_complete_checkpoint(made)
    assert checkpoint is not None
    return checkpoint


def test_states_count_from_their_arrival_until_they_are_written() -> None:
    coordinator, made = PullBudget(), archipelago("x", 3)
    checkpoint = complete(coordinator, made)
    assert coordinator.held_bytes == checkpoint.size == 3 * len(STATE)
    assert coordinator.take_complete_checkpoint(made) is None
    coordinator.mark_written(checkpoint)
    assert coordinator.held_bytes == 0


def test_without_memory_the_checkpoint_that_was_begun_first_goes_on_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_BYTES", CHUNK_SIZE)
    coordinator, x, y = PullBudget(), archipelago("x", 2), archipelago("y", 2)
    pulls = coordinator.next_pulls(x)
    assert len(pulls) == 2
    assert coordinator.waiting == ()
    assert coordinator.next_pulls(y) == []
    assert coordinator.waiting == (y.key,)
    for worker, pull in pulls:
        reply(coordinator, x, worker, pull)
    checkpoint = coordinator.take_complete_checkpoint(x)
    assert checkpoint is not None
    assert coordinator.next_pulls(y) == []
    coordinator.mark_written(checkpoint)
    coordinator.begin_round({y.key: y})
    assert len(coordinator.next_pulls(y)) == 2


def test_states_of_an_archipelago_that_lost_its_placement_count_no_more() -> None:
    coordinator, made = PullBudget(), archipelago("x", 2)
    (worker, pull), late = coordinator.next_pulls(made)
    reply(coordinator, made, worker, pull)
    assert coordinator.held_bytes == len(STATE)
    made.unplace()
    coordinator.begin_round({made.key: made})
    assert coordinator.held_bytes == 0
    reply(coordinator, made, *late)
    assert coordinator.held_bytes == 0
