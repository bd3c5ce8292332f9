"""Pictures of a model by matplotlib, an extra: ``pip install 'atoll[plots]'``.

Each function draws into `axes`, or into a new figure, and returns the axes as an array.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from atoll.display.series import front, label, residuals
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError

if TYPE_CHECKING:
    from atoll.model.model import Model

Axes = npt.NDArray[np.object_]
"""Axes of matplotlib."""

_GRID = 24
"""Arrows along each side of a phase plane."""


def plot_fit(model: "Model", axes: object = None) -> Axes:
    """Plot each state over time: measured, and simulated with its 95 % band; a row of axes for each state."""
    parts = _trajectories(model)
    states = list(parts[0].values or {})
    each = _axes(axes, len(states))
    for at, state in zip(each, states, strict=True):
        for number, part in enumerate(parts):
            if not part.values:
                continue
            color, times = f"C{number % 10}", part.times
            if part.lower:
                bounds = (_numbers(curves[state]) for curves in (part.lower, part.upper or part.lower))
                at.fill_between(times, *bounds, color=color, alpha=0.3)
            at.plot(times, _numbers(part.values[state]), color=color, label=part.name)
            if part.measured:
                at.plot(times, _numbers(part.measured[state]), ".", color=color, markersize=3)
        at.set_ylabel(label(model.result, state))
    each[-1].set_xlabel(label(model.result, model.time))
    return each


def plot_residuals(model: "Model", axes: object = None) -> Axes:
    """Plot measured less simulated values over time, for each state, along each trajectory."""
    parts = [part for part in _trajectories(model) if part.values and part.measured]
    if not parts:
        raise UsageError("the result has no measured rows beside simulated ones, so there are no residuals to plot")
    states = list(parts[0].values or {})
    each = _axes(axes, len(states))
    for at, state in zip(each, states, strict=True):
        for number, part in enumerate(parts):
            left = residuals(part.measured[state], (part.values or {})[state])
            at.plot(part.times, _numbers(left), ".", color=f"C{number % 10}")
        at.axhline(0.0, color="0.5", linewidth=0.8)
        at.set_ylabel(label(model.result, state))
    each[-1].set_xlabel(label(model.result, model.time))
    return each


def plot_phase(model: "Model", axes: object = None) -> Axes:
    """Plot directions and simulated trajectories in the plane of the first two states, the others at their middle."""
    if len(model.states) < 2:
        raise UsageError("a phase plane takes two states; this model has one")
    if model.inputs:
        raise UsageError(f"the model has the inputs {', '.join(model.inputs)}, so that no plane shows its directions")
    columns, known = model.result.columns_by_symbol, model.result.ranges
    lacking = next((name for name in model.states if name not in known), None)
    if lacking is not None:
        raise UsageError(f"the result does not say in which range {lacking!r} was measured")
    ranges = [known[name] for name in model.states]
    (at,) = _axes(axes, 1)
    (left, right), (low, high) = ranges[0], ranges[1]
    first, second = np.meshgrid(np.linspace(left, right, _GRID), np.linspace(low, high, _GRID))
    points = np.tile([0.5 * (lower + upper) for lower, upper in ranges], (first.size, 1))
    points[:, 0], points[:, 1] = first.ravel(), second.ravel()
    rates = model.field.values(points)
    at.streamplot(
        first, second, rates[:, 0].reshape(first.shape), rates[:, 1].reshape(first.shape), color="0.7", density=0.8
    )
    x, y = (columns[name] for name in model.states[:2])
    for part in _trajectories(model):
        if part.values and {x, y} <= set(part.values):
            at.plot(_numbers(part.values[x]), _numbers(part.values[y]))
    at.set_xlabel(label(model.result, x))
    at.set_ylabel(label(model.result, y))
    return np.array([at])


def plot_front(model: "Model", axes: object = None) -> Axes:
    """Plot for each equation the error of its front over complexity; the member it was made of is marked."""
    equations = model.result.equations
    each = _axes(axes, len(equations))
    for at, equation in zip(each, equations, strict=True):
        at.semilogy(*front(equation.front), "o-")
        at.semilogy(*front(equation.front, is_selected=True), "s", color="C3")
        at.set_ylabel(f"error of {equation.lhs}")
    each[-1].set_xlabel("complexity")
    return each


def _axes(axes: object, number: int) -> Axes:
    """Return so many axes, below each other; raises UsageError without matplotlib or with another number of axes."""
    if axes is not None:
        given: Axes = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
        if len(given) != number:
            raise UsageError(f"{number} axes are needed, but {len(given)} were given")
        return given
    try:
        from matplotlib import pyplot
    except ImportError:
        raise UsageError("pictures need matplotlib, which is not installed; run: pip install 'atoll[plots]'") from None
    figure, made = pyplot.subplots(number, 1, squeeze=False, sharex=True, figsize=(7.0, 2.0 + 2.0 * number))
    figure.set_layout_engine("tight")
    drawn: Axes = made.ravel()
    return drawn


def _trajectories(model: "Model") -> Sequence[Simulated]:
    parts = model.result.simulated
    if not parts:
        raise UsageError("the result has no simulated trajectory; only a model of trajectories can be plotted so")
    return parts


def _numbers(values: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
