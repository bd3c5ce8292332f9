"""Scaling: speed-ups, digests, and how they are shown."""

import json
from contextlib import nullcontext

import pytest

from benchmarks.operations import scaling
from benchmarks.operations.scaling import Timing, differing, main, timings_table

TIMINGS = [
    Timing(1, 0, 10.0, 10**8, "a"),
    Timing(1, 1, 20.0, 2 * 10**8, "b"),
    Timing(2, 0, 5.0, 10**8, "a"),
    Timing(2, 1, 12.5, 2 * 10**8, "b"),
]


def test_digests_must_not_depend_on_the_number_of_workers():
    assert differing(TIMINGS) == []
    assert differing([*TIMINGS, Timing(3, 1, 1.0, 1, "c")]) == [1]


def test_the_table_has_a_line_for_each_number_of_workers():
    rows = [line.split() for line in timings_table(TIMINGS).splitlines()[1:]]
    assert rows == [["1", "15.00", "1.00", "10.00"], ["2", "8.75", "1.80", "18.00"]]


@pytest.mark.parametrize(
    "words", [["--workers", "0"], ["--workers", "two"], ["--system", "none"], ["--epochs", "0"], ["--step", "nan"]]
)
def test_other_options_are_refused(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert "error:" in capsys.readouterr().err


class Told:
    """Answers every search with a digest that depends on the seed alone."""

    def solve(self, title, table, config):
        equations = [{"epoch": config.budget.max_epochs}]
        return {"equations": equations, "search_seconds": 2.0, "point_evaluations": 10, "digest": str(config.seed)}


def test_searches_with_each_number_of_workers_are_written_and_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(scaling, "searching", lambda workers: nullcontext(Told()))
    out = tmp_path / "f.json"
    assert main(["--workers", "1,2", "--seeds", "0-1", "--epochs", "3", "--out", str(out)]) == 0
    contents = json.loads(out.read_text("utf-8"))
    assert [timing["workers"] for timing in contents["runs"]] == [1, 1, 2, 2]
    assert contents["speed_up"] == {"1": 1.0, "2": 1.0}
    assert "the same digests" in capsys.readouterr().out
