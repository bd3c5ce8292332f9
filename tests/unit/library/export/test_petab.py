"""A PEtab problem holds measurements, noise and bounds that fit together."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from atoll.api.model import Model
from atoll_core.errors import UsageError
from benchmarks.exports import programs
from tests.unit.library.export.exported import TIMES, decay, model, process
from tests.unit.library.model.results import constant


def measured(u: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Model:
    """Return a model with two trajectories, one of them held out, and a value that is missing."""
    contents = decay().result.as_dict()
    part = {"name": "1", "times": [2.0, 3.0, 5.0], "measured": {"x": [1.1, None, 0.9]}, "inputs": {"u": u}}
    contents["data"]["trajectories"] = [part | {"held_out": False}, part | {"name": "2", "held_out": True}]
    return Model({**contents, "noise": {"x": {"sd": 0.05, "errors": {"sd": 0.2, "proportional": 0.5}}}})


def alone() -> Model:
    """Return a model without an input."""
    contents = model({"x": "-0.3*x"}).result.as_dict()
    contents["equations"][0]["constants"] = [constant(-0.3, 0.1)]
    return Model(contents)


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text), delimiter="\t"))


def test_measurements_begin_at_time_0_and_leave_out_what_is_missing_or_held_out(tmp_path: Path) -> None:
    measured().to_petab(tmp_path)
    rows_written = rows((tmp_path / "measurements.tsv").read_text())
    assert [(row["time"], row["measurement"]) for row in rows_written] == [("0.0", "1.1"), ("3.0", "0.9")]
    assert {row["simulationConditionId"] for row in rows_written} == {"trajectory_1"}


def test_measurements_of_a_result_that_was_not_simulated_begin_at_their_first_whole_row(tmp_path: Path) -> None:
    contents = alone().result.as_dict()
    part = {"name": "1", "times": [2.0, 3.0, 5.0], "measured": {"x": [None, 1.25, 0.75]}, "inputs": {}}
    contents["data"]["trajectories"] = [part | {"held_out": False}]
    Model({**contents, "simulation": None}).to_petab(tmp_path)
    rows_written = rows((tmp_path / "measurements.tsv").read_text())
    assert [(row["time"], row["measurement"]) for row in rows_written] == [("0.0", "1.25"), ("2.0", "0.75")]
    assert rows((tmp_path / "parameters.tsv").read_text())[1]["nominalValue"] == "1.25"


def test_a_time_column_of_two_words_is_the_time_of_the_model(tmp_path: Path) -> None:
    contents = alone().result.as_dict()
    contents["system"]["time"], contents["symbols"]["elapsed time"] = "elapsed time", "elapsed_time"
    contents["equations"][0]["expression"] = "-0.3*x + 0.1*elapsed_time"
    data = [{"elapsed time": np.array([2.0, 3.0]), "x": np.array([1.0, 0.5])}]
    Model({**contents, "data": {}}).to_petab(tmp_path, data)
    (condition,) = rows((tmp_path / "conditions.tsv").read_text())
    assert condition["begin_time"] == "2.0"


def test_constants_starts_and_noise_are_estimated_within_bounds(tmp_path: Path) -> None:
    measured().to_petab(tmp_path)
    rows_written = {row["parameterId"]: row for row in rows((tmp_path / "parameters.tsv").read_text())}
    assert list(rows_written) == ["c1", "start_x_1", "sd_x"]
    assert (float(rows_written["c1"]["lowerBound"]), float(rows_written["c1"]["upperBound"])) == pytest.approx(
        (-1.3, 0.7)
    )
    (condition,) = rows((tmp_path / "conditions.tsv").read_text())
    assert (condition["start_x"], condition["u"]) == ("start_x_1", "1.0")
    (observable,) = rows((tmp_path / "observables.tsv").read_text())
    assert observable["noiseFormula"].startswith("sd_x * sqrt(0.5 + 0.5 * (x / ")


def test_bounds_that_were_set_are_kept(tmp_path: Path) -> None:
    contents = alone().result.as_dict()
    contents["equations"][0]["expression"] = "-1.0*x"
    contents["equations"][0]["constants"] = [constant(1.0, 0.1) | {"std_error": None, "bounds": [0.0, None]}]
    Model(contents).to_petab(tmp_path, [{"t": TIMES, "x": TIMES}])
    rows_written = rows((tmp_path / "parameters.tsv").read_text())[0]
    assert (rows_written["parameterId"], rows_written["lowerBound"], rows_written["upperBound"]) == (
        "c1",
        "-11.0",
        "0.0",
    )


def test_measurements_may_be_given(tmp_path: Path) -> None:
    data = [{"t": TIMES, "x": TIMES + 1.0}, {"t": TIMES[:2] + 7.0, "x": np.array([3.0, np.nan])}]
    alone().to_petab(tmp_path, data)
    rows_written = rows((tmp_path / "measurements.tsv").read_text())
    assert len(rows_written) == 10
    assert (rows_written[-1]["time"], rows_written[-1]["measurement"]) == ("0.0", "3.0")


def test_angles_of_given_measurements_are_unwrapped_and_in_radians(tmp_path: Path) -> None:
    model = alone()
    model = Model({**model.result.as_dict(), "config": {"data": {"angles": [{"column": "x", "degrees": True}]}}})
    model.to_petab(tmp_path, [{"t": TIMES, "x": np.degrees(6.0 + TIMES) % 360.0}])
    written = [float(row["measurement"]) for row in rows((tmp_path / "measurements.tsv").read_text())]
    assert written == pytest.approx(6.0 + TIMES)


def test_the_linter_of_petab_finds_nothing(tmp_path: Path) -> None:
    measured().to_petab(tmp_path)
    try:
        programs.lint_petab(tmp_path)
    except programs.Absent as missing:
        pytest.skip(f"{missing} is not installed")


def test_the_time_as_an_input_goes_on_from_where_a_trajectory_begins(tmp_path: Path) -> None:
    clock = model({"x": "cos(t)*x"}, inputs=("t",))
    clock.to_petab(tmp_path, [{"t": TIMES + 4.0, "x": TIMES}])
    (condition,) = rows((tmp_path / "conditions.tsv").read_text())
    assert condition["begin_time"] == "4.0"
    assert "<ci> begin_time </ci>" in (tmp_path / "model.xml").read_text()


def test_what_petab_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no measurements of trajectories; give them as data"):
        decay().to_petab(tmp_path)
    with pytest.raises(UsageError, match="cannot express the noise of a process"):
        process().to_petab(tmp_path)
    with pytest.raises(UsageError, match="the input 'u' changes along trajectory 1; PEtab needs constant inputs"):
        measured((1.0, 2.0, 2.0)).to_petab(tmp_path)
    with pytest.raises(UsageError, match="the input 'u' is not known along trajectory 1"):
        decay().to_petab(tmp_path, [{"t": TIMES, "x": TIMES}])
    with pytest.raises(UsageError, match="no trajectory of measurements"):
        decay().to_petab(tmp_path, [])
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        alone().to_petab(tmp_path / "file", [{"t": TIMES, "x": TIMES}])
