"""What is counted of a search with checkpoints and of one without."""

from pathlib import Path

import pytest

from atoll_core.wire.messages.views import JobState, JobView, VariableView
from benchmarks.operations.checkpoints import Pair, Spent, committed, pairs_table

LOG = """2026-11-21T20:54:25.545Z INFO commit job=one variable=x epoch=59 term=1 islands=4 bytes=184768 text="durable"
2026-11-21T20:54:26.598Z INFO commit job=other variable=x epoch=64 term=1 islands=4 bytes=10 text="durable"
2026-11-21T20:54:27.000Z INFO placed job=one variable=x term=1 epoch=0 workers=1
2026-11-21T20:54:27.730Z INFO commit job=one variable=x epoch=70 term=1 islands=4 bytes=184448 text="durable"
"""


def view(state: JobState, epoch: int) -> JobView:
    return JobView(
        job="j", name="", state=state, seed=0, preset="default", submitted="", elapsed=0.0, workers=1,
        point_evaluations=0, variables=(VariableView(variable="x", lhs="dx/dt", epoch=epoch),),
    )  # fmt: skip


def test_the_bytes_of_an_island_are_those_that_the_log_mentions_of_the_job() -> None:
    assert committed(LOG, "one") == [184768 / 4, 184448 / 4]
    assert committed(LOG, "none") == []


def test_processor_time_counts_from_the_first_epoch_to_the_end_of_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sysconf", lambda name: 100)
    (tmp_path / "7").mkdir()
    spent = Spent((7,), tmp_path)
    for state, epoch, ticks in (("preparing", 0, 50), ("running", 1, 100), ("running", 9, 400), ("refining", 9, 900)):
        (tmp_path / "7" / "stat").write_text(f"7 (a (b) c) S 1 1 1 0 -1 0 0 0 0 0 {ticks} 20 0 0")
        spent.look(view(state, epoch))  # type: ignore[arg-type]
    assert spent.seconds == pytest.approx(3.0)


def test_the_cost_is_the_throughput_that_is_missing() -> None:
    pair = Pair(3, 10.0, 9.8, 6.0, 5.9, 12, 46_000.0, is_same=True)
    assert pair.cost == pytest.approx(0.02)
    assert "46.0" in pairs_table([pair])
    assert "same" in pairs_table([pair])
