"""The command line: verbs, options, what is refused and how."""

import subprocess
import sys

import pytest

from atoll.cli.main import main
from atoll.cli.options.parser import HANDLERS, build_parser, parse
from atoll_core.errors import UsageError


def test_help_lists_the_verbs() -> None:
    text = build_parser().format_help()
    assert all(f"    {verb}" in text for verb in HANDLERS)


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


def test_options_and_files_may_come_in_any_order() -> None:
    options = parse(["run", "--seed", "3", "a.csv", "b.csv", "--json"])
    assert options.data == ["a.csv", "b.csv"]
    assert (options.seed, options.json, options.verb) == ("3", True, "run")


def test_submit_knows_every_option_of_the_data_the_search_and_the_budget_that_run_knows() -> None:
    run, submit = vars(parse(["run", "a"])), vars(parse(["submit", "a"]))
    assert set(run) - set(submit) == {"web", "workers"}


def test_abbreviated_options_are_not_guessed() -> None:
    with pytest.raises(UsageError, match="unknown option"):
        parse(["run", "a.csv", "--tar", "y"])


def test_help_imports_none_of_the_heavy_libraries() -> None:
    """The promise of an instant ``--help`` is kept by what is not imported, which can be asserted; time cannot."""
    script = (
        "import sys, contextlib, io\n"
        "from atoll.cli.main import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "    main(['run', '--help'])\n"
        "heavy = {'numpy', 'pydantic', 'zenoh', 'numba', 'sympy', 'polars', 'rich', 'scipy', 'msgpack'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_kernels_are_for_the_processes_that_compute() -> None:
    script = (
        "import sys\n"
        "import atoll.cli.local_run, atoll_coordinator.service.service_loop\n"
        "print(sorted({'numba', 'scipy', 'sympy', 'polars'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
