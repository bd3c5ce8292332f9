"""``coordinator suggest``: the next experiment for the model of a saved result, as text or JSON."""

import argparse

from atoll.cli.exit_codes import DONE
from atoll.cli.options.values import finite_number, intervals, whole_number
from atoll.cli.saved_model import deliver, load
from atoll.terminal.output import as_json
from atoll_core.errors import UsageError


def suggest(options: argparse.Namespace) -> int:
    """Suggest experiments for ``options.result``. Return the exit code."""
    suggestions = load(options).suggest(
        intervals(options.box, "--box"),
        duration=None if options.duration is None else finite_number(options.duration, "--duration"),
        samples=None if options.samples is None else whole_number(options.samples, "--samples"),
        cost=options.cost,
        count=whole_number(options.count, "--count"),
        rivals=[_rival(text) for text in options.rival],
        seed=whole_number(options.seed, "--seed"),
        data=options.data,
    )
    deliver(as_json(suggestions.as_dict()) if options.json else str(suggestions), options.output)
    return DONE


def _rival(text: str) -> dict[str, str]:
    """Split ``dx=EXPR; dy=EXPR`` into right-hand sides by left-hand side."""
    equations: dict[str, str] = {}
    for equation in filter(None, (part.strip() for part in text.split(";"))):
        side, separator, right = (part.strip() for part in equation.partition("="))
        if not separator or not side or not right:
            raise UsageError(f"--rival wants dx=EXPR, several separated by ';', but got {text!r}")
        equations[side] = right
    if not equations:
        raise UsageError("--rival wants dx=EXPR, but got nothing")
    return equations
