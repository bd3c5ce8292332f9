"""``coordinator analyse``: text and JSON from a saved result, and a sentence with exit code 2 for what does not fit."""

import json
from pathlib import Path

import numpy as np
import pytest

from atoll.cli.main import main
from atoll.model.model import Model
from tests.unit.library.experiments.made import measured
from tests.unit.library.model.results import result

SIDES = ["--box", "x=-2:2,y=-1:2"]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Return a folder with a result: x' = 0.5 x - x**3 + u, y' = -y, measured on its way to (1/sqrt 2, 0)."""
    times = np.linspace(0.0, 20.0, 200)
    course = {"x": (2.0 + 2.0 * np.exp(-times)) ** -0.5, "y": np.exp(-times)}
    curves = {name: values.tolist() for name, values in course.items()}
    simulation = {"trajectories": [{"name": "a", "times": times.tolist(), "values": curves}]}
    contents = result({"x": "0.5*x - x**3 + u", "y": "-y"}, ("u",), simulation=simulation)
    recorded = {"name": "a", "times": times.tolist(), "measured": curves, "inputs": {"u": [0.0] * 200}}
    contents["data"]["trajectories"] = [recorded]
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


@pytest.mark.slow
def test_json_lists_fixed_points_in_the_order_of_the_states(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", str(saved), *SIDES, "--parameter", "c1", "--range", "-1:1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["states"] == ["x", "y"]
    points = [(point["point"], point["kind"]) for point in printed["fixed_points"]]
    root = 0.5**0.5
    assert [kind for _, kind in points] == ["stable node", "saddle", "stable node"]
    np.testing.assert_allclose([point for point, _ in points], [[-root, 0.0], [0.0, 0.0], [root, 0.0]], atol=1e-9)
    special = [point for branch in printed["continuation"]["branches"] for point in branch["special"]]
    assert {point["kind"] for point in special} == {"branch point"}
    assert set(printed["nullclines"]) == {"x", "y"}
    assert np.shape(printed["basins"]["grid"]) == (40, 40)


def test_text_says_what_the_measured_trajectory_reaches(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", str(saved / "result.json"), *SIDES]) == 0
    said = capsys.readouterr().out
    assert "fixed points: 3 (Newton steps from 403 starts)" in said
    assert "50.0 ± 1.2 % reach the stable node (0.707107, 0)" in said
    assert "from trajectory a the model is bounded" in said
    assert "reaches, inputs held: stable node (0.707107, 0)" in said


def test_inputs_are_held_and_files_written(saved: Path) -> None:
    out = saved / "out.json"
    assert main(["analyse", str(saved), *SIDES, "--hold", "u=1.5", "--json", "-o", str(out)]) == 0
    written = json.loads(out.read_text())
    assert written["inputs"] == {"u": 1.5}
    x = written["fixed_points"][0]["point"][0]
    assert 0.5 * x - x**3 + 1.5 == pytest.approx(0.0, abs=1e-9)


def test_the_model_gives_the_same_and_boxes_follow_the_data(saved: Path) -> None:
    analysis = Model.load(saved / "result.json").analyse({"y": (-1.0, 1.0)})
    assert analysis.box.lower[0] == pytest.approx(0.5 - 0.5 * (0.5**0.5 - 0.5), abs=1e-3)
    assert analysis.as_dict()["box"]["y"] == [-1.0, 1.0]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--box", "x=3"], "--box x wants LOWER:UPPER"),
        (["--box", "x=3:1"], "wants LOWER below UPPER"),
        (["--box", "x=0:inf"], "must be a finite number"),
        (["--box", "z=0:1"], "no state 'z'"),
        (["--box", "x=0:1,x=0:2"], "names 'x' twice"),
        (["--hold", "v=1"], "no input 'v'"),
        (["--parameter", "c9", "--range", "0:1"], "no parameter 'c9'; the model has c1 = 0.5 of x"),
        (["--parameter", "c1"], "without --range"),
    ],
)
def test_bad_input_is_one_sentence(
    saved: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    assert main(["analyse", str(saved), *words]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_a_state_without_measurements_needs_bounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "result.json").write_text(json.dumps(result({"x": "-x"}, system={"time": "t", "ranges": {}})))
    assert main(["analyse", str(tmp_path)]) == 2
    assert "the box needs its lower and upper bound" in capsys.readouterr().err


def test_without_simulations_the_box_is_about_the_measured_range(
    saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (saved / "result.json").write_text(json.dumps(result({"x": "-x", "y": "x - y"})))
    assert main(["analyse", str(saved)]) == 0
    assert capsys.readouterr().out.startswith("box: x 0 to 1.5, y 0 to 1.5\n")


def test_identifiability_is_that_of_the_measurements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    times = np.linspace(0.0, 5.0, 20)
    decay = 3.0 * np.exp(-0.6 * times) + 0.02 * np.random.default_rng(1).standard_normal(20)
    (tmp_path / "result.json").write_text(json.dumps(measured({"x": "-0.5*x"}, [(times, {"x": decay})], 0.02)))
    asked = ["analyse", str(tmp_path), "--box", "x=0:4"]
    assert main([*asked, "--identifiability", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (constant,) = printed["identifiability"]["constants"]
    assert (constant["name"], constant["verdict"]) == ("c1", "determined")
    assert printed["fixed_points"]
    (tmp_path / "a.csv").write_text("t,x\n" + "\n".join(f"{t},{x}" for t, x in zip(times, decay, strict=True)))
    assert main([*asked, "--identifiability", "--data", str(tmp_path / "a.csv")]) == 0
    said = capsys.readouterr().out
    assert "identifiability (95 % profile likelihood; the data that were given):" in said
    assert main([*asked, "--data", str(tmp_path / "a.csv")]) == 2
    assert "--data was given without --identifiability" in capsys.readouterr().err
    assert main([*asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["identifiability"] is None
