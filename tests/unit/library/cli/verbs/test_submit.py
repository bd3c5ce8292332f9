"""``coordinator submit``: whoever leaves while a job is on its way is told its id."""

import contextlib
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import submit as verb


class Impatient:
    """A client whose user presses Ctrl-C while it waits for the coordinator."""

    def hand_in(self, *_: object, **__: object) -> None:
        raise KeyboardInterrupt


def test_an_interrupted_submission_names_the_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It may have been taken in, and nobody else knows the id that was made up."""
    data = tmp_path / "data.csv"
    data.write_text("t,x\n" + "\n".join(f"{n},{n * n}" for n in range(20)), "utf-8")
    monkeypatch.setattr(verb, "connected", lambda *_: contextlib.nullcontext(Impatient()))
    assert main(["submit", str(data), "--id", "mine", "--no-wait", "--connect", "tcp/there:7447"]) == 130
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "job mine" in printed.err
    assert "coordinator status mine --connect tcp/there:7447" in printed.err
