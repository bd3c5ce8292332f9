"""The race with Operon: what counts, and the table."""

import json
from argparse import Namespace

import numpy as np
import pytest

from benchmarks.harness.record import Record
from benchmarks.peers import operon, strogatz_versus
from benchmarks.peers.strogatz_files import rows_of
from benchmarks.peers.strogatz_versus import measured_error, run

PEER = operon.Run(
    seconds=4.0, elapsed=4.1, processor_seconds=7.9, error=5e-5, generations=7, evaluations=8000, expression="v0"
)


@pytest.fixture
def folder(tmp_path):
    lines = [f"{2.0 * index},{float(index)},{float(-index)}" for index in range(1, 41)]
    (tmp_path / "lv2.csv").write_text("\n".join(["label,x,y", *lines]) + "\n")
    return tmp_path


def result(expression):
    equation = {"expression": expression, "point_evaluations": 5}
    return {"equations": [equation], "search_seconds": 1.0, "seconds": 1.5}


def test_the_error_is_measured_anew(folder):
    rows = rows_of(folder, "lv2")
    assert measured_error("2*x", rows) == 0.0
    spread = np.std(rows.column("label"))
    assert measured_error("2*x + 0.5", rows) == pytest.approx(0.5 / spread)
    with np.errstate(all="ignore"):
        assert measured_error("x/(x + y)", rows) is None


def test_both_search_in_turn_and_all_is_written(folder, monkeypatch, capsys):
    order = []

    class Ours:
        def solve(self, title, table, config):
            order.append(title)
            return result("2*x")

    def peers(file, seed, target_error, limit):
        order.append((file.name, seed, target_error, limit))
        return PEER

    monkeypatch.setattr(strogatz_versus, "search_apart", peers)
    options = Namespace(data=folder, file=["lv2"], seeds=[0, 1], target_error=1e-4, max_time=9.0)
    out = folder / "out.json"
    assert run(Ours(), options, dict.fromkeys([0, 1]), {}, Record("strogatz", [], out)) == 0
    assert order == ["lv2 seed 0", ("lv2.csv", 0, 1e-4, 9.0), "lv2 seed 1", ("lv2.csv", 1, 1e-4, 9.0)]
    contents = json.loads(out.read_text())
    assert contents["summary"]["ratio"] == pytest.approx(0.25)
    assert [content["peers"] for content in contents["runs"]] == [4.0, 4.0]
    assert "Operon s" in capsys.readouterr().out
