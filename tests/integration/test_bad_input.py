"""Bad input through the whole of ``coordinator run``: one sentence that helps, exit code 2, nothing left behind.

What is bad input is tested where it is decided: ``tests/unit/coordinator/test_bad_input.py``.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.client import local_processes as local
from tests.unit.coordinator.test_bad_input import GOOD, changed

pytestmark = pytest.mark.timeout(200)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run the command on a file with `text`; check exit code and form; return the sentence.

    What the command cannot say by itself of the data, a worker finds when it prepares them.
    """
    endpoints: list[str] = []
    command = local.supervisor_command
    monkeypatch.setattr(
        local, "supervisor_command", lambda endpoint, number: (endpoints.append(endpoint), command(endpoint, number))[1]
    )
    monkeypatch.chdir(tmp_path)

    def run(text: str | None, *options: str) -> str:
        if text is not None:
            (tmp_path / "data.csv").write_text(text)
        assert main(["run", "data.csv", "--workers", "1", "--out", "out", *options]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert "Traceback" not in printed.err
        sentences = [line for line in printed.err.splitlines() if line.startswith("coordinator: ")]
        assert len(sentences) == 1
        assert not (tmp_path / "out").exists()
        assert endpoints.pop().startswith("unixsock-stream/")  # which other users of this machine cannot reach
        return sentences[0]

    return run


def test_bad_data_are_refused_with_one_sentence(run: Callable[..., str]) -> None:
    sentence = run(changed(5, "0.4,abc,1.4"))
    assert [word for word in ("data.csv", "6", "x", "'abc'") if word not in sentence] == []


@pytest.mark.slow
def test_bad_options_are_refused_with_one_sentence(run: Callable[..., str]) -> None:
    sentence = run(GOOD, "--max-epochs", "z=5")
    assert "'z'" in sentence
