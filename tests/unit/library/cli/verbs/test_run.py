"""How many workers a local run starts, and that a dry run starts none."""

import json
from pathlib import Path

import pytest

from atoll.cli.main import main


@pytest.mark.parametrize("verb", ["run", "submit"])
def test_a_dry_run_says_what_would_be_done_and_does_nothing(
    verb: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)
    Path("a.txt").write_text("# t x\n" + "".join(f"{row} {row * row}\n" for row in range(20)))
    assert main([verb, "a.txt", "--dry-run"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("1 equation would be searched:\n  dx/dt = f(x) of + - * / sin cos\n")
    assert "read as text with spaces; header in a comment\n" in printed.err
    assert main([verb, "a.txt", "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["equations"][0]["lhs"] == "dx/dt"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_dry_run_says_what_the_columns_say(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = [f"{row},{value},{-9999 if row in (3, 9) else row}" for row, value in enumerate([1.0, 1.5, 2.5, 4.5] * 5)]
    Path("a.csv").write_text("\n".join(["t,x,y", *rows]))
    assert main(["run", "a.csv", "--dry-run", "--json"]) == 0
    printed = capsys.readouterr()
    assert "warning: 2 rows hold -9999 in 'y'" in printed.err
    assert "add --missing-value -9999." in json.loads(printed.out)["warnings"][0]
    assert main(["run", "a.csv", "--dry-run", "--missing-value", "-9999"]) == 0
    assert "-9999" not in capsys.readouterr().err


def test_a_dry_run_refuses_what_a_run_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,two\n")
    assert main(["run", str(tmp_path / "a.csv"), "--dry-run"]) == 2
    assert (
        capsys.readouterr().err == "coordinator: column 'x' of a.csv holds 'two' in line 3 where a number is expected\n"
    )
