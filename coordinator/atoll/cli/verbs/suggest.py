"""``coordinator suggest``: the next experiment for the model of a saved result, as text or JSON."""

import argparse
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.verbs.analyse import interval
from atoll.cli.verbs.simulate import assignments, finite_number, load, write
from atoll.terminal.output import as_json, say
from atoll_core.errors import UsageError


def suggest(options: argparse.Namespace) -> int:
    """Suggest experiments for ``options.result``. Return the exit code."""
    bounds = {name: interval(text, f"--box {name}") for name, text in assignments(options.box, "--box", "x=0:3")}
    found = load(options.result, options.group).suggest(
        bounds,
        duration=None if options.duration is None else finite_number(options.duration, "--duration"),
        samples=None if options.samples is None else _whole(options.samples, "--samples"),
        cost=options.cost,
        count=_whole(options.count, "--count"),
        rivals=[_rival(text) for text in options.rival],
        seed=_whole(options.seed, "--seed"),
        data=options.data,
    )
    text = as_json(found.as_dict()) if options.json else str(found)
    if options.output is None:
        say(text)
    else:
        write(Path(options.output), text)
    return DONE


def _rival(text: str) -> dict[str, str]:
    """Split ``dx=EXPR; dy=EXPR`` into right-hand sides by left-hand side."""
    found: dict[str, str] = {}
    for part in filter(None, (each.strip() for each in text.split(";"))):
        side, separator, right = (each.strip() for each in part.partition("="))
        if not separator or not side or not right:
            raise UsageError(f"--rival wants dx=EXPR, several separated by ';', but got {text!r}")
        found[side] = right
    if not found:
        raise UsageError("--rival wants dx=EXPR, but got nothing")
    return found


def _whole(text: str, option: str) -> int:
    value = finite_number(text, option)
    if value != int(value) or value < 0:
        raise UsageError(f"{option} must be a whole number, 0 or more, but {text!r} was given")
    return int(value)
