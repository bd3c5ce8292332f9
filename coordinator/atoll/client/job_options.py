"""The table of a job's options: for each its name, the settings of the job, the parser of its value, and its help.

Command line and Python have the same options. On the command line values are texts; in Python they may also be numbers,
lists and mappings. This module imports only the standard library, because ``--help`` must be instant.
"""

import argparse
import contextlib
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple, SupportsFloat, SupportsIndex, cast

from atoll_core.command_line import duration
from atoll_core.errors import Field, UsageError

MOST_WORKERS: Final = 1024
"""Maximum number of worker processes on one machine."""

_ALL: Final = "*"
_PARAMETER: Final = re.compile(r"(?P<name>[^\W\d]\w*)\s*(?:=\s*(?P<numbers>.*))?", re.DOTALL)
_BY: Final = re.compile(r"(?P<parameter>.+?)\s*[\s=]\s*by\s+(?P<by>\w+)", re.DOTALL)
_NUMBERS: Final = re.compile(
    r"(?:(?P<start>\S+)\s+in\s+)?(?=.*\d)(?P<lower>\S*?)\s*(?<!\.)\.\.(?!\.)\s*(?P<upper>\S*)|(?P<only>\S+)"
)
"""Start value and bounds of a parameter. ``0...5`` is refused: the third dot may belong to 0.5."""
_PARAMETER_FORMS: Final = "c, c=1, c=0.1..10, 'c=1 in 0.1..10' or 'c=0.1..10 by run'"

Read = Callable[[object, Field], object]
"""Returns the setting for a value, or a tuple for several settings; raises UsageError that names the field."""


class Repeated(list[str]):
    """The texts of an option that was given once or several times on a command line."""


class Option(NamedTuple):
    """One option: ``--max-time`` on the command line, `max_time` in Python."""

    name: str
    settings: str
    """Dotted names in `JobConfig`, separated by spaces; `read` returns a value for each name, None: not set."""
    read: Read
    metavar: str | None
    """None: a switch."""
    help: str
    is_repeatable: bool = False

    @property
    def flag(self) -> str:
        """The option of the command line."""
        return Field(self.name).on_command_line

    def decide(self, value: object) -> dict[str, object]:
        """Return the settings that follow from `value`, by dotted name; raises UsageError."""
        values = self.read(value, Field(self.name))
        settings = self.settings.split()
        parts = (values,) if len(settings) == 1 else cast(tuple[object, ...], values)
        return {name: part for name, part in zip(settings, parts, strict=True) if part is not None}


def text(value: object, field: Field) -> str:
    """Return a text; a number becomes text."""
    if isinstance(value, bool) or not (isinstance(value, str) or hasattr(value, "__index__")):
        raise UsageError("%s must be text, but %r was given", field, value)
    return str(value)


def whole(value: object, field: Field) -> int:
    """Return a whole number."""
    with contextlib.suppress(TypeError, ValueError):
        if not isinstance(value, bool):
            return int(value) if isinstance(value, str) else operator.index(cast(SupportsIndex, value))
    raise UsageError("%s must be a whole number, but %r was given", field, value)


def number(value: object, field: Field) -> float:
    """Return a number."""
    with contextlib.suppress(TypeError, ValueError):
        if not isinstance(value, bool):
            return float(cast(SupportsFloat, value))
    raise UsageError("%s must be a number such as 1e-4, but %r was given", field, value)


def several_numbers(value: object, field: Field) -> tuple[float, ...]:
    """Return one number or a list of numbers as a tuple."""
    return tuple(number(part, field) for part in _several(value))


def seconds(value: object, field: Field) -> float:
    """Return the seconds of ``90``, ``60s``, ``10m`` or ``1.5h``."""
    with contextlib.suppress(argparse.ArgumentTypeError):
        if (amount := duration(str(value))) > 0.0:
            return amount
    raise UsageError("%s must be a time above zero such as 90, 60s, 10m or 1h, but %r was given", field, value)


def names(value: object, field: Field, noun: str = "column") -> tuple[str, ...]:
    """Return the names in a list or a text such as ``x,y``; names with a comma are in quotes. `noun` is for errors."""
    import csv

    if isinstance(value, (list, tuple)):
        parts = tuple(text(part, field).strip() for part in value)
    else:
        line = text(value, field)
        parts = tuple(part.strip() for part in next(csv.reader([line], skipinitialspace=True), []))
    if not parts or not all(parts):
        raise UsageError("%s must be %s names separated by commas, but %r was given", field, noun, value)
    twice = next((part for part in parts if parts.count(part) > 1), None)
    if twice is not None:
        raise UsageError("%s names %r twice; name every %s once", field, twice, noun)
    return parts


def hidden_states(value: object, field: Field) -> tuple[str, ...]:
    """Return the names of hidden states, or their number as the only text."""
    found = names(value, field, "state")
    if len(found) > 1 and any(part.isdecimal() for part in found):
        raise UsageError("%s must be names of states or one number, but %r was given", field, value)
    return found


def epochs(value: object, field: Field) -> tuple[int | None, dict[str, int] | None]:
    """Return the epochs for all equations and by variable, from ``50``, ``x=20,y=12``, both, or a mapping."""
    if isinstance(value, Mapping):
        pairs = [*value.items()]
    else:
        pairs = [(name, count) for name, _, count in (part.rpartition("=") for part in names(value, field))]
    counts: dict[str, int] = {}
    for name, count in pairs:
        if name in counts:
            raise UsageError("%s gives two numbers of epochs for %s; give one", field, name or "all equations")
        counts[str(name)] = whole(count, field)
    return counts.pop("", None), counts or None


def holdout(value: object, field: Field) -> int | str:
    """Return a number of trajectories, or ``COLUMN=VALUE`` unchanged."""
    if isinstance(value, str) and "=" in value:
        return value
    with contextlib.suppress(UsageError):
        return whole(value, field)
    raise UsageError("%s must be a number of trajectories or COLUMN=VALUE, but %r was given", field, value)


def switch(value: object, field: Field) -> bool:
    """Return True; raises UsageError for another value."""
    if value is not True:
        raise UsageError("%s must be True or False, but %r was given", field, value)
    return True


def angles(value: object, field: Field) -> list[dict[str, str | bool]]:
    """Return the angles in texts such as ``theta`` and ``theta:deg``."""
    read: list[dict[str, str | bool]] = []
    for part in _several(value):
        line = text(part, field)
        column, _, unit = line.rpartition(":")
        has_unit = bool(column) and unit in ("deg", "rad")
        read.append({"column": column, "degrees": unit == "deg"} if has_unit else {"column": line})
    return read


def by_equation(value: object, field: Field, *, example: str, noun: str = "the equation") -> dict[str, object]:
    """Return right-hand sides by left-hand side, from a mapping or from texts such as ``dy=-x``."""
    sides: dict[str, object] = {}
    for side, right in _pairs(value, field, example):
        if side in sides:
            raise UsageError("%s names %s of %r twice; give one", field, noun, side)
        sides[side] = right
    return sides


def variables(value: object, field: Field, *, example: str) -> dict[str, tuple[str, ...]]:
    """Return the names of variables by left-hand side."""
    return {side: names(right, field, "variable") for side, right in by_equation(value, field, example=example).items()}


def guesses(value: object, field: Field) -> dict[str, tuple[str, ...]]:
    """Return one or several right-hand sides by left-hand side."""
    sides: dict[str, tuple[str, ...]] = {}
    for side, right in _pairs(value, field, "dx=3*x-2*x*y"):
        sides[side] = (*sides.get(side, ()), *map(str, _several(right)))
    return sides


def operators(value: object, field: Field) -> tuple[tuple[str, ...] | None, dict[str, tuple[str, ...]] | None]:
    """Return the operators for all equations and by variable, from ``+,-``, a list, ``x=+,*`` or a mapping."""
    example, noun = "x=+,-,*", "operator"
    lists: Sequence[object] = [] if isinstance(value, Mapping) else value if isinstance(value, Repeated) else [value]
    general = [part for part in lists if not (isinstance(part, str) and "=" in part)]
    if len(general) > 1:
        raise UsageError(
            "%s gives two lists for all equations; give one, and lists for single equations as %s", field, example
        )
    special: object = value if isinstance(value, Mapping) else [part for part in lists if part not in general]
    sides = {side: names(right, field, noun) for side, right in by_equation(special, field, example=example).items()}
    return names(general[0], field, noun) if general else None, sides or None


def bounds(value: object, field: Field) -> dict[str, tuple[str, ...]]:
    """Return bounds by left-hand side (the text before a colon); bounds for all equations have the key ``*``."""
    if isinstance(value, Mapping):
        lines = [f"{side}: {bound}" for side, several in value.items() for bound in _several(several)]
    else:
        lines = [text(line, field) for line in _several(value)]
    sides: dict[str, tuple[str, ...]] = {}
    for line in lines:
        side, colon, bound = (part.strip() for part in line.rpartition(":"))
        if not bound or (colon and not side):
            raise UsageError("%s must be of the form c > 0, or x: x*y < 0, but %r was given", field, line)
        sides[side or _ALL] = (*sides.get(side or _ALL, ()), bound)
    return sides


def shapes(value: object, field: Field, *, example: str) -> dict[str, tuple[str, ...]]:
    """Return one or several shapes by left-hand side."""
    sides: dict[str, tuple[str, ...]] = {}
    for side, right in _pairs(value, field, example):
        sides[side] = (*sides.get(side, ()), *(text(part, field).strip() for part in _several(right)))
    return sides


def parameters(value: object, field: Field) -> dict[str, dict[str, object]]:
    """Return bounds and start values by parameter, from texts such as ``c=1 in 0.1..10 by run``, or from a mapping.

    In a mapping, a value may be None, a start value, a pair of bounds, a text, or a mapping.
    """
    if isinstance(value, Mapping):
        pairs = [_parameter(name, settings, field) for name, settings in value.items()]
    else:
        pairs = [_parameter_text(part, field) for part in _several(value)]
    given: dict[str, dict[str, object]] = {}
    for name, settings in pairs:
        if name in given:
            raise UsageError("%s names %r twice; name it once", field, name)
        by = settings.get("by", "run")
        if by != "run":
            raise UsageError("%s: %r differs by %s, but a parameter is shared or differs 'by run'", field, name, by)
        given[name] = settings
    return given


def initial_values(value: object, field: Field) -> dict[str, dict[str, object]]:
    """Return initial values, or bounds on them, by state; see `parameters`."""
    given = parameters(value, field)
    name = next((name for name, settings in given.items() if "by" in settings), None)
    if name is not None:
        raise UsageError("%s: bounds on %r let its initial value differ by run; leave 'by run' out", field, name)
    return given


def _parameter(name: object, value: object, field: Field) -> tuple[str, dict[str, object]]:
    """Return name and settings of a parameter in a mapping."""
    if value is None:
        return _parameter_text(name, field)
    if isinstance(value, str):
        return _parameter_text(f"{name}={value}", field)
    name, named = _parameter_text(name, field)  # "c by run" is a name, too
    if isinstance(value, Mapping):
        bounds = _bounds(value.get("lower"), value.get("upper"), field)
        others = {str(key): part for key, part in value.items() if key not in ("lower", "upper")}
        return name, {**named, **others, **bounds}
    if isinstance(value, (list, tuple)):
        if len(value) != 2:
            raise UsageError("%s must have two bounds for %s, such as (0.1, 10), but %r was given", field, name, value)
        return name, {**named, **_bounds(value[0], value[1], field)}
    return name, {**named, "start": number(value, field)}


def _parameter_text(part: object, field: Field) -> tuple[str, dict[str, object]]:
    """Return name and settings of a parameter in a text such as ``c=1 in 0.1..10``."""
    line = text(part, field).strip()
    divided = _BY.fullmatch(line)
    if divided is not None:
        name, settings = _parameter_text(divided["parameter"], field)
        return name, {**settings, "by": divided["by"]}
    match = _PARAMETER.fullmatch(line)
    numbers = _NUMBERS.fullmatch(match["numbers"] or "") if match is not None else None
    if match is None or (numbers is None and match["numbers"] is not None):
        raise UsageError("%s must be of the form %s, but %r was given", field, _PARAMETER_FORMS, line)
    if numbers is None:
        return match["name"], {}
    start = numbers["start"] or numbers["only"]
    bounds = _bounds(numbers["lower"] or None, numbers["upper"] or None, field)
    return match["name"], {"start": number(start, field), **bounds} if start else bounds


def _bounds(lower: object, upper: object, field: Field) -> dict[str, object]:
    """Return the bounds that are given; an infinite bound is none."""
    settings: dict[str, object] = {}
    for name, bound, none in (("lower", lower, -math.inf), ("upper", upper, math.inf)):
        if bound is not None and (value := number(bound, field)) != none:
            settings[name] = value
    return settings


def _several(value: object) -> Sequence[object]:
    return value if isinstance(value, (list, tuple)) else [value]


def _pairs(value: object, field: Field, example: str) -> list[tuple[str, object]]:
    """Return the items of a mapping, or split each text at its last ``=``; no expression or list contains ``=``."""
    if isinstance(value, Mapping):
        pairs = [(side, right if isinstance(right, (list, tuple)) else str(right)) for side, right in value.items()]
    else:
        pairs = [(side, right) for part in _several(value) for side, _, right in [text(part, field).rpartition("=")]]
    stripped: list[tuple[str, object]] = [
        (str(side).strip(), right.strip() if isinstance(right, str) else right) for side, right in pairs
    ]
    if not all(side and right for side, right in stripped):
        given = value[0] if isinstance(value, list) and len(value) == 1 else value
        raise UsageError("%s must be of the form %s, but %r was given", field, example, given)
    return stripped


GROUPS: Final[Mapping[str, tuple[Option, ...]]] = {
    "data": (
        Option("time", "data.time", text, "t", "time column (default: t or time)"),
        Option("states", "data.states", names, "x,y", "state columns (default: all other numeric columns)"),
        Option("inputs", "data.inputs", names, "u", "input columns (variables without an equation), or the time"),
        Option("hold", "data.hold", names, "u", "inputs that keep the value of a row until the next row"),
        Option("trajectory", "data.trajectory", text, "run", "column whose value changes when a new trajectory begins"),
        Option(
            "group", "data.group", text, "strain",
            "search one structure, whose constants may differ between the values of this column",
        ),
        Option(
            "per_trajectory", "data.per_trajectory", switch, None,
            "search one structure, whose constants may differ between trajectories",
        ),
        Option("target", "data.target", text, "y", "explicit regression of y on the other columns"),
        Option("derivatives", "data.derivatives", names, "dx,dy", "measured derivatives, one column per state"),
        Option("order", "data.order", whole, "1|2", "2: search d2x/dt2 from positions (default: 1)"),
        Option(
            "angle", "data.angles", angles, "theta[:deg]",
            "a state that is an angle; it is unwrapped", is_repeatable=True,
        ),
        Option("only", "data.only", names, "x", "search only these equations; they may use all states"),
        Option("offsets", "data.offsets", names, "x", "states with an unknown offset, fitted for each trajectory"),
        Option("step", "data.step", number, "0.1", "time between rows, if no column has times"),
        Option(
            "hidden", "data.hidden", hidden_states, "h",
            "states of given equations that no column measures; without equations, their number, 1 to 9",
        ),
        Option(
            "observe", "data.observe", partial(by_equation, example="y=a*h + b", noun="the column"), "y=a*h + b",
            "a column that is no state, as an expression of states and parameters", is_repeatable=True,
        ),
        Option("sheet", "data.sheet", text, "NAME", "sheet of an Excel workbook (default: the first with a table)"),
        Option("missing", "data.missing", text, "refuse|drop", "what to do with NaN and infinity (default: refuse)"),
        Option(
            "missing_value", "data.missing_values", several_numbers, "-9999",
            "a number that stands for a missing value; such values are dropped", is_repeatable=True,
        ),
        Option("robust", "data.robust", switch, None, "smooth robustly: outliers get little weight"),
        Option(
            "stochastic", "data.stochastic", switch, None,
            "noise is part of the dynamics: search drift f and diffusion g of dx = f dt + g dW",
        ),
        Option(
            "holdout", "data.holdout", holdout, "K|run=4",
            "hold out the last K trajectories, or the trajectories with this value, and test the model on them",
        ),
        Option(
            "weights", "data.weights", text, "w",
            "column of row weights, such as 1/variance; rows of weight 0 are left out",
        ),
        Option(
            "unit", "data.units", partial(by_equation, example="x=m/s", noun="the unit"), "x=m/s",
            "the unit of a column, or of the time", is_repeatable=True,
        ),
    ),
    "search": (
        Option("seed", "seed", whole, "S", "random seed; the same seed gives the same result (default: 0)"),
        Option("preset", "preset", text, "default|paper", "paper: only the algorithm of Schmidt & Lipson 2008"),
        Option(
            "operators", "space.operators space.operators_of", operators, "LIST",
            "operators of expressions (default: +,-,*,/,sin,cos, and others that reduce the description length); "
            "x=LIST for one equation", is_repeatable=True,
        ),
        Option(
            "allow", "space.variables_of", partial(variables, example="x=x,y"), "x=x,y",
            "the variables that one equation may use", is_repeatable=True,
        ),
        Option(
            "require", "space.required_of", partial(variables, example="x=y"), "x=y",
            "the variables that one equation must have", is_repeatable=True,
        ),
        Option(
            "bound", "prior.bounds", bounds, '"[x:] c > 0"',
            "bounds on constants: c (all constants), |c| (magnitudes), inner (constants inside terms), x*y "
            "(coefficient of this term, as in 'x: -2 < x*y < 0')", is_repeatable=True,
        ),
        Option(
            "guess", "prior.guesses", guesses, "dx=EXPR",
            "an initial guess of an equation; its constants are fitted", is_repeatable=True,
        ),
        Option(
            "known", "prior.known", partial(by_equation, example="dy=-x/10"), "dy=EXPR",
            "a known equation, which is not searched", is_repeatable=True,
        ),
        Option(
            "equation", "prior.equations", partial(by_equation, example="dv/dt=-g/l*sin(theta) - c*v + ?"),
            '"dx/dt=EXPR"',
            "a given equation, whose named parameters are fitted; ? is an unknown part, which is searched, ?(v,u) one "
            "of these variables, and ?1 in several equations is the same expression", is_repeatable=True,
        ),
        Option(
            "parameter", "prior.parameters", parameters, '"c=1 in 0.1..10 by run"',
            "start value, bounds, or both, of a parameter in --equation (also c=1, c=0.., c=..10); 'by run': each "
            "trajectory has a value of its own", is_repeatable=True,
        ),
        Option(
            "initial", "prior.initial", initial_values, "h=0..10",
            "value of a state of given equations at the first row of each trajectory (h=10), or bounds on it",
            is_repeatable=True,
        ),
        Option("positive", "prior.positive", names, "X", "equations, or unknown parts, that are nowhere negative"),
        Option(
            "monotone", "prior.monotone", partial(shapes, example="x=increasing in S"), '"x=increasing in S"',
            "an equation, or its unknown part, that is increasing or decreasing in a variable", is_repeatable=True,
        ),
        Option(
            "limit", "prior.limits", partial(shapes, example="x=S -> 0: 0"), '"x=S -> 0: 0"',
            "limit of an equation, or of its unknown part, for a value of a variable or inf; 0..2 is a range",
            is_repeatable=True,
        ),
        Option("islands", "evolution.islands", whole, "K", "islands per state variable (default: 8)"),
        Option("max_size", "space.max_size", whole, "N", "largest complexity of an equation (default: no limit)"),
    ),
    "budget": (
        Option(
            "max_time", "budget.max_time", seconds, "60s",
            "end the whole job after 90, 60s, 10m, 1h (default: no time limit)",
        ),
        Option(
            "max_epochs", "budget.max_epochs budget.max_epochs_of", epochs, "N",
            "end the search after N epochs, or by state variable, as x=20,y=12 (default: 1000)",
        ),
        Option(
            "target_error", "budget.target_error", number, "E",
            "normalized error at which an equation counts as found (default: estimated from the data)",
        ),
    ),
}  # fmt: skip
"""All options by their headings in the help."""

OPTIONS: Final[Mapping[str, Option]] = {option.name: option for options in GROUPS.values() for option in options}
