"""``coordinator export``: the model as it is chosen, with the initial state and inputs that are given."""

import json
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll_coordinator.result.result import Result
from tests.unit.library.export.exported import run_python
from tests.unit.library.model.results import result


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    contents = result({"x": "u*x"}, ("u",))
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0.0, 1.0]}]}
    expression = {"expression": "u*x/3.5", "nats": 2.0, "complexity": 7, "origin": "library", "selected": False}
    figures = {"error": 0.5, "normalized_error": 0.5, "r2": 0.5, "constants": [], "holdout_error": None}
    member = {"expression": "-0.75*x", "complexity": 3, "selected": False, **figures}
    contents["equations"][0] |= {"candidates": [expression], "front": [member], "why": "target", "target_error": 0.1}
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def exported(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["export", *words]) == 0
    return capsys.readouterr().out


def test_a_file_gives_initial_state_times_and_inputs(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (saved / "a.csv").write_text("t,x,u\n0,3,0\n1,9,0\n2,9,0\n")
    text = exported(capsys, str(saved), "--format", "python", "--initial", str(saved / "a.csv"))
    names = run_python(text)
    assert names["TIMES"].tolist() == [0.0, 1.0, 2.0]
    assert names["simulate"]().tolist() == [[3.0], [3.0], [3.0]]


def test_an_input_of_which_nothing_is_given_is_said_to_be_held(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(saved), "--format", "python"]) == 0
    assert "held at 0, since no value is given: u;" in capsys.readouterr().err
    assert main(["export", str(saved), "--format", "python", "--hold", "u=0"]) == 0
    assert capsys.readouterr().err == ""


def test_an_input_is_held(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--format", "xppaut", "--hold", "u=1.5", "--initial", "x=4", "--until", "6", "--step", "2")
    text = exported(capsys, str(saved / "result.json"), *words)
    assert "\npar u=1.5\ninit x=4.0\n" in text
    assert "total=6.0, dt=2.0" in text


def test_other_equations_may_be_taken(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "u*x/c1," in exported(capsys, str(saved), "--format", "python", "--candidate", "1")
    assert "c1*x," in exported(capsys, str(saved), "--format", "python", "--pick", "x=0")
    assert r"\frac{d x}{d t} &= - 0.75 x" in exported(capsys, str(saved), "--format", "latex", "--pick", "x=0")


def test_a_folder_is_written(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (saved / "a.csv").write_text("t,x\n0,3\n1,9\n2,9\n3,1\n4,1\n5,2\n6,1\n7,1\n")
    contents = json.loads((saved / "result.json").read_text())
    (saved / "result.json").write_text(json.dumps(contents | result({"x": "-0.5*x"})))
    words = ("--format", "petab", "-o", str(saved / "problem"), "--data", str(saved / "a.csv"))
    assert exported(capsys, str(saved), *words) == ""
    assert len((saved / "problem" / "measurements.tsv").read_text().splitlines()) == 9


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--format", "petab"), "petab is a folder of several files; name it with -o FOLDER"),
        (("--format", "c", "--candidate", "2"), "--candidate 2 is not there: the result has 1 candidates"),
        (("--format", "c", "--candidate", "1", "--pick", "x=0"), "both choose equations"),
        (("--format", "c", "--hold", "v=1"), "--hold names 'v'; the inputs are u"),
        (("--format", "c", "--data", "a.csv"), "--data belongs to --format petab"),
        (("--format", "fortran"), "but 'fortran' was given"),
    ],
)
def test_what_does_not_fit_is_said(
    saved: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], sentence: str
) -> None:
    assert main(["export", str(saved), *words]) == 2
    assert sentence in capsys.readouterr().err


def test_what_needs_no_model_is_written_of_a_result_without_one(
    saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = json.loads((saved / "result.json").read_text())
    contents["equations"][0]["expression"] = None
    (saved / "result.json").write_text(json.dumps(contents))
    assert Result.load(json.loads(exported(capsys, str(saved), "--format", "json"))) == Result.load(saved)
    assert exported(capsys, str(saved), "--format", "csv").splitlines()[1].endswith("-0.75*x")
    assert main(["export", str(saved), "--format", "c"]) == 2
    assert "has not found every equation" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["c", "latex", "sympy"])
def test_the_heading_of_one_group_names_it(saved: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    contents = result({"x": "-0.9*x"}, groups=[{"group": "a\nb", "trajectories": ["1"], "covariance": None}])
    contents["equations"][0]["groups"] = [{"group": "a\nb", "expression": "-0.6*x"}]
    (saved / "result.json").write_text(json.dumps(contents))
    words = (str(saved), "--format", name, "--group", "a\nb")
    start = () if name != "c" else ("--initial", "x=1", "--until", "2")
    text = exported(capsys, *words, *start)
    member = {"expression": "-0.75*x", "complexity": 3, "selected": False, "error": 0.5, "normalized_error": 0.5}
    contents["equations"][0] |= {"front": [member | {"r2": 0.5, "constants": []}], "why": "target", "target_error": 0.1}
    (saved / "result.json").write_text(json.dumps(contents))
    picked = exported(capsys, *words, *start, "--pick", "x=0")
    assert "those of dx/dt are of all groups together." in picked
    assert "0.75" in picked
    assert "Constants belong to group a b." in text
    assert "0.6" in text
