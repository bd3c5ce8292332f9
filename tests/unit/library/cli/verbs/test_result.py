"""Saved results, printed without a coordinator."""

import json
from argparse import Namespace
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.cli.request import is_saved
from atoll.cli.result_files import write_result
from atoll_coordinator.result.result import Result
from tests.unit.coordinator.model.result.test_known import result


@pytest.fixture
def path(tmp_path: Path) -> str:
    return str(write_result(tmp_path, Result.of(result()[0])))


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("text", "dy/dt = -0.1*x"),
        ("json", '"expression": "-x/10.0"'),
        ("csv", "-x/10.0"),
        ("sympy", "x/10"),
        ("latex", "align"),
    ],
)
def test_a_saved_result_is_printed_in_every_form(path: str, capsys: pytest.CaptureFixture[str], how: str, said: str):
    assert main(["result", path, "--format", how]) == 0
    printed = capsys.readouterr().out
    assert said in printed
    assert main(["result", str(Path(path).parent), "--format", how]) == 0
    assert capsys.readouterr().out == printed


def test_members_of_its_fronts_can_be_picked(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["result", path, "--pick", "y=0"]) == 0
    assert "dy/dt = -0.1*x" in capsys.readouterr().out
    assert main(["result", path, "--pick", "y=9"]) == 2


@pytest.mark.parametrize("how", ["text", "json", "csv", "sympy", "latex"])
def test_what_no_terminal_takes_is_printed_as_escapes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str
) -> None:
    foreign = result()[0] | {"state": "failed", "reason": "cut \ud800 off"}
    foreign["equations"][0]["lhs"] = "dy\x1b/dt"
    (tmp_path / "result.json").write_text(json.dumps(foreign), "utf-8")
    assert main(["result", str(tmp_path), "--format", how]) == 0
    assert capsys.readouterr().out.replace("Δ", "").isascii()


@pytest.mark.parametrize("text", [None, "{", "[]", '{"schema": 99, "equations": []}'])
def test_what_is_no_result_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None) -> None:
    path = tmp_path / "result.json"
    if text is not None:
        path.write_text(text, "utf-8")
    assert main(["result", str(path)]) == 2
    assert "saved result.json" in capsys.readouterr().err


def test_what_is_neither_a_result_nor_a_job_is_said(
    tmp_path: Path, path: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)
    assert main(["result", "7f3a"]) == 2
    assert "7f3a is not a saved result, and no coordinator with a job of this id was given" in capsys.readouterr().err
    assert main(["result", str(tmp_path / "reslut.json")]) == 2
    assert capsys.readouterr().err.endswith("give the path of a saved result.json; did you mean 'result.json'?\n")
    assert main(["run", str(tmp_path / "reslut.json"), "--dry-run"]) == 2
    assert "was expected, such as CSV; did you mean 'result.json'?" in capsys.readouterr().err


def test_a_name_is_that_of_a_saved_result_unless_a_coordinator_is_named_and_there_is_none(
    tmp_path: Path, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path.parent)
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)
    (tmp_path.parent / "printed").write_text("", "utf-8")  # as ``coordinator result printed > printed`` has it
    named, unnamed = Namespace(connect="tcp/there:1"), Namespace(connect=None)
    names = [path, tmp_path.name, "printed", "7f3a"]
    assert [is_saved(name, named) for name in names] == [True, True, False, False]
    assert [is_saved(name, unnamed) for name in names] == [True] * 4
