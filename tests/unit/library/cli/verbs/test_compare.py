"""``coordinator compare``: two results, or candidates of results."""

import json
from pathlib import Path

import pytest

from atoll.cli.main import main
from tests.unit.library.experiments.test_comparison import decay


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    contents = decay()
    other = {"expression": "-0.4", "complexity": 1, "nats": 9.0, "origin": "library", "selected": False}
    contents["equations"][0]["candidates"] = [other]
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def test_a_result_is_compared_with_its_candidate(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(saved), ":1"]) == 0
    text = capsys.readouterr().out
    assert f"B = {saved}:1: dx/dt = -0.4" in text
    assert "The data decide for A" in text
    assert main(["compare", str(saved / "result.json"), f"{saved}:1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["B"]["equations"] == {"dx/dt": "-0.4"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((":1", "{}"), "A is ':1', but a result was expected, such as runs/JOB:1"),
        (("{}", ":2"), "has no candidate 2: it has candidates 1 to 1"),
        (("{}", "{}/nothing"), "cannot be read"),
    ],
)
def test_what_is_no_result_is_a_sentence(
    saved: Path, words: tuple[str, str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *(word.format(saved) for word in words)]) == 2
    assert sentence in capsys.readouterr().err
