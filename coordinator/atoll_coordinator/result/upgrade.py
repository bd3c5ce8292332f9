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


def say_more_of_columns(content: Content) -> Content:
    """Say what `system` lacks: kind and order, which left-hand sides tell, and the ranges of the rows in the file."""
    system = content.get("system")
    if not isinstance(system, Mapping):
        return content
    lacking = {key: tell(content) for key, tell in _TOLD.items() if key not in system}
    return {**content, "system": {**system, **lacking}}


def say_discretisation(content: Content) -> Content:
    """Say how the steps of a process are described: there was one way before there were two."""
    process = content.get("process")
    if not isinstance(process, Mapping):
        return content
    return {**content, "process": {"discretisation": "local linearisation", **process}}


STEPS: Final[tuple[Step, ...]] = (say_columns, say_more_of_columns, say_discretisation)
"""From the oldest version on."""


def _kind(content: Content) -> str:
    if not any("/" in side for side in _sides(content)):
        return "regression"
    return "process" if content.get("process") else "dynamics"


def _order(content: Content) -> int:
    sides = _sides(content)
    return 2 if sides and all(side.startswith("d2") and "/" in side for side in sides) else 1


def _ranges(content: Content) -> dict[str, list[float]]:
    """Return the lowest and highest value by column of the listed rows that took part in the search."""
    listed = (_trajectories(content.get(part)) for part in ("data", "simulation"))
    curves: dict[str, list[float]] = {}
    for trajectory in next(filter(None, listed), []):
        for name, values in _curves(trajectory):
            curves.setdefault(name, []).extend(values)
    return {name: [min(values), max(values)] for name, values in curves.items() if values}


_TOLD: Final[Mapping[str, Callable[[Content], object]]] = {"kind": _kind, "order": _order, "ranges": _ranges}
"""What tells the keys of `system` that came one after another."""


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
