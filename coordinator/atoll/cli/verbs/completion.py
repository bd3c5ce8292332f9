"""``coordinator completion``: the lines that make a shell complete both programs' words."""

import argparse

from argcomplete.shell_integration import shellcode

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import say

_PROGRAMS = ("coordinator", "island-worker")


def completion(options: argparse.Namespace) -> int:
    """Print the lines for ``options.shell``; return the exit code."""
    say(shellcode(_PROGRAMS, shell=options.shell))
    return DONE
