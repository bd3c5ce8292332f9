"""``coordinator analyse``: the dynamics of the model of a saved result, as text or JSON."""

import argparse

from atoll.cli.exit_codes import DONE
from atoll.cli.options.values import interval, intervals, numbers
from atoll.cli.saved_model import deliver, load
from atoll.terminal.output import as_json
from atoll_core.errors import UsageError


def analyse(options: argparse.Namespace) -> int:
    """Analyse the model of ``options.result``. Return the exit code."""
    vary = _vary(options.parameter, options.range)
    bounds, held = intervals(options.box, "--box"), numbers(options.hold, "--hold", "u=1")
    if options.data is not None and not options.identifiability:
        raise UsageError("--data was given without --identifiability, which alone uses it; give both")
    model = load(options)
    analysis = model.analyse(bounds, inputs=held, vary=vary)
    known = model.identifiability(data=options.data) if options.identifiability else None
    if options.json:
        text = as_json(analysis.as_dict() | {"identifiability": None if known is None else known.as_dict()})
    else:
        text = str(analysis) if known is None else f"{analysis}\n{known}"
    deliver(text, options.output)
    return DONE


def _vary(parameter: str | None, bounds: str | None) -> tuple[str, tuple[float, float]] | None:
    if parameter is None and bounds is None:
        return None
    if parameter is None or bounds is None:
        given, missing = ("--range", "--parameter c1") if parameter is None else ("--parameter", "--range A:B")
        raise UsageError(f"{given} was given without {missing}; give both")
    return parameter, interval(bounds, "--range")
