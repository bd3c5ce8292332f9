"""Results of every earlier shape are read as if this version had written them."""

import json
from pathlib import Path

import pytest

from atoll_coordinator.result.result import Result

STORED = Path(__file__).parent / "stored"


def stored(name: str) -> Result:
    return Result.load(STORED / f"{name}.json")


@pytest.mark.parametrize("path", sorted(STORED.glob("*.json")), ids=lambda path: path.stem)
def test_what_is_upgraded_is_written_and_read_as_it_is(path: Path) -> None:
    result = Result.load(path)
    content = json.loads(result.to_json())
    assert Result.load(content) == result
    before = json.loads(path.read_text("utf-8"))
    assert [equation["front"][1]["expression"] for equation in content["equations"]] == [
        equation["front"][1]["expression"] for equation in before["equations"]
    ]


def test_columns_that_nothing_says_are_told_by_the_equations() -> None:
    columns = stored("columns_unsaid").columns
    assert (columns.kind, columns.order, columns.states, columns.inputs) == ("dynamics", 1, ("x",), ("y",))
    assert columns.ranges == {}


def test_an_equation_without_a_rate_is_a_regression() -> None:
    content = json.loads((STORED / "columns_unsaid.json").read_text("utf-8"))
    content["equations"][0] |= {"variable": "z", "lhs": "z"}
    columns = Result.load(content).columns
    assert (columns.kind, columns.target, columns.states, columns.inputs) == ("regression", "z", (), ("x", "y"))


def test_ranges_that_were_not_written_are_those_of_the_listed_rows() -> None:
    assert stored("simulated_without_columns").ranges == {"x": (1.0, 2.0)}
    content = json.loads((STORED / "terms_without_multiples.json").read_text("utf-8"))
    del content["system"]["ranges"]
    assert Result.load(content).ranges == {"x": (1.0, 2.0), "y": (0.0, 1.0)}


def test_steps_of_which_nothing_was_said_are_samples_of_a_process_in_time() -> None:
    result = stored("process_without_discretisation")
    assert result.process is not None
    assert (result.kind, result.process.discretisation) == ("process", "local linearisation")


def test_what_no_version_knew_yet_is_unknown() -> None:
    result = stored("without_measurements_and_shared_terms")
    assert (result.shared_terms, result.recorded, result.groups) == ((), (), ())
    assert result.equations[0].simple_together is None
    assert stored("terms_without_multiples").shared_terms[0].multiples is None
