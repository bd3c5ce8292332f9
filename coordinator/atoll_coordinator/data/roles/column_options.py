"""Columns by their names and the options: which are named, units taken off, contradictions. Pure."""

import re
from collections.abc import Iterable, Sequence
from typing import Final

from atoll_coordinator.data.roles.unit_texts import are_units
from atoll_core.config import DataConfig
from atoll_core.errors import UsageError

_SINGLE: Final = ("time", "trajectory", "group", "target", "weights")
_SEVERAL: Final = ("states", "inputs", "derivatives", "only", "offsets", "hold")
"""Options that name one column, and several."""
_EXCLUSIONS: Final = (
    ("--target", "--derivatives", "give the one column set that is sought"),
    ("--step", "--target", "rows of an explicit regression have no time"),
    ("--step", "--derivatives", "given derivatives need no time"),
    ("--order 2", "--target", "explicit regression has no time derivative"),
    ("--holdout", "--target", "rows of an explicit regression are no trajectories"),
    ("--order 2", "--derivatives", "the velocity has to be derived from the data"),
    ("--offsets", "--target", "offsets belong to states measured in time"),
    ("--offsets", "--derivatives", "offsets belong to states measured in time"),
    ("--hold", "--target", "rows of an explicit regression do not follow one another"),
    ("--hold", "--derivatives", "nothing is differentiated, and rows need not follow one another"),
    ("--hold", "--stochastic", "a step of a process takes the mean of an input over its ends"),
    ("--stochastic", "--target", "an explicit regression has no process"),
    ("--stochastic", "--derivatives", "the steps of a process are those of its states"),
    ("--stochastic", "--order 2", "name the velocities among the states instead"),
    ("--stochastic", "--only", "the likelihood of a step is that of all states"),
    ("--stochastic", "--robust", "nothing is smoothed"),
    ("--stochastic", "--weights", "the diffusion says how much each step counts"),
    ("--stochastic", "--offsets", "increments know nothing of offsets"),
    ("--stochastic", "--group", "the likelihood of a step has one set of constants"),
    ("--stochastic", "--per-trajectory", "the likelihood of a step has one set of constants"),
    ("--group", "--per-trajectory", "name the column, or let all differ"),
    ("--group", "--target", "constants by group need states measured in time"),
    ("--group", "--derivatives", "constants by group need states measured in time"),
    ("--per-trajectory", "--target", "constants by group need states measured in time"),
    ("--per-trajectory", "--derivatives", "constants by group need states measured in time"),
    ("--per-trajectory", "--holdout", "constants of what is held out are unknown"),
)
"""Options that mean nothing together, and why."""
_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]$", re.DOTALL)
_IN_PARENTHESES = re.compile(r"^(?P<name>.*?)\s+\((?P<unit>[^()]*)\)$", re.DOTALL)


def named_columns(config: DataConfig) -> frozenset[str]:
    """Return every column that the options name."""
    single = {getattr(config, part) for part in _SINGLE} - {None}
    several = [name for part in _SEVERAL for name in getattr(config, part) or ()]
    return frozenset((*single, *several, *(angle.column for angle in config.angles)))


def split_unit(header: str) -> tuple[str, str]:
    """Split ``name [unit]``, and ``name (unit)`` if the unit is known; what is nothing but a unit stays whole."""
    match = _WITH_UNIT.match(header.strip()) or _IN_PARENTHESES.match(header.strip())
    if match is None or not match["name"] or (header.strip()[-1] == ")" and not are_units([match["unit"].strip()])):
        return header.strip(), ""
    return match["name"], match["unit"].strip()


def strip_units(config: DataConfig, names: Iterable[str]) -> DataConfig:
    """Return `config` with ``name [unit]`` shortened to ``name`` wherever only that is among `names`."""
    known = set(names)

    def plain(name: str) -> str:
        return name if name in known or split_unit(name)[0] not in known else split_unit(name)[0]

    def several(columns: Iterable[str] | None) -> tuple[str, ...] | None:
        return None if columns is None else tuple(plain(name) for name in columns)

    single = {part: getattr(config, part) for part in _SINGLE}
    changes: dict[str, object] = {part: plain(name) for part, name in single.items() if name is not None}
    changes |= {part: several(getattr(config, part)) for part in _SEVERAL}
    if isinstance(config.holdout, str):
        name, _, value = config.holdout.rpartition("=")
        changes["holdout"] = f"{plain(name.strip())}={value.strip()}"
    changes["units"] = {plain(name): unit for name, unit in config.units.items()}
    changes["angles"] = tuple(angle.model_copy(update={"column": plain(angle.column)}) for angle in config.angles)
    return config.model_copy(update=changes)


def check_options(config: DataConfig) -> None:
    """Raise UsageError when options contradict each other, whatever the data."""
    given = {
        "--stochastic": config.stochastic,
        "--target": config.target is not None,
        "--derivatives": config.derivatives is not None,
        "--order 2": config.order == 2,
        "--step": config.step is not None,
        "--holdout": config.holdout is not None,
        "--only": config.only is not None,
        "--robust": config.robust,
        "--weights": config.weights is not None,
        "--offsets": bool(config.offsets),
        "--hold": bool(config.hold),
        "--group": config.group is not None,
        "--per-trajectory": config.per_trajectory,
    }
    for one, other, reason in _EXCLUSIONS:
        if given[one] and given[other]:
            raise UsageError(f"{one} and {other} exclude each other; {reason}")
    if config.derivatives is not None and config.states is not None and len(config.derivatives) != len(config.states):
        counts = f"{len(config.states)} states and {len(config.derivatives)} derivatives"
        raise UsageError(f"{counts} were named; give one derivative per state, in the same order")
    _check_parts(config)


def _check_parts(config: DataConfig) -> None:
    """Raise UsageError when one column is given two parts, or one part twice."""
    parts: dict[str, Sequence[str | None]] = {
        "a state": config.states or (),
        "an input": config.inputs,
        "a derivative": config.derivatives or (),
        "the target": [config.target],
        "the trajectory column": [config.trajectory],
        "the group": [config.group] if config.group != config.trajectory else [],
        "the time": [config.time],
        "the weights": [config.weights],
    }
    owner: dict[str, str] = {}
    for part, names in parts.items():
        for name in names:
            if name is None:
                continue
            if owner.get(name, part) != part and {owner[name], part} != {"an input", "the time"}:
                raise UsageError(f"column '{name}' cannot be both {owner[name]} and {part}; name it once")
            if list(names).count(name) > 1:
                raise UsageError(f"column '{name}' is named twice as {part}; name it once")
            owner[name] = part
