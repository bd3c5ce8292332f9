"""``coordinator schema``: what a job file may hold, as JSON schema for editors and checkers."""

import argparse
from typing import Final

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import as_json, say
from atoll_core.config import JobConfig

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema(options: argparse.Namespace) -> int:
    """Print the schema of ``--config`` files; return the exit code."""
    del options
    described = {key: value for key, value in JobConfig.model_json_schema().items() if key != "title"}
    say(as_json({"$schema": _DIALECT, "title": "Job file of coordinator run and submit", **described}))
    return DONE
