"""Real programs over real zenoh, killed and stopped while they work: the answer is the calm one."""

import json
from pathlib import Path

import pytest

from benchmarks.operations.faults import main


@pytest.mark.slow
def test_strikes_do_not_change_the_answer(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    words = ["--jobs", "1", "--strikes", "3", "--epochs", "50", "--islands", "2", "--out", str(figures)]
    assert main([*words, "--kinds", "kill-worker,stop-coordinator,kill-coordinator", "--seed", "2"]) == 0
    written = json.loads(figures.read_text())
    assert {blow["kind"] for blow in written["blows"]} >= {"kill-coordinator"}
    assert [job["is_equal"] for job in written["jobs"]] == [True]
