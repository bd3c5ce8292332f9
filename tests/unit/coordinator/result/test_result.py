"""A result is read, asked and written; its schema says to other programs what this does."""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from pydantic import ValidationError

from atoll_coordinator.result.__main__ import REFERENCE, reference
from atoll_coordinator.result.result import Result, schema_text
from tests.unit.library.report.results import dynamics, process, regression


@pytest.mark.parametrize("content", [dynamics(), process(), regression()])
def test_what_is_written_is_read_again(content: dict[str, object]) -> None:
    result = Result.load(content)
    assert Result.load(json.loads(result.to_json())) == result


def test_keys_of_newer_versions_are_kept() -> None:
    content = dynamics(newer={"a": [1, None]})
    content["equations"][0]["newer"] = 2
    written = Result.load(content).as_dict()
    assert written["newer"] == {"a": [1, None]}
    equations = written["equations"]
    assert isinstance(equations, list)
    assert isinstance(equations[0], dict)
    assert equations[0]["newer"] == 2


def test_rare_keys_are_written_where_they_say_something() -> None:
    assert not {"group", "command"} & {*Result.load(dynamics()).as_dict()}
    assert Result.load(dynamics(group="b")).as_dict()["group"] == "b"


def test_numbers_that_are_not_finite_are_null() -> None:
    result = Result.load(dynamics(seconds=float("nan")))
    assert json.loads(result.to_json())["seconds"] is None


def test_nothing_changes_after_it_was_read() -> None:
    with pytest.raises(ValidationError):
        Result.load(dynamics()).seed = 3  # type: ignore[misc]


def test_scales_are_the_largest_values_measured() -> None:
    content = dynamics()
    content["system"]["ranges"] = {"x": [-3.0, 1.0], "y": [None, 2.0]}
    result = Result.load(content)
    assert result.ranges == {"x": (-3.0, 1.0)}
    assert result.sizes(("y", "x")) == (0.0, 3.0)


def test_the_schema_in_the_package_is_that_of_the_code() -> None:
    stored = files("atoll_coordinator.result").joinpath("result.schema.json").read_text("utf-8")
    assert stored == schema_text(), "run: python -m atoll_coordinator.result"


def test_the_reference_of_the_documents_is_that_of_the_code() -> None:
    documented = Path(__file__).parents[4] / REFERENCE
    assert documented.read_text("utf-8") == reference(), "run: python -m atoll_coordinator.result"
    assert all(line.count("|") != 4 or not line.endswith("|  |") for line in reference().splitlines())


def test_results_are_read_without_kernels() -> None:
    program = (
        "import sys; from atoll_coordinator.result.result import Result;"
        "sys.exit(any(name in sys.modules for name in ('numba', 'numpy', 'sympy', 'scipy')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
