"""Names of columns and options: units in names, columns that options name, contradictions between options. Pure.

A unit is a product of powers of known symbols, such as ``m s^-2``, ``mol/(L h)`` or ``µg/mL``. This module only
distinguishes units from data and from remarks in a header; `atoll_coordinator.units` interprets them.
"""

import itertools
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import Field, UsageError

TIME_NAMES: Final = ("t", "time", "Time", "TIME")
"""Default names of the time column, in order of preference; options may name another column."""
TRAJECTORY_NAME: Final = "trajectory"
"""Default name of the trajectory column; options may name another column."""

_SINGLE: Final = ("time", "trajectory", "group", "target", "weights")
_SEVERAL: Final = ("states", "inputs", "derivatives", "only", "offsets", "hold")
"""Options that name one column, and options that name several columns."""
_EXCLUSIONS: Final = (
    ("target", "derivatives", "both give left-hand sides; name one of them"),
    ("step", "target", "rows of an explicit regression have no time"),
    ("step", "derivatives", "given derivatives need no time"),
    ("order", "target", "explicit regression has no time derivative"),
    ("holdout", "target", "rows of an explicit regression are not trajectories"),
    ("order", "derivatives", "the velocity has to be derived from the data"),
    ("offsets", "target derivatives", "offsets belong to states measured in time"),
    ("hold", "target", "rows of an explicit regression do not follow one another"),
    ("hold", "derivatives", "nothing is differentiated, and rows need not follow one another"),
    ("hold", "stochastic", "a step of a process uses the mean of an input over both ends of the step"),
    ("stochastic", "target", "an explicit regression has no process"),
    ("stochastic", "derivatives", "a process is described by the steps of its states"),
    ("stochastic", "order", "name the velocities among the states instead"),
    ("stochastic", "only", "the likelihood of a step needs the equations of all states"),
    ("stochastic", "robust", "nothing is smoothed"),
    ("stochastic", "weights", "the diffusion determines the weight of each step"),
    ("stochastic", "offsets", "increments do not depend on offsets"),
    ("stochastic", "group per_trajectory", "the likelihood of a step has one set of constants"),
    ("hidden", "target", "rows of an explicit regression are no course of a state"),
    ("hidden", "derivatives", "a hidden state is followed along trajectories"),
    ("hidden", "stochastic", "the likelihood of a step needs all states"),
    ("hidden", "order", "write the velocities as states of their own"),
    ("hidden", "group per_trajectory", "constants by group need all states measured"),
    ("hidden_count", "offsets", "neither the offsets nor the hidden state would be determined"),
    ("hidden_count", "only", "the course of a hidden state follows from the equations of all states"),
    ("hidden_count", "observe", "name the hidden states, and give their equations with --equation"),
    ("observe", "target derivatives stochastic", "columns are computed from states along trajectories"),
    ("observe", "order", "write the velocities as states of their own"),
    ("observe", "group per_trajectory", "constants by group need all states measured"),
    ("group", "per_trajectory", "name the column, or let all differ"),
    ("group", "target derivatives", "constants by group need states measured in time"),
    ("per_trajectory", "target derivatives", "constants by group need states measured in time"),
    ("per_trajectory", "holdout", "constants of held-out trajectories are unknown"),
)
"""Pairs of options that exclude each other, and why."""
_SHAPES: Final = "positive monotone limit"
_EXCLUSIONS_OF_PRIORS: Final = (
    ("equation", "stochastic", "the likelihood of a step has no given equations"),
    ("equation", "target", "parameters are fitted to trajectories, and rows of an explicit regression are not"),
    ("equation", "derivatives", "parameters are fitted to trajectories, and not to given derivatives"),
    ("equation", "group", "name the parameters that differ with --parameter 'c by run', or submit a job for each"),
    ("equation", "per_trajectory", "name the parameters that differ, as in --parameter 'c by run'"),
    ("equation", "preset", "the algorithm of the paper has no given equations"),
    (
        "hidden_count",
        "equation known initial",
        "name the states of given equations, instead of a number",
    ),
    ("hidden_count", "preset", "the algorithm of the paper has no hidden states"),
    (_SHAPES, "stochastic", "shapes are demanded of equations without noise"),
    (_SHAPES, "group", "shapes with constants by group are not possible yet"),
    (_SHAPES, "per_trajectory", "shapes with constants by trajectory are not possible yet"),
)
"""The same for options of prior knowledge and the preset of the paper."""
_CALLED: Final = {"hidden_count": "hidden"}
_VALUES: Final = {"order": 2, "preset": "paper"}
"""Names of options, and values that are named with the option."""
_COMPATIBLE: Final = ({"inputs", "time"}, {"trajectory", "group"})
"""Roles that one column may have."""
_WITH_UNIT: Final = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]$", re.DOTALL)
_IN_PARENTHESES: Final = re.compile(r"^(?P<name>.*?)\s+\((?P<unit>[^()]*)\)$", re.DOTALL)

_PREFIXES: Final = ("da", *"YZEPTGMkhdcmuµμnpfazy")
_WITH_PREFIX_TEXT: Final = (
    "s sec m g A K mol cd rad sr Hz N Pa J W C V F S Wb T H lm lx Bq Gy Sv kat L l M eV B bit b bar Ω Ohm ohm cal Da U "
    "Wh Torr pixel"
)
_PLAIN_TEXT: Final = (
    "min h hr hrs d a y yrs secs second seconds minute minutes mins hour hours day days week weeks wk month months "
    "year years ° deg degree degrees °C °F degC degF ℃ ℉ celsius kelvin fahrenheit % ‰ ppm ppb ppt counts count "
    "cts individuals ind cells cell thousands millions dBm pH psi atm torr mmHg inch in ft mi yd lb lbs oz gal mph "
    "kph kn knots kt t ha au AU a.u. arb OD RFU CFU rpm px pixels frame frames step steps cycle cycles rev turns "
    "radians grams meter meters metre metres volt volts amp amps watt watts newton joule kmh dimensionless unitless"
)
_WITH_PREFIX: Final = frozenset(_WITH_PREFIX_TEXT.split())
_PLAIN: Final = frozenset(_PLAIN_TEXT.split())
_SYMBOL: Final = re.compile(r"[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|[°℃℉%‰][^\W\d_]*")
_BETWEEN: Final = re.compile(r"[\d\s*/·⋅×.()^⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺−+-]*")
_LONGEST: Final = 30


def find_time_column(names: Sequence[str], config: DataConfig) -> str | None:
    """Return the column that options name as the time, else a column in `TIME_NAMES` with no role except input."""
    other = (config.target, config.trajectory, config.weights, *(config.states or ()), *(config.derivatives or ()))
    return config.time or next((name for name in TIME_NAMES if name in names and name not in other), None)


def find_trajectory_column(names: Iterable[str], config: DataConfig) -> str | None:
    """Return the column that options name for trajectories, else a column ``trajectory`` that has no other role."""
    if config.trajectory is not None:
        return config.trajectory
    return TRAJECTORY_NAME if TRAJECTORY_NAME in names and TRAJECTORY_NAME not in named_columns(config) else None


def named_columns(config: DataConfig) -> frozenset[str]:
    """Return every column that the options name."""
    single = {getattr(config, role) for role in _SINGLE} - {None}
    several = [name for role in _SEVERAL for name in getattr(config, role) or ()]
    return frozenset((*single, *several, *(angle.column for angle in config.angles)))


def split_unit(header: str) -> tuple[str, str]:
    """Split ``name [unit]``, and ``name (unit)`` if the unit is known; a header that is only a unit is not split."""
    match = _WITH_UNIT.match(header.strip()) or _IN_PARENTHESES.match(header.strip())
    if match is None or not match["name"] or (header.strip()[-1] == ")" and not are_units([match["unit"].strip()])):
        return header.strip(), ""
    return match["name"], match["unit"].strip()


def strip_units(config: DataConfig, names: Iterable[str]) -> DataConfig:
    """Return `config` with ``name [unit]`` shortened to ``name`` if only ``name`` is among `names`."""
    known = set(names)

    def plain(name: str) -> str:
        return name if name in known or split_unit(name)[0] not in known else split_unit(name)[0]

    changes: dict[str, object] = {}
    for role in (*_SINGLE, *_SEVERAL):
        named = getattr(config, role)
        if named is not None:
            changes[role] = plain(named) if role in _SINGLE else tuple(map(plain, named))
    if isinstance(config.holdout, str):
        name, _, value = config.holdout.rpartition("=")
        changes["holdout"] = f"{plain(name.strip())}={value.strip()}"
    changes["units"] = {plain(name): unit for name, unit in config.units.items()}
    changes["angles"] = tuple(angle.model_copy(update={"column": plain(angle.column)}) for angle in config.angles)
    return config.model_copy(update=changes)


def check_options(config: DataConfig) -> None:
    """Raise UsageError if options contradict each other, regardless of the data."""

    _check_exclusions(_EXCLUSIONS, lambda name: _is_set(config, name))
    if config.derivatives is not None and config.states is not None and len(config.derivatives) != len(config.states):
        counts = f"{len(config.states)} states and {len(config.derivatives)} derivatives"
        raise UsageError(f"{counts} were named; name one derivative for each state, in the same order")
    columns = {name: getattr(config, name) or () for name in ("states", "inputs", "derivatives")}
    single = ("target", "trajectory", "group", "time", "weights")
    columns |= {name: (getattr(config, name),) for name in single if getattr(config, name) is not None}
    columns["angle"] = tuple(angle.column for angle in config.angles)
    first: dict[str, str] = {}
    for role, names in columns.items():
        for name in names:
            other = first.setdefault(name, role)
            if list(names).count(name) > 1:
                raise UsageError(f"%s names '{name}' twice; name it once", Field(role))
            if other != role and role != "angle" and {other, role} not in _COMPATIBLE:
                raise UsageError(f"column '{name}' is named by both %s and %s; name it once", Field(other), Field(role))


def check_given_equations(config: JobConfig) -> None:
    """Raise UsageError if a job of this kind can have no given equations, or if a parameter has impossible bounds."""
    prior, data = config.prior, config.data
    given: dict[str, object] = {
        "equation": prior.equations, "known": prior.known, "initial": prior.initial, "positive": prior.positive,
        "monotone": prior.monotone, "limit": prior.limits, "preset": config.preset == "paper",
    }  # fmt: skip
    _check_exclusions(_EXCLUSIONS_OF_PRIORS, lambda name: bool(given[name]) if name in given else _is_set(data, name))
    for option, by_name in (("parameter", prior.parameters), ("initial", prior.initial)):
        for name, one in by_name.items():
            lower, upper = one.ends
            if lower > upper or (lower == upper and option == "parameter"):
                raise UsageError(f"%s {name}: the lower bound {lower:g} is not below {upper:g}", Field(option))
            if one.start is not None and not lower <= one.start <= upper:
                inside = f"outside its bounds {lower:g} to {upper:g}"
                raise UsageError(f"%s {name}: the start value {one.start:g} is {inside}", Field(option))
    if prior.parameters and not prior.equations and not data.observe:
        name = next(iter(prior.parameters))
        raise UsageError(f"%s {name} belongs to no equation; give one with %s", Field("parameter"), Field("equation"))


def _check_exclusions(exclusions: Iterable[tuple[str, str, str]], is_set: Callable[[str], bool]) -> None:
    """Raise UsageError if two options are set that exclude each other."""
    for names, others, reason in exclusions:
        for name, other in itertools.product(names.split(), others.split()):
            if is_set(name) and is_set(other):
                fields = (Field(_CALLED.get(one, one), _VALUES.get(one)) for one in (name, other))
                raise UsageError(f"%s and %s exclude each other; {reason}", *fields)


def _is_set(config: DataConfig, name: str) -> bool:
    return config.order == 2 if name == "order" else getattr(config, name) not in (None, False, (), {})


def are_units(texts: Sequence[str]) -> bool:
    """Tell whether `texts` are units: one of them is known, and none is a number or too long to be a unit."""
    if any(len(text) > _LONGEST or _SYMBOL.search(text) is None or _is_number(text) for text in texts):
        return False
    return any(map(_is_known_unit, texts))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_known_unit(text: str) -> bool:
    if text in _PLAIN:
        return True
    if text[0].isdigit() and not text.startswith("1/"):
        return False
    return _BETWEEN.fullmatch(_SYMBOL.sub("", text)) is not None and all(
        symbol in _PLAIN
        or symbol in _WITH_PREFIX
        or any(symbol.startswith(prefix) and symbol[len(prefix) :] in _WITH_PREFIX for prefix in _PREFIXES)
        for symbol in _SYMBOL.findall(text)
    )
