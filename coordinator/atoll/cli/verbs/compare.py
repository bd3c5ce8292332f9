"""``coordinator compare``: two results, or candidates of results, beside each other."""

import argparse
import re
import shlex
from pathlib import Path

from atoll.api.tables import table_of
from atoll.cli.exit_codes import DONE
from atoll.cli.request import result_of
from atoll.cli.verbs.models import deliver
from atoll.experiments.comparison import compare as compare_results
from atoll.experiments.fits import config_of
from atoll.model.model import Model
from atoll.terminal.output import as_json
from atoll_core.errors import UsageError


def compare(options: argparse.Namespace) -> int:
    """Compare the models ``options.first`` and ``options.second``. Return the exit code."""
    first, number = _parts(options.first)
    second, other = _parts(options.second)
    if not first:
        raise UsageError(f"A is {options.first!r}, but a result was expected, such as runs/JOB{options.first}")
    models = [_model(name, place, options) for name, place in ((first, number), (second or first, other))]
    files: list[str] | None = options.data
    table = None if files is None else table_of(files, config_of(models[0].result).data)
    names = (options.first, options.second if second else f"{first}{options.second}")
    compared = compare_results(models[0].result, models[1].result, names, table)
    deliver(as_json(compared.as_dict()) if options.json else str(compared), options.output)
    return DONE


def _parts(text: str) -> tuple[str, int | None]:
    """Return the name of a result, and the number of its candidate; None: the equations that it shows."""
    found = re.fullmatch(r"(.*):(\d+)", text, re.DOTALL)
    if found is None or Path(text).exists():
        return text, None
    return found[1], int(found[2])


def _model(name: str, number: int | None, options: argparse.Namespace) -> Model:
    model = Model(result_of(name, options))
    model = model if options.group is None else model.of_group(options.group)
    if number is None:
        return model
    if not 1 <= number <= len(model.candidates):
        there = f"it has candidates 1 to {len(model.candidates)}" if model.candidates else "it has no candidates"
        raise UsageError(f"{shlex.quote(name)} has no candidate {number}: {there}")
    return model.candidates[number - 1]
