"""``coordinator analyse``: the dynamics of the model of a saved result, as text or JSON."""

import argparse
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.verbs.simulate import assignments, finite_number, load, write
from atoll.terminal.output import as_json, say
from atoll_core.errors import UsageError


def analyse(options: argparse.Namespace) -> int:
    """Analyse the model of ``options.result``. Return the exit code."""
    vary = _vary(options.parameter, options.range)
    bounds = {name: interval(text, f"--box {name}") for name, text in assignments(options.box, "--box", "x=0:3")}
    held = {name: finite_number(text, f"--hold {name}") for name, text in assignments(options.hold, "--hold", "u=1")}
    if options.data is not None and not options.identifiability:
        raise UsageError("--data was given without --identifiability, which alone uses it; give both")
    model = load(options.result, options.group)
    found = model.analyse(bounds, inputs=held, vary=vary)
    known = model.identifiability(data=options.data) if options.identifiability else None
    if options.json:
        text = as_json(found.as_dict() | {"identifiability": None if known is None else known.as_dict()})
    else:
        text = str(found) if known is None else f"{found}\n{known}"
    if options.output is None:
        say(text)
    else:
        write(Path(options.output), text)
    return DONE


def _vary(parameter: str | None, bounds: str | None) -> tuple[str, tuple[float, float]] | None:
    if parameter is None and bounds is None:
        return None
    if parameter is None or bounds is None:
        given, missing = ("--range", "--parameter c1") if parameter is None else ("--parameter", "--range A:B")
        raise UsageError(f"{given} was given without {missing}; give both")
    return parameter, interval(bounds, "--range")


def interval(text: str, option: str) -> tuple[float, float]:
    """Return the bounds of ``0:3``; raises UsageError."""
    lower, separator, upper = text.partition(":")
    if not separator:
        raise UsageError(f"{option} wants LOWER:UPPER, but got {text!r}")
    low, high = finite_number(lower, option), finite_number(upper, option)
    if not low < high:
        raise UsageError(f"{option} wants LOWER below UPPER, but got {text!r}")
    return low, high
