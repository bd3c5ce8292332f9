"""Types of options that both programs have. What a shell is answered that asks how words go on."""

import argparse
import os
import subprocess
import sys

import pytest

from atoll.cli.main import main
from atoll.cli.parser import build_parser
from atoll_core.command_line import SHELLS, complete, duration, seconds, whole_number


@pytest.mark.parametrize(
    ("text", "expected"),
    [("90", 90.0), ("90s", 90.0), ("1.5h", 5400.0), ("2m", 120.0), ("2min", 120.0), ("1d", 86400.0), ("250ms", 0.25)],
)
def test_a_duration_has_a_unit_or_is_seconds(text: str, expected: float) -> None:
    assert duration(text) == expected


@pytest.mark.parametrize("text", ["", "s", "-1s", "1w", "nan", "infs", "1 m", "10^3", "1s2"])
def test_what_is_no_duration_is_said_with_examples(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="a time such as 90s, 30m or 12h was expected"):
        duration(text)


def test_numbers_outside_their_limits_are_refused() -> None:
    assert (seconds("0"), whole_number(-10, 10)("-10")) == (0.0, -10)
    for parse, text in ((seconds, "-1"), (seconds, "1e9"), (whole_number(1, 5), "6"), (whole_number(1, 5), "1.0")):
        with pytest.raises(argparse.ArgumentTypeError, match="expected"):
            parse(text)


def completed(program: str, line: str) -> list[str]:
    """Return how the last word of `line` may go on: in a process of its own, of which the library takes fixed pipes."""
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    command = f'exec "{sys.executable}" -m {program} 8>&1 9>/dev/null >/dev/null'
    ended = subprocess.run(["sh", "-c", command], env={**os.environ, **asked}, stdout=subprocess.PIPE, check=True)
    return [word.strip() for word in ended.stdout.decode().split("\n")]


@pytest.mark.parametrize(
    ("program", "line", "words"),
    [
        ("atoll", "coordinator ru", {"run"}),
        ("atoll", "coordinator run a.csv --preset ", {"default", "paper"}),
        ("atoll_island_worker", "island-worker --proc", {"--processes"}),
    ],
)
def test_verbs_options_and_their_choices_are_completed(program: str, line: str, words: set[str]) -> None:
    assert words <= set(completed(program, line))


def test_nothing_happens_where_no_shell_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("_ARGCOMPLETE", raising=False)
    assert complete(build_parser()) is None


@pytest.mark.parametrize("shell", SHELLS)
def test_the_lines_for_a_shell_name_both_programs(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    printed = capsys.readouterr().out
    assert "coordinator" in printed
    assert "island-worker" in printed
