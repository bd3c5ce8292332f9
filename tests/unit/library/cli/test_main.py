"""The one place where errors become a sentence and an exit code."""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from atoll.cli import main as entry
from atoll.cli.exit_codes import exit_code_and_reason
from atoll.cli.main import main
from atoll.cli.parser import VERBS, build_parser, parse
from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import AtollError, DataError, StoreError, UnreachableError, UsageError
from atoll_core.wire.messages.views import VariableView
from tests.views import job_view

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
    [
        *((AtollError, 1), (UsageError, 2), (DataError, 2), (UnreachableError, 3), (StoreError, 1)),
        (KeyboardInterrupt, 130),
    ],
)
def test_our_errors_are_one_sentence_and_their_exit_code_and_an_interrupt_says_nothing(
    jobs_verb: Callable[[Handler], None], error: type[BaseException], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs_verb(raising(error("this is so")))
    assert main(["jobs"]) == code
    assert capsys.readouterr().err == ("" if error is KeyboardInterrupt else "coordinator: this is so\n")


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
    assert f"please report it, with the details in {log}" in sentence
    assert "deep inside" in log.read_text()


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


def test_help_lists_the_verbs() -> None:
    text = build_parser().format_help()
    assert all(f"    {verb}" in text for verb in VERBS)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run", ["DATA is missing; see coordinator run --help"]),
        ("result", ["ID is missing"]),
        ("run a.csv --bogus", ["unknown option --bogus"]),
        ("run a.csv --seed", ["--seed needs a value; see coordinator run --help"]),
        ("run a.csv --workers 0", ["--workers", "from 1 to 1024", "'0'"]),
        ("run a.csv --workers two", ["--workers", "from 1 to 1024", "'two'"]),
        ("run a.csv --workers 100000", ["--workers", "from 1 to 1024", "'100000'"]),
        ("result abc --format yaml", ["--format must be one of", "json", "'yaml'"]),
        ("frobnicate", ["must be one of", "submit", "'frobnicate'"]),
        ("sumbit a.csv", ["must be one of", "see coordinator --help; did you mean 'submit'?"]),
        ("run a.csv --stats x", ["unknown option --stats x; see coordinator run --help; did you mean '--states'?"]),
        ("run a.csv --sede=3", ["did you mean '--seed'?"]),
        ("jobs one two", ["one word too many: two; see coordinator jobs --help\n"]),
        ("result a --format jsn", ["'jsn' was given", "did you mean 'json'?"]),
        ("", ["no command was given"]),
        ("run a.csv --max", ["unknown option --max"]),
        ("delete", ["ID is missing"]),
        ("run a.csv --report=x", ["--report takes no value, but 'x' was given"]),
        *(
            (f"serve --keep {keep}", ["--keep", "90d,8G", repr(keep)])
            for keep in ("90", "1d,2d", "0d", "8g", "1.5d", "1d,")
        ),
    ],
)
def test_a_wrong_command_line_is_one_sentence_and_exit_code_2(
    line: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("coordinator: ")
    assert printed.err.count("\n") == 1
    assert all(word in printed.err for word in words)


@pytest.mark.parametrize("line", ["--operators -,+", "--operators=-,+"])
def test_a_list_of_operators_may_begin_with_minus(line: str) -> None:
    assert parse(["run", "a.csv", *line.split()]).operators == ["-,+"]


@pytest.mark.parametrize(
    ("text", "limits"),
    [("90d,8G", (90 * 86400, 8 * 10**9)), ("500M", (None, 500 * 10**6)), ("12h", (43200, None)), ("all", (None, None))],
)
def test_what_serve_keeps_is_an_age_and_a_size(text: str, limits: tuple[int | None, int | None]) -> None:
    assert parse(["serve", "--keep", text]).keep == limits
    assert parse(["serve"]).keep == (90 * 86400, 8 * 10**9)


def test_submit_knows_every_option_of_the_data_the_search_and_the_budget_that_run_knows() -> None:
    run, submit = vars(parse(["run", "a"])), vars(parse(["submit", "a"]))
    assert set(run) - set(submit) == {"web", "workers"}


def test_abbreviated_options_are_not_guessed() -> None:
    with pytest.raises(UsageError, match="unknown option"):
        parse(["run", "a.csv", "--tar", "y"])


@pytest.mark.parametrize(
    ("does", "heavy"),
    [
        ("from atoll.cli.main import main; main(['run', '--help'])",
         "numpy pydantic zenoh numba sympy polars rich scipy msgpack"),
        ("import atoll.cli.verbs.submit, atoll_coordinator.service.service_loop", "numba scipy sympy polars"),
    ],
)  # fmt: skip
def test_only_what_is_needed_is_imported(does: str, heavy: str) -> None:
    """The promise of an instant ``--help`` is kept by what is not imported, which can be asserted; time cannot."""
    script = (
        "import sys, contextlib, io\nwith contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        f"    {does}\nprint(sorted(set({heavy.split()}) & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_schema_has_every_setting_with_its_description(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed["properties"]) == set(JobConfig.model_fields)
    assert printed["additionalProperties"] is False
    data = printed["$defs"]["DataConfig"]["properties"]
    assert set(data) == set(DataConfig.model_fields)
    assert "time column" in data["time"]["description"]


def finished(converged: bool) -> tuple[VariableView, ...]:
    return (VariableView(variable="x", lhs="dx/dt", epoch=3, converged=converged, finished=True),)


FOUND = (VariableView(variable="x", lhs="dx/dt", epoch=3, expression="2.0*x"),)


@pytest.mark.parametrize(
    ("changes", "target", "code", "words"),
    [
        ({"state": "done", "variables": finished(True)}, None, 0, None),
        ({"state": "done", "variables": finished(False)}, None, 0, None),
        ({"state": "done", "variables": finished(True)}, 1e-4, 0, None),
        ({"state": "done", "variables": finished(False)}, 1e-4, 4, "--target-error 0.0001 was not met"),
        ({"state": "failed", "reason": "two workers diverged", "fault": "diverged"}, None, 1, "two workers diverged"),
        ({"state": "failed", "reason": "column x is constant", "fault": "data"}, None, 2, "column x is constant"),
        ({"state": "cancelled"}, None, 130, "was cancelled, before it found any equation"),
        ({"state": "cancelled", "variables": FOUND}, None, 130, "was cancelled; its best equations are kept"),
    ],
)
def test_the_end_of_a_job_decides_the_exit_code(
    changes: dict[str, object], target: float | None, code: int, words: str | None
) -> None:
    found, sentence = exit_code_and_reason(job_view(target_error=target, **changes))
    assert found == code
    assert (sentence is None) == (words is None)
    assert words is None or words in (sentence or "")
