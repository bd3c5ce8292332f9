"""The one place where errors become a sentence and an exit code."""

import argparse
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from atoll.cli import main as entry
from atoll.cli.main import main
from atoll_core.errors import AtollError, DataError, StoreError, UnreachableError, UsageError

Handler = Callable[[argparse.Namespace], int]


@pytest.fixture
def jobs_verb(monkeypatch: pytest.MonkeyPatch) -> Callable[[Handler], None]:
    """Let the verb ``jobs`` do something else."""

    def install(handler: Handler) -> None:
        module = SimpleNamespace(jobs=handler)
        monkeypatch.setattr(entry.importlib, "import_module", lambda name: module)

    return install


def raising(error: BaseException) -> Handler:
    def handler(_: argparse.Namespace) -> int:
        raise error

    return handler


@pytest.mark.parametrize(
    ("error", "code"),
    [(AtollError, 1), (UsageError, 2), (DataError, 2), (UnreachableError, 3), (StoreError, 1)],
)
def test_our_errors_are_one_sentence_and_their_exit_code(
    jobs_verb: Callable[[Handler], None], error: type[AtollError], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs_verb(raising(error("this is so")))
    assert main(["jobs"]) == code
    assert capsys.readouterr().err == "coordinator: this is so\n"


def test_an_interrupt_is_exit_code_130_without_words(
    jobs_verb: Callable[[Handler], None], capsys: pytest.CaptureFixture[str]
) -> None:
    jobs_verb(raising(KeyboardInterrupt()))
    assert main(["jobs"]) == 130
    assert capsys.readouterr().err == ""


def test_an_unexpected_error_is_one_sentence_that_names_the_log(
    jobs_verb: Callable[[Handler], None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("ATOLL_DEBUG", raising=False)
    jobs_verb(raising(ZeroDivisionError("deep inside")))
    assert main(["jobs"]) == 1
    sentence = capsys.readouterr().err
    assert sentence.startswith("coordinator: an unexpected error (ZeroDivisionError)")
    (log,) = (tmp_path / "atoll").iterdir()
    assert f"please report it with {log}, which has the details" in sentence
    assert "deep inside" in log.read_text()


def test_of_a_result_that_reads_like_none_an_edit_may_be_the_cause(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("ATOLL_DEBUG", raising=False)
    monkeypatch.setattr(entry, "_dispatch", lambda _: {}["program"])
    assert main(["analyse", "r"]) == 1
    assert capsys.readouterr().err.endswith("; if the result was edited, give it as it was written\n")


def test_an_unexpected_error_is_raised_when_debugging(
    jobs_verb: Callable[[Handler], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATOLL_DEBUG", "1")
    jobs_verb(raising(ZeroDivisionError("deep inside")))
    with pytest.raises(ZeroDivisionError):
        main(["jobs"])


def test_a_reader_that_goes_away_is_no_error() -> None:
    script = (
        "import sys\n"
        "from atoll.cli import main as entry\n"
        "from types import SimpleNamespace\n"
        "def jobs(_):\n"
        "    for _ in range(100000): sys.stdout.write('a line that nobody reads\\n')\n"
        "    return 0\n"
        "entry.importlib.import_module = lambda name: SimpleNamespace(jobs=jobs)\n"
        "sys.exit(entry.main(['jobs']))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(30) == 0


def test_closed_standard_streams_are_no_error() -> None:
    """A service manager, or ``>&-`` in a shell, may start a program without any of them."""
    line = f"{sys.executable} -m atoll serve --listen nonsense"
    for closed in ("<&-", ">&-", "<&- >&-", "<&- >&- 2>&-"):
        done = subprocess.run(f"{line} {closed}", shell=True, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device that is always full")
def test_output_that_cannot_be_written_is_said() -> None:
    code = (
        "from atoll_core.main_program import run_program\n"
        "from atoll.terminal import output\n"
        "from atoll.cli.verbs import jobs\n"
        "jobs.jobs = lambda options: output.say('x'); run_program('atoll.cli.main')"
    )
    line = [sys.executable, "-c", code, "jobs"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "the output cannot be written" in done.stderr
