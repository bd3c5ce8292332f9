"""Shards: the states of an island follow the table, and nothing else."""

import pytest

from atoll_core.errors import LocalProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.workers import Placement
from atoll_island_worker.session.shard import Shard

COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)


def test_a_share_has_the_islands_that_the_placement_gives_its_worker() -> None:
    placement = Placement(
        incarnation=1,
        term=2,
        job="j",
        variable="θ",
        workers=("a", "b", "a"),
        epochs=5,
        interval=16,
        commit_order=COMMIT_ORDER,
    )
    shard = Shard(placement, "a")
    assert list(shard.islands) == [0, 2]
    assert shard.stop_epoch == 4
    assert (shard.assignment_status().islands, shard.assignment_status().reported, shard.assignment_status().term) == (
        2,
        0,
        2,
    )
    shard.validate()


def test_an_inconsistent_share_is_noticed() -> None:
    placement = Placement(
        incarnation=1, term=1, job="j", variable="x", workers=("a",), epochs=5, interval=16, commit_order=COMMIT_ORDER
    )
    shard = Shard(placement, "a")
    shard.islands[0].epoch = 3
    shard.islands[0].needs = frozenset({0})
    with pytest.raises(LocalProtocolError, match="without its immigrants"):
        shard.validate()
