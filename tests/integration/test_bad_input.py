"""Bad input through the whole of ``coordinator run``: one sentence that helps, exit code 2, nothing left behind."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from atoll_coordinator.cli.local import workers as local
from atoll_coordinator.cli.main import main

pytestmark = pytest.mark.timeout(200)

GOOD = "t,x,y\n" + "".join(f"{0.1 * i:.1f},{i * i * 0.01},{1 + 0.1 * i}\n" for i in range(40))


def changed(line: int, text: str) -> str:
    lines = GOOD.splitlines()
    lines[line] = text
    return "\n".join(lines) + "\n"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run the command on a file with `text`; check exit code and form; return the sentence.

    The worker is a process that does nothing: no search begins on bad data.
    """
    idle = [sys.executable, "-S", "-c", "import signal; signal.pause()"]
    monkeypatch.setattr(local, "worker_command", lambda endpoint, name: idle)
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
        return sentences[0]

    return run


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, ["data.csv", "does not exist"]),
        ("", ["data.csv", "empty"]),
        ("t,x,y\n", ["data.csv"]),
        ("t,x,y\n0,1,2\n", ["1 row"]),
        (changed(5, "0.4,abc,1.4"), ["data.csv", "6", "x", "'abc'"]),
        (changed(5, "0.4,nan,1.4"), ["x", "row", "5", "--missing drop"]),
        (changed(5, "0.4,inf,1.4"), ["x", "row", "5", "--missing drop"]),
        (changed(5, "0.25,1,1.4"), ["t", "0.25"]),
        (changed(5, "0.3,1,1.4"), ["t", "0.3"]),
        (GOOD.replace("t,x,y", "t,x,x"), ["'x'", "name"]),
        (GOOD.replace("t,x,y", "s,x,y"), ["time", "t"]),
        ("t,x,y\n" + "".join(f"{i},{i * i},3\n" for i in range(40)), ["y", "constant"]),
    ],
)
def test_bad_data_are_refused_with_one_sentence(run: Callable[..., str], text: str | None, words: list[str]) -> None:
    sentence = run(text)
    assert [word for word in words if word not in sentence] == []


def test_a_device_is_not_called_missing(run: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "data.csv").symlink_to("/dev/null")
    assert "a pipe or a device" in run(None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--states x,z", ["'z'", "x, y"]),
        ("--time when", ["'when'", "t"]),
        ("--target q", ["'q'"]),
        ("--only z", ["'z'"]),
        ("--angle phi", ["'phi'"]),
        ("--operators +,foo", ["'foo'", "tanh"]),
        ("--target y --order 2", ["--order 2", "--target"]),
        ("--states x --inputs x", ["'x'", "--states", "--inputs"]),
        ("--max-epochs z=5", ["'z'"]),
        ("--known dz=x", ["--known", "'dz'", "x, y"]),
        ("--known d2x=y", ["'d2x'", "--order 2"]),
        ("--guess x=3*w", ["--guess", "'w'", "x, y"]),
        ("--guess x=tanh(y)", ["tanh(y)", "'tanh'"]),
        ("--guess x=1 --known x=2", ["--guess", "'x'", "known"]),
        ("--allow x=z", ["--allow", "'z'", "x, y"]),
        ("--operators z=+", ["--operators", "'z'", "x, y"]),
    ],
)
def test_bad_options_are_refused_with_one_sentence(run: Callable[..., str], options: str, words: list[str]) -> None:
    sentence = run(GOOD, *options.split())
    assert [word for word in words if word not in sentence] == []
