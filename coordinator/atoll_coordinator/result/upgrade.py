"""Converts results of earlier versions to the current version, step by step.

All versions have schema 1: keys were only added, and no key has changed its meaning. A step adds keys to files that
lack them. Other missing keys need no step, because the default of their field (null or an empty list) means "unknown".
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

Content = dict[str, object]
Step = Callable[[Content], Content]


def upgraded(content: Mapping[str, object]) -> Content:
    """Return the content of a result of any version in the form of this version; invalid values are left unchanged."""
    current = dict(content)
    for step in STEPS:
        current = step(current)
    return current


def add_columns(content: Content) -> Content:
    """Add `system` if it is missing: columns with a rate become states, columns without an equation become inputs."""
    if content.get("system") is not None:
        return content
    sides = {equation.get("variable"): str(equation.get("lhs")) for equation in _objects(content.get("equations"))}
    symbols = content.get("symbols")
    columns = [*symbols] if isinstance(symbols, Mapping) else []
    states = [name for name in columns if "/" in sides.get(name, "")]
    inputs = [name for name in columns if name not in sides]
    targets = [name for name, side in sides.items() if "/" not in side]
    target = None if states or len(targets) != 1 else targets[0]
    return {**content, "system": {"states": states, "inputs": inputs, "target": target}}


def add_properties_of_columns(content: Content) -> Content:
    """Add missing keys of `system`: kind and order follow from left-hand sides, ranges from the rows in the file."""
    system = content.get("system")
    if not isinstance(system, Mapping):
        return content
    missing = {key: compute(content) for key, compute in _LATER_KEYS.items() if key not in system}
    return {**content, "system": {**system, **missing}}


def add_discretisation(content: Content) -> Content:
    """Add the discretisation of a process: earlier versions had only the local linearisation."""
    process = content.get("process")
    if not isinstance(process, Mapping):
        return content
    return {**content, "process": {"discretisation": "local linearisation", **process}}


STEPS: Final[tuple[Step, ...]] = (add_columns, add_properties_of_columns, add_discretisation)
"""All steps, from the oldest version."""


def _kind(content: Content) -> str:
    if not any("/" in side for side in _sides(content)):
        return "regression"
    return "process" if content.get("process") else "dynamics"


def _order(content: Content) -> int:
    sides = _sides(content)
    return 2 if sides and all(side.startswith("d2") and "/" in side for side in sides) else 1


def _ranges(content: Content) -> dict[str, list[float]]:
    """Return the smallest and largest value by column over the listed rows that were not held out."""
    listed = (_trajectories(content.get(part)) for part in ("data", "simulation"))
    curves: dict[str, list[float]] = {}
    for trajectory in next(filter(None, listed), []):
        for name, values in _curves(trajectory):
            curves.setdefault(name, []).extend(values)
    return {name: [min(values), max(values)] for name, values in curves.items() if values}


_LATER_KEYS: Final[Mapping[str, Callable[[Content], object]]] = {"kind": _kind, "order": _order, "ranges": _ranges}
"""Functions that compute the keys of `system` that later versions have added."""


def _sides(content: Content) -> list[str]:
    return [str(equation.get("lhs")) for equation in _objects(content.get("equations"))]


def _objects(value: object) -> Iterator[Mapping[str, object]]:
    for item in value if isinstance(value, list | tuple) else ():
        if isinstance(item, Mapping):
            yield item


def _trajectories(part: object) -> list[Mapping[str, object]]:
    """Return the trajectories of a part of a result that were not held out."""
    listed = _objects(part.get("trajectories")) if isinstance(part, Mapping) else ()
    return [trajectory for trajectory in listed if not trajectory.get("held_out")]


def _curves(trajectory: Mapping[str, object]) -> Iterator[tuple[str, list[float]]]:
    """Yield the finite values of each measured column of a trajectory."""
    for columns in (trajectory.get("measured"), trajectory.get("inputs")):
        for name, values in columns.items() if isinstance(columns, Mapping) else ():
            numbers = values if isinstance(values, list | tuple) else ()
            yield str(name), [float(one) for one in numbers if isinstance(one, int | float) and math.isfinite(one)]
