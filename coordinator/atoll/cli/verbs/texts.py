"""``coordinator schema`` prints JSON schemas of job and result files; ``completion`` prints code for shells."""

import argparse
from typing import Final

from argcomplete.shell_integration import shellcode

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import as_json, say
from atoll_core.config import JobConfig

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema(options: argparse.Namespace) -> int:
    """Print the schema of ``--config`` files or of ``result.json``; return the exit code."""
    if options.file == "result":
        from atoll_coordinator.result.result import json_schema

        say(as_json(json_schema()))
    else:
        head = {"$schema": _DIALECT, "title": "Job file of coordinator run and submit"}
        say(as_json(head | JobConfig.model_json_schema() | head))
    return DONE


_PROGRAMS = ("coordinator", "island-worker")


def completion(options: argparse.Namespace) -> int:
    """Print the code for the completion of commands by ``options.shell``; return the exit code."""
    say(shellcode(_PROGRAMS, shell=options.shell))
    return DONE
