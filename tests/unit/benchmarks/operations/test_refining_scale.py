"""Traces of refining, played on simulated workers."""

import pytest

from benchmarks.operations.refining_scale import (
    HANDOVER_S,
    LATENCY_S,
    OVERHEAD_S,
    Cluster,
    Divided,
    Fork,
    Mapped,
    Serial,
)

CALL = Mapped("fits", (1.0,) * 8)
GIVEN = 2.0 * LATENCY_S


@pytest.mark.parametrize(("workers", "rounds"), [(1, 8), (2, 4), (3, 3), (8, 1), (100, 1)])
def test_batches_of_a_call_are_shared_and_what_lies_between_is_not(workers: int, rounds: int) -> None:
    span = Cluster(workers).span((Serial(2.0), CALL, Serial(1.0)))
    assert span == pytest.approx(3.0 + rounds * (1.0 + OVERHEAD_S) + GIVEN)


def test_branches_share_the_workers_and_take_turns_on_the_core() -> None:
    branch = (Serial(0.5), Mapped("fits", (2.0,)))
    assert Cluster(8).span((Fork((branch, branch)),)) == pytest.approx(1.0 + 2.0 + OVERHEAD_S + GIVEN)
    assert Cluster(1).span((Fork((branch, branch)),)) == pytest.approx(1.0 + 2.0 * (2.0 + OVERHEAD_S) + LATENCY_S)


def test_parts_of_an_integration_use_all_cores_while_another_branch_has_the_lock() -> None:
    parts = Divided((1.0,) * 4)
    assert Cluster(2).span((parts,)) == pytest.approx(2.0 * (1.0 + HANDOVER_S))
    assert Cluster(3).span((Fork(((Serial(2.0),), (parts,))),)) == pytest.approx(2.0 * (1.0 + HANDOVER_S))
