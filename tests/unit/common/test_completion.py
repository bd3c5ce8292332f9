"""What a shell is answered that asks how words go on."""

import os
import subprocess
import sys

import pytest

from atoll.cli.main import main
from atoll.cli.options import build_parser
from atoll_core.completion import SHELLS, complete


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
