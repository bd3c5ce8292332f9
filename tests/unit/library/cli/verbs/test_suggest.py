"""``coordinator suggest``: text and JSON from a saved result, and a sentence with exit code 2 for what does not fit."""

import json
import re
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.model.model import Model
from tests.unit.library.experiments.test_design_search import FOUND, TIMES, WIDE


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text(json.dumps(FOUND))
    return tmp_path


def test_json_is_that_of_the_model_and_goes_into_a_file(saved: Path) -> None:
    out = saved / "out.json"
    words = ["suggest", str(saved), "--box", "x=0.1:20", "--count", "1", "--samples", "6", "--duration", "1.5"]
    assert main([*words, "--seed", "3", "--json", "-o", str(out)]) == 0
    written = json.loads(out.read_text())
    assert written == Model(FOUND).suggest(WIDE, count=1, samples=6, duration=1.5, seed=3).as_dict()
    (first,) = written["experiments"]
    assert len(first["times"]) == 6
    assert first["times"][-1] == 1.5


def test_text_names_candidates_bounds_and_experiments(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = zip(TIMES.tolist(), FOUND["data"]["trajectories"][0]["measured"]["x"], strict=True)
    (saved / "a.csv").write_text("t,x\n" + "\n".join(f"{time},{value}" for time, value in rows))
    words = ["suggest", str(saved), "--data", str(saved / "a.csv"), "--rival", "dx=-x + 0.1*x**2", "--cost", "samples"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.startswith("candidates, their constants fitted again (the data that were given):")
    assert re.search(r"\(given, Δ description length [\d.e+-]+\)  dx/dt = ", said)
    assert "(of the data, smoothed)" in said
    assert "experiment 1: x = " in said
    assert "per unit of samples" in said


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--box", "z=0:1"], "there is no 'z' to bound"),
        (["--box", "x=1"], "--box x wants LOWER:UPPER"),
        (["--cost", "money"], "the cost is trajectory, duration or samples"),
        (["--samples", "2.5"], "--samples must be a whole number"),
        (["--duration", "soon"], "--duration must be a finite number"),
        (["--rival", "x"], "--rival wants dx=EXPR"),
        (["--rival", ";"], "--rival wants dx=EXPR, but got nothing"),
        (["--rival", "dx=z"], "z"),
    ],
)
def test_what_does_not_fit_is_a_sentence(
    saved: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    assert main(["suggest", str(saved), *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith("coordinator: ")
    assert sentence in said
    assert said.count("\n") == 1
