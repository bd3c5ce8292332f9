"""``coordinator simulate``: CSV from a saved result, and a sentence with exit code 2 for what does not fit."""

import json
from pathlib import Path

import numpy as np
import pytest

from atoll.cli.main import main
from tests.unit.library.model.results import process_result, result


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    contents = result({"x": "u*x"}, ("u",))
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0.0, 1.0]}]}
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def test_a_file_gives_initial_state_times_and_inputs(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (saved / "a.csv").write_text("t,x,u\n0,2,0\n1,9,0\n2,9,0\n")
    assert main(["simulate", str(saved), "--initial", str(saved / "a.csv")]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n1.0,2.0\n2.0,2.0\n"


@pytest.mark.parametrize(
    "text", ["t,x,u\n0,2,0\n1,9,0\n\n0,5,1\n1,5,1\n", "trajectory,t,x,u\n1,0,2,0\n1,1,9,0\n2,0,5,1\n2,1,5,1\n"]
)
def test_a_file_of_several_trajectories_gives_the_first(
    saved: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (saved / "a.csv").write_text(text)
    assert main(["simulate", str(saved), "--initial", str(saved / "a.csv")]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n1.0,2.0\n"


def test_dates_in_a_file_are_counted_in_the_unit_of_the_model(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contents = json.loads((saved / "result.json").read_text())
    contents["system"]["units"] = {"t": "min"}
    (saved / "result.json").write_text(json.dumps(contents))
    (saved / "a.csv").write_text("t,x,u\n2021-03-01 06:00,2,0\n2021-03-01 07:00,9,0\n")
    assert main(["simulate", str(saved), "--initial", str(saved / "a.csv")]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n60.0,2.0\n"


def test_an_input_that_nothing_gives_is_named(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(saved / "result.json"), "--initial", "x=1"]) == 2
    assert "the input 'u', of which nothing is given; give a number, such as --hold u=1," in capsys.readouterr().err


@pytest.mark.parametrize("simulation", [None, {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0, 1]}]}])
def test_what_was_recorded_is_simulated_unless_inputs_are_held(
    saved: Path, capsys: pytest.CaptureFixture[str], simulation: dict | None
) -> None:
    contents = result({"x": "u*x"}, ("u",)) | {"simulation": simulation}
    measured = {"name": "1", "times": [0.0, 1.0], "measured": {"x": [2.0, 2.0]}, "inputs": {"u": [0.0, 0.0]}}
    contents["data"]["trajectories"] = [measured]
    (saved / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(saved)]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n1.0,2.0\n"
    assert main(["simulate", str(saved), "--hold", "u=1"]) == 0
    assert float(capsys.readouterr().out.split(",")[-1]) == pytest.approx(2.0 * 2.718281828)
    assert main(["simulate", str(saved), "--hold", "v=1"]) == 2
    assert "--hold names 'v'; the inputs are u" in capsys.readouterr().err


def test_velocities_that_a_file_lacks_are_estimated(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contents = result({"x": "0*x"}, ("x_dot",))
    contents["equations"][0]["lhs"] = "d2x/dt2"
    (saved / "result.json").write_text(json.dumps(contents))
    (saved / "a.csv").write_text("t,x\n0,1\n1,3\n2,5\n")
    assert main(["simulate", str(saved), "--initial", str(saved / "a.csv")]) == 0
    assert [float(cell) for cell in capsys.readouterr().out.splitlines()[-1].split(",")] == pytest.approx([2, 5, 2])


def test_a_regression_has_no_time_to_simulate(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contents = result({}, ("x",))
    contents["equations"] = [result({"y": "2*x"}, ("x",))["equations"][0] | {"lhs": "y"}]
    contents["system"]["kind"] = "regression"
    (saved / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(saved)]) == 2
    assert "regression without time" in capsys.readouterr().err


def test_the_drift_of_a_process_is_simulated_with_the_band_of_its_own_constants(
    saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = result({"x": "0.5 - x"}, process={"step": 0.1})
    diffusion = result({"x": "0.25"})["equations"][0] | {"variable": "[x]", "lhs": "d[x]/dt"}
    contents["equations"].insert(0, diffusion)
    names = [{"variable": "[x]", "constant": 0}, {"variable": "x", "constant": 0}]
    contents["covariance"] = {"constants": names, "matrix": [[9.0, 0.5], [0.5, 0.01]], "freedom": None}
    (saved / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(saved), "--initial", "x=0.5", "--until", "40", "--step", "40"]) == 0
    said = capsys.readouterr()
    last = [float(cell) for cell in said.out.splitlines()[-1].split(",")]
    assert last == pytest.approx([40.0, 0.5, 0.5 - 0.196, 0.5 + 0.196], abs=1e-3)
    assert "without the noise" in said.err


def test_an_early_end_is_said_and_is_no_error(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (saved / "result.json").write_text(json.dumps(result({"x": "x**2"})))
    words = ["simulate", str(saved), "--initial", "x=1", "--until", "2", "--step", "0.5"]
    assert main([*words, "--json", "-o", str(saved / "o.json")]) == 0
    written = json.loads((saved / "o.json").read_text())
    assert written["status"] == "blow-up"
    assert written["columns"]["t"] == [0.0, 0.5]
    assert "ended early: a state grows without bounds" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--initial", "x=a"], "must be a finite number"),
        (["--initial", "nothing.csv"], "is neither"),
        (["--initial", "y=1"], "names 'y'"),
        (["--until", "-1"], "must be after the first time"),
        (["--step", "0"], "must be above 0"),
    ],
)
def test_bad_input_is_one_sentence(
    saved: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    assert main(["simulate", str(saved), *words]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_paths_of_a_process_are_written_as_bounds_or_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "result.json").write_text(json.dumps(process_result()))
    words = ["simulate", str(tmp_path), "--until", "0.2", "--step", "0.1"]
    assert main([*words, "--paths", "3", "--seed", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines[:2], len(lines)) == (["t,x_mean,x_lower,x_median,x_upper", "0.0,2.0,2.0,2.0,2.0"], 4)
    assert main([*words, "--paths", "3", "--seed", "5", "--each-path"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()]
    assert (rows[0], rows[4][:2], len(rows)) == (["trajectory", "t", "x"], ["2", "0.0"], 10)
    assert float(lines[2].split(",")[1]) == pytest.approx(
        np.mean([float(row[2]) for row in (rows[2], rows[5], rows[8])])
    )
    assert main([*words, "--paths", "2", "--json", "--each-path"]) == 0
    assert len(json.loads(capsys.readouterr().out)["states"]["x"]) == 2
    assert main(words) == 0
    assert "the drift was simulated, without the noise of the process; --paths" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--seed", "1"], "--seed belongs to --paths"),
        (["--each-path"], "--each-path belongs to --paths"),
        (["--paths", "x"], "--paths must be a whole number, but 'x' was given"),
        (["--paths", "0"], "paths must be a whole number of at least 1"),
    ],
)
def test_options_of_paths_that_do_not_fit_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], fault: str
) -> None:
    (tmp_path / "result.json").write_text(json.dumps(process_result()))
    assert main(["simulate", str(tmp_path), *words]) == 2
    assert fault in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "words", "sentence"),
    [
        ({"data": None}, ["--initial", "x=1"], "nothing tells how long to simulate; give --until"),
        ({"data": None}, ["--until", "3"], "no fitted initial state; give one, such as --initial x=1"),
        (
            {"equations": [{"groups": [{"group": "a", "expression": "2*x"}]}], "groups": [{"group": "a"}]},
            ["--until", "3"],
            "between its groups (a); choose one with --group",
        ),
    ],
)
def test_advice_is_in_the_words_of_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict, words: list[str], sentence: str
) -> None:
    contents = result({"x": "-x"})
    contents |= changes | {
        "equations": [contents["equations"][0] | equation for equation in changes.get("equations", [{}])]
    }
    (tmp_path / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(tmp_path), *words]) == 2
    assert capsys.readouterr().err.endswith(f"{sentence}\n")
