"""Results of earlier versions, brought up to date step by step.

All have schema 1: keys were added and none has changed, so that a step is known by the key that a file lacks. A key
that needs no step is one whose absence means that nothing is known: null, or an empty list, as its field has it.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

Content = dict[str, object]
Step = Callable[[Content], Content]


def upgraded(content: Mapping[str, object]) -> Content:
    """Return the content of a result of any version as this version writes it; what is of no kind is left alone."""
    current = dict(content)
    for step in STEPS:
        current = step(current)
    return current


def say_columns(content: Content) -> Content:
    """Say what the columns are, where nothing does: what has a rate is a state, what has no equation an input."""
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


def say_kind(content: Content) -> Content:
    """Say what was sought, where `system` does not: left-hand sides and the part on a process tell it."""
    system = content.get("system")
    if not isinstance(system, Mapping) or "kind" in system:
        return content
    has_rates = any("/" in side for side in _sides(content))
    kind = "process" if content.get("process") else "dynamics"
    return {**content, "system": {**system, "kind": kind if has_rates else "regression"}}


def say_order(content: Content) -> Content:
    """Say the order of the equations, where `system` does not."""
    system = content.get("system")
    if not isinstance(system, Mapping) or "order" in system:
        return content
    sides = _sides(content)
    is_second = bool(sides) and all(side.startswith("d2") and "/" in side for side in sides)
    return {**content, "system": {**system, "order": 2 if is_second else 1}}


def measure_ranges(content: Content) -> Content:
    """Say what ranges were measured, where `system` does not: those of the rows that the file lists."""
    system = content.get("system")
    if not isinstance(system, Mapping) or "ranges" in system:
        return content
    listed = (_trajectories(content.get(part)) for part in ("data", "simulation"))
    rows = next(filter(None, listed), [])
    curves: dict[str, list[float]] = {}
    for trajectory in rows:
        for name, values in _curves(trajectory):
            curves.setdefault(name, []).extend(values)
    ranges = {name: [min(values), max(values)] for name, values in curves.items() if values}
    return {**content, "system": {**system, "ranges": ranges}}


def say_discretisation(content: Content) -> Content:
    """Say how the steps of a process are described: there was one way before there were two."""
    process = content.get("process")
    if not isinstance(process, Mapping) or "discretisation" in process:
        return content
    return {**content, "process": {**process, "discretisation": "local linearisation"}}


STEPS: Final[tuple[Step, ...]] = (say_columns, say_kind, say_order, measure_ranges, say_discretisation)
"""From the oldest version on."""


def _sides(content: Content) -> list[str]:
    return [str(equation.get("lhs")) for equation in _objects(content.get("equations"))]


def _objects(value: object) -> Iterator[Mapping[str, object]]:
    for item in value if isinstance(value, list | tuple) else ():
        if isinstance(item, Mapping):
            yield item


def _trajectories(part: object) -> list[Mapping[str, object]]:
    """Return the trajectories of a part of a result that took part in the search."""
    listed = _objects(part.get("trajectories")) if isinstance(part, Mapping) else ()
    return [trajectory for trajectory in listed if not trajectory.get("held_out")]


def _curves(trajectory: Mapping[str, object]) -> Iterator[tuple[str, list[float]]]:
    """Yield the finite values of each measured column of a trajectory."""
    for columns in (trajectory.get("measured"), trajectory.get("inputs")):
        for name, values in columns.items() if isinstance(columns, Mapping) else ():
            numbers = values if isinstance(values, list | tuple) else ()
            yield str(name), [float(one) for one in numbers if isinstance(one, int | float) and math.isfinite(one)]
