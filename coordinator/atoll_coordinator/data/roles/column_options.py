"""Column names as the options write them: which are named, units taken off, contradictions refused. Pure."""

import re
from collections.abc import Iterable, Sequence
from typing import Final

from atoll_coordinator.data.roles.unit_texts import are_units
from atoll_core.config import DataConfig
from atoll_core.errors import UsageError

TRAJECTORY_NAME: Final = "trajectory"
_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]$", re.DOTALL)
_IN_PARENTHESES = re.compile(r"^(?P<name>.*?)\s+\((?P<unit>[^()]*)\)$", re.DOTALL)


def named_columns(config: DataConfig) -> frozenset[str]:
    """Return every column that the options name."""
    named = (config.time, config.trajectory, config.group, config.target, config.weights)
    single = [name for name in named if name is not None]
    angles = [angle.column for angle in config.angles]
    several = (*(config.states or ()), *config.inputs, *(config.derivatives or ()), *(config.only or ()))
    return frozenset((*single, *several, *angles, *config.offsets))


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

    single = {part: getattr(config, part) for part in ("time", "trajectory", "group", "target", "weights")}
    changes: dict[str, object] = {part: plain(name) for part, name in single.items() if name is not None}
    changes |= {part: several(getattr(config, part)) for part in ("states", "inputs", "derivatives", "only", "offsets")}
    if isinstance(config.holdout, str):
        name, _, value = config.holdout.rpartition("=")
        changes["holdout"] = f"{plain(name.strip())}={value.strip()}"
    changes["units"] = {plain(name): unit for name, unit in config.units.items()}
    changes["angles"] = tuple(angle.model_copy(update={"column": plain(angle.column)}) for angle in config.angles)
    return config.model_copy(update=changes)


def find_trajectory_column(names: Iterable[str], config: DataConfig) -> str | None:
    """Return the trajectory column: the one named, else one called ``trajectory`` that has no other part."""
    if config.trajectory is not None:
        return config.trajectory
    return TRAJECTORY_NAME if TRAJECTORY_NAME in names and TRAJECTORY_NAME not in named_columns(config) else None


def check_options(config: DataConfig) -> None:
    """Raise UsageError when options contradict each other, whatever the data."""
    if config.target is not None and config.derivatives is not None:
        raise UsageError("--target and --derivatives exclude each other; give the one column set that is sought")
    if config.order == 2 and config.target is not None:
        raise UsageError("--order 2 and --target exclude each other; explicit regression has no time derivative")
    if config.holdout is not None and config.target is not None:
        raise UsageError(
            "--holdout and --target exclude each other; rows of an explicit regression are no trajectories"
        )
    if config.order == 2 and config.derivatives is not None:
        raise UsageError("--order 2 and --derivatives exclude each other; the velocity has to be derived from the data")
    if config.derivatives is not None and config.states is not None and len(config.derivatives) != len(config.states):
        counts = f"{len(config.states)} states and {len(config.derivatives)} derivatives"
        raise UsageError(f"{counts} were named; give one derivative per state, in the same order")
    if config.offsets and (config.target is not None or config.derivatives is not None):
        other = "--target" if config.target is not None else "--derivatives"
        raise UsageError(f"--offsets and {other} exclude each other; offsets belong to states measured in time")
    _check_stochastic(config)
    _check_groups(config)
    _check_parts(config)


def _check_groups(config: DataConfig) -> None:
    """Raise UsageError when groups of trajectories are asked for where there are none."""
    if config.group is None and not config.per_trajectory:
        return
    option = "--per-trajectory" if config.per_trajectory else "--group"
    if config.group is not None and config.per_trajectory:
        raise UsageError("--group and --per-trajectory exclude each other; name the column, or let all differ")
    others = {"--target": config.target is not None, "--derivatives": config.derivatives is not None}
    other = next((name for name, is_given in others.items() if is_given), None)
    if other is not None:
        raise UsageError(f"{option} and {other} exclude each other; constants by group need states measured in time")
    if config.per_trajectory and config.holdout is not None:
        raise UsageError("--per-trajectory and --holdout exclude each other; constants of what is held out are unknown")


def _check_stochastic(config: DataConfig) -> None:
    """Raise UsageError when an option is given that means nothing where noise is part of the law."""
    reasons = {
        "--target": (config.target is not None, "an explicit regression has no process"),
        "--derivatives": (config.derivatives is not None, "the steps of a process are those of its states"),
        "--order 2": (config.order == 2, "name the velocities among the states instead"),
        "--only": (config.only is not None, "the likelihood of a step is that of all states"),
        "--robust": (config.robust, "nothing is smoothed"),
        "--weights": (config.weights is not None, "the diffusion says how much each step counts"),
        "--offsets": (bool(config.offsets), "increments know nothing of offsets"),
        "--group": (config.group is not None, "the likelihood of a step has one set of constants"),
        "--per-trajectory": (config.per_trajectory, "the likelihood of a step has one set of constants"),
    }
    for option, (is_given, reason) in reasons.items():
        if config.stochastic and is_given:
            raise UsageError(f"--stochastic and {option} exclude each other; {reason}")


def _check_parts(config: DataConfig) -> None:
    """Raise UsageError when one column is given two parts, or one part twice."""
    parts: list[tuple[str, Sequence[str]]] = [
        ("a state", config.states or ()),
        ("an input", config.inputs),
        ("a derivative", config.derivatives or ()),
        ("the target", [config.target] if config.target is not None else []),
        ("the trajectory column", [config.trajectory] if config.trajectory is not None else []),
        ("the group", [config.group] if config.group not in (None, config.trajectory) else []),
        ("the time", [config.time] if config.time is not None else []),
        ("the weights", [config.weights] if config.weights is not None else []),
    ]
    owner: dict[str, str] = {}
    for part, names in parts:
        for name in names:
            if owner.get(name, part) != part and {owner[name], part} != {"an input", "the time"}:
                raise UsageError(f"column '{name}' cannot be both {owner[name]} and {part}; name it once")
            if list(names).count(name) > 1:
                raise UsageError(f"column '{name}' is named twice as {part}; name it once")
            owner[name] = part
