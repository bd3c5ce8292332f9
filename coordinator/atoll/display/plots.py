"""Plot a model with Matplotlib, which is an extra: ``pip install 'atoll[plots]'``.

Each function draws into `axes` or, by default, into a new figure, and returns the axes as an array.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from atoll.analysis.analyse import MOST_STATES, box_of
from atoll.analysis.dynamics import measured_trajectories
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Box, Flow
from atoll.display.curves import curves_of, front, label, residuals
from atoll.model.arguments import values_of_curve
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_core.errors import UsageError

if TYPE_CHECKING:
    from atoll.model.core import ModelCore

Axes = npt.NDArray[np.object_]
"""An array of Matplotlib axes."""

_GRID = 24
"""Number of arrows along each side of a phase plane."""


def plot_fit(model: "ModelCore", axes: object = None) -> Axes:
    """Plot each state over time in its own axes: measured values, and the simulation with its 95 % band."""
    parts = _trajectories(model)
    states = list(parts[0].values or {})
    each = _axes_over_time(model, states, axes)
    curves = [curves_of(model, part) for part in parts]
    for at, state in zip(each, states, strict=True):
        for number, part in enumerate(parts):
            if not part.values:
                continue
            color, drawn = f"C{number % 10}", curves[number]
            times = values_of_curve(drawn.times)
            if drawn.lower and drawn.upper:
                bounds = (values_of_curve(side[state]) for side in (drawn.lower, drawn.upper))
                at.fill_between(times, *bounds, color=color, alpha=0.3)
            at.plot(times, values_of_curve(drawn.values[state]), color=color, label=part.name)
            if state in part.measured:
                at.plot(part.times, values_of_curve(part.measured[state]), ".", color=color, markersize=3)
    if len(parts) > 1:
        each[0].legend(loc="best")
    return each


def plot_forecast(
    model: "ModelCore", columns: Mapping[str, npt.NDArray[np.float64]], measured: Mapping[str, npt.NDArray[np.float64]],
    axes: object = None,
) -> Axes:  # fmt: skip
    """Plot a forecast: measured values, the median, and the 50 % and 95 % bands of each state and computed column.

    `columns` (N,) are the columns of a forecast, `measured` (R,) the measured columns and their times, by name.
    """
    time, by_symbol = model.time, model.result.columns_by_symbol
    states = (*model.states, *model.observed_columns)
    each = _axes_over_time(model, [by_symbol.get(state, state) for state in states], axes)
    for at, state in zip(each, states, strict=True):
        for suffix in ("", "50"):
            ends = (columns[f"{state}_{end}{suffix}"] for end in ("lower", "upper"))
            at.fill_between(columns[time], *ends, color="C1", alpha=0.3)
        at.plot(columns[time], columns[state], color="C1")
        if state in measured:
            at.plot(measured[time], measured[state], ".", color="C0", markersize=3)
    return each


def plot_residuals(model: "ModelCore", axes: object = None) -> Axes:
    """Plot the residuals (measured minus simulated values) of each state and trajectory over time."""
    parts = [part for part in _trajectories(model) if part.values and part.measured]
    if not parts:
        raise UsageError("the result has no rows with measured and simulated values, so there are no residuals to plot")
    states = [state for state in parts[0].values or {} if state in parts[0].measured]
    each = _axes_over_time(model, states, axes)
    for at, state in zip(each, states, strict=True):
        for number, part in enumerate(parts):
            differences = residuals(part.measured[state], (part.values or {})[state])
            at.plot(part.times, values_of_curve(differences), ".", color=f"C{number % 10}")
        at.axhline(0.0, color="0.5", linewidth=0.8)
    return each


def plot_phase(model: "ModelCore", axes: object = None) -> Axes:
    """Plot the plane of the first two states around the measured range.

    The other states have the middle of their measured range. The plot shows the directions of the flow, the measured
    points, the simulated trajectories, and the fixed points, which are filled if they are stable.
    """
    if len(model.states) < 2:
        raise UsageError("a phase plane needs two states, but this model has one")
    if model.inputs:
        raise UsageError(
            f"the model has the inputs {', '.join(model.inputs)}, so its directions depend on more than two states"
        )
    model.require_one_group()
    columns, known = model.result.columns_by_symbol, model.result.ranges
    lacking = next((name for name in model.states if name not in known), None)
    if lacking is not None:
        raise UsageError(f"the result has no measured range of {lacking!r}")
    box = box_of(model.result, model.field, measured_trajectories(model.result, model.field), {})
    first, second = np.meshgrid(*(np.linspace(box.lower[place], box.upper[place], _GRID) for place in (0, 1)))
    points = np.tile([0.5 * sum(known[name]) for name in model.states], (first.size, 1))
    points[:, 0], points[:, 1] = first.ravel(), second.ravel()
    across, up = (rates.reshape(first.shape) for rates in model.field.values(points).T[:2])
    x, y = (columns[name] for name in model.states[:2])
    each = _axes(axes, [label(model.result, y)], label(model.result, x))
    at = each[0]
    at.streamplot(first, second, across, up, color="0.7", density=0.8)
    parts = _trajectories(model)
    for number, part in enumerate(parts):
        if part.values and {x, y} <= set(part.values):
            color, drawn = f"C{number % 10}", curves_of(model, part).values
            at.plot(
                values_of_curve(drawn[x]),
                values_of_curve(drawn[y]),
                color=color,
                label=part.name if len(parts) > 1 else None,
            )
            if part.measured and {x, y} <= set(part.measured):
                at.plot(*(values_of_curve(part.measured[name]) for name in (x, y)), ".", color=color, markersize=3)
    _add_fixed_points(at, model, box)
    return each


def _add_fixed_points(at: Any, model: "ModelCore", box: Box) -> None:
    """Mark the fixed points in `box` if the model can be analysed."""
    if len(model.states) > MOST_STATES:
        return
    found = fixed_points(Flow.of(model.field), box).points
    for is_stable, kind, inside in ((True, "stable fixed point", "k"), (False, "other fixed point", "w")):
        places = [point.point[:2].tolist() for point in found if point.is_stable is is_stable]
        if places:
            at.plot(*zip(*places, strict=True), "o", color="k", markerfacecolor=inside, label=kind, zorder=3)
    if found:
        at.legend(loc="best")


def plot_front(model: "ModelCore", axes: object = None) -> Axes:
    """Plot for each equation the errors of its front over complexity, and mark the selected member."""
    equations = model.result.equations
    each = _axes(axes, [f"error of {equation.lhs}" for equation in equations], "complexity")
    for at, equation in zip(each, equations, strict=True):
        at.semilogy(*front(equation.front), "o-")
        at.semilogy(*front(equation.front, is_selected=True), "s", color="C3")
    return each


def _axes_over_time(model: "ModelCore", states: Sequence[str], axes: object) -> Axes:
    return _axes(axes, [label(model.result, state) for state in states], label(model.result, model.time))


def _axes(axes: object, heights: Sequence[str], width: str) -> Axes:
    """Return axes (one below another) with these labels.

    Raises UsageError if Matplotlib is not installed or the number of given axes is wrong.
    """
    if axes is None:
        try:
            from matplotlib import pyplot
        except ImportError:
            hint = "plots need Matplotlib, which is not installed; run: pip install 'atoll[plots]'"
            raise UsageError(hint) from None
        rows = len(heights)
        figure, axes = pyplot.subplots(rows, 1, squeeze=False, sharex=True, figsize=(7.0, 2.0 + 2.0 * rows))
        figure.set_layout_engine("tight")
    each: Axes = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    if len(each) != len(heights):
        raise UsageError(f"{len(heights)} axes are needed, but {len(each)} were given")
    for at, text in zip(each, heights, strict=True):
        at.set_ylabel(text)
    each[-1].set_xlabel(width)
    return each


def _trajectories(model: "ModelCore") -> Sequence[Simulated]:
    parts = model.result.simulated
    if not parts:
        raise UsageError("the result has no simulated trajectory; this plot needs a model of trajectories")
    return parts
