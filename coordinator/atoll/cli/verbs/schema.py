"""``coordinator schema``: what job files and result files may hold, as JSON schema for editors and checkers."""

import argparse
from collections.abc import Mapping
from typing import Final

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import as_json, say
from atoll_core.config import JobConfig

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema(options: argparse.Namespace) -> int:
    """Print the schema of ``--config`` files or of ``result.json``; return the exit code."""
    say(as_json(_of_results() if options.file == "result" else _of_job_files()))
    return DONE


def _of_results() -> Mapping[str, object]:
    from atoll_coordinator.result.result import json_schema

    return json_schema()


def _of_job_files() -> Mapping[str, object]:
    described = {key: value for key, value in JobConfig.model_json_schema().items() if key != "title"}
    return {"$schema": _DIALECT, "title": "Job file of coordinator run and submit", **described}
