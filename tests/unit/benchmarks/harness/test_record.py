"""Records of runs as JSON."""

import json
from dataclasses import dataclass

from benchmarks.harness.record import Record


@dataclass
class One:
    name: str
    seconds: float | None


def test_every_record_is_in_the_file_at_once(tmp_path):
    file = tmp_path / "new" / "runs.json"
    records = Record("race", ["--seeds", "0"], file)
    records.add(One("a", 1.5))
    assert json.loads(file.read_text())["runs"] == [{"name": "a", "seconds": 1.5}]
    records.add(One("b", None))
    records.write(summary={"met": 1})
    contents = json.loads(file.read_text())
    assert [run["name"] for run in contents["runs"]] == ["a", "b"]
    assert (contents["benchmark"], contents["arguments"]) == ("race", ["--seeds", "0"])
    assert contents["summary"] == {"met": 1}
    assert contents["machine"]["cores"] >= 1


def test_without_a_file_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Record("race", [], None).add(One("a", 1.0))
    assert list(tmp_path.iterdir()) == []
