"""The options that may be given for one equation each, such as ``--guess dx=3*x`` or ``--operators x=+,*``. Pure."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from atoll.cli.options.names import names
from atoll_core.errors import UsageError

_EXAMPLES: Final = {
    "--guess": "dx=3*x-2*x*y",
    "--known": "dy=-x/10",
    "--operators": "x=+,-,*",
    "--allow": "x=x,y",
    "--require": "x=y",
    "--bound": "c > 0, or x: x*y < 0",
    "--unit": "x=m/s",
}
_ALL: Final = "*"


def prior_settings(given: Mapping[str, Sequence[str] | None]) -> dict[str, Any]:
    """Return the values that repeatable options set, by dotted key of the configuration.

    Args:
        given: the texts of ``--guess``, ``--known``, ``--operators``, ``--allow``, ``--require``, ``--bound`` and
            ``--unit``, by option; None where not given.

    Raises:
        UsageError: a text has not the form of its option, or says something twice.
    """
    values: dict[str, Any] = {}
    if given["--guess"] is not None:
        values["prior.guesses"] = _guesses(given["--guess"])
    if given["--known"] is not None:
        values["prior.known"] = _by_equation("--known", given["--known"])
    if given["--operators"] is not None:
        values |= _operators(given["--operators"])
    if given["--allow"] is not None:
        allowed = _by_equation("--allow", given["--allow"])
        values["space.variables_of"] = {side: names(text, "--allow", "variable") for side, text in allowed.items()}
    if given["--require"] is not None:
        required = _by_equation("--require", given["--require"])
        values["space.required_of"] = {side: names(text, "--require", "variable") for side, text in required.items()}
    if given["--bound"] is not None:
        values["prior.bounds"] = _bounds(given["--bound"])
    if given["--unit"] is not None:
        values["data.units"] = _by_equation("--unit", given["--unit"], noun="the unit")
    return values


def _bounds(texts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return bounds by equation; what stands before a colon names it."""
    bounds: dict[str, tuple[str, ...]] = {}
    for text in texts:
        side, colon, rest = text.rpartition(":")
        if not rest.strip() or (colon and not side.strip()):
            raise UsageError(f"--bound must be of the form {_EXAMPLES['--bound']}, but {text!r} was given")
        key = side.strip() or _ALL
        bounds[key] = (*bounds.get(key, ()), rest.strip())
    return bounds


def _guesses(texts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    guesses: dict[str, tuple[str, ...]] = {}
    for text in texts:
        side, right = _parted("--guess", text)
        guesses[side] = (*guesses.get(side, ()), right)
    return guesses


def _operators(texts: Sequence[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    general = [text for text in texts if "=" not in text]
    if len(general) > 1:
        raise UsageError(
            f"--operators gives two lists for all equations; give one, others as {_EXAMPLES['--operators']}"
        )
    if general:
        values["space.operators"] = names(general[0], "--operators", "operator")
    special = _by_equation("--operators", [text for text in texts if "=" in text])
    if special:
        values["space.operators_of"] = {side: names(its, "--operators", "operator") for side, its in special.items()}
    return values


def _by_equation(option: str, texts: Sequence[str], noun: str = "the equation") -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        side, right = _parted(option, text)
        if side in found:
            raise UsageError(f"{option} names {noun} of {side!r} twice; give one")
        found[side] = right
    return found


def _parted(option: str, text: str) -> tuple[str, str]:
    """Return both sides of the last ``=``, which no expression or list holds."""
    side, _, right = text.rpartition("=")
    if not side.strip() or not right.strip():
        raise UsageError(f"{option} must be of the form {_EXAMPLES[option]}, but {text!r} was given")
    return side.strip(), right.strip()
