"""From a raw table to the regression problems of a job: the one place where measurements become a `Dataset`. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.config import JobConfig
from atoll.data.dataset import Dataset, FloatArray, Target
from atoll.data.table import Table
from atoll.errors import DataError
from atoll_coordinator.data.differentiation.derivatives import Estimate, Way, estimate
from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS, moments
from atoll_coordinator.data.differentiation.smoothing import Run
from atoll_coordinator.data.differentiation.spread import finite_spread
from atoll_coordinator.data.prior_knowledge import resolve_roles
from atoll_coordinator.data.reading.checks import MIN_ROWS
from atoll_coordinator.data.reading.columns import left_hand_side, variable_columns, velocity_columns
from atoll_coordinator.data.reading.description import describe
from atoll_coordinator.data.reading.measured import Measured, measured
from atoll_coordinator.data.reading.symbols import symbols_for
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.data.row_selection.rows import Kept, kept_rows
from atoll_coordinator.data.row_selection.weights import weighty_enough
from atoll_coordinator.data.trajectories.gaps import split_at_gaps
from atoll_coordinator.data.trajectories.recorded import recorded

__all__ = ["describe", "prepare"]

MANY_OUTLIERS: Final = 0.1
"""Share of the rows beyond which outliers are hardly errors of measurement."""


def prepare(table: Table, config: JobConfig) -> Preparation:
    """Return the regression problems that `table` holds under `config`, and the recording that they come from.

    Raises:
        UsageError: options contradict each other.
        DataError: the measurements cannot be used as they are; the message says where and what to do.
    """
    its = measured(table, config.data)
    _, equations = resolve_roles(config.model_copy(update={"data": its.config}), its.roles)
    its = replace(its, config=its.config.model_copy(update={"only": equations}))
    if its.trajectories is None:
        return _given(its)
    way = Way(its.config.order, config.preset == "paper", its.config.robust)
    estimates = _estimated(its, way)
    pieces = split_at_gaps(its, max(_span(each) for each in estimates))
    if pieces.runs != its.runs:
        estimates = _estimated(pieces, way)
    return _differentiated(pieces, estimates, paper=way.paper)


@dataclass(frozen=True, eq=False)
class _Columns:
    """What the variables are: their symbols by column name, and their values (V, R) at all rows."""

    symbols: Mapping[str, str]
    values: FloatArray


def _given(its: Measured) -> Preparation:
    """Prepare a table that holds the left-hand sides: labels or derivatives, taken as exact."""
    names = variable_columns(its.roles, its.config.order)
    columns = _Columns(symbols_for(names), np.array([its.column(name) for name in names]))
    seen, held_out = its.indices(held_out=False), its.indices(held_out=True)
    everything = len(seen)
    if its.weights is not None:
        seen = weighty_enough(its.weights, seen)
    if len(seen) < everything:
        sentence = f"{everything - len(seen)} of {everything} rows have little weight and are left out of the search."
        its = replace(its, warnings=(*its.warnings, sentence))
    targets = []
    for name, column in zip(its.roles.equations, its.roles.derivatives or its.roles.equations, strict=True):
        values = its.column(column, angle_of=name)
        deviation = finite_spread(column, values[seen])
        targets.append(Target(name, left_hand_side(its.roles, name, its.config.order), values, 0.0, deviation))
    return Preparation(
        _dataset(its, columns, targets, seen),
        None,
        _dataset(its, columns, targets, held_out) if held_out else None,
        None if its.weights is None else its.weights[seen],
    )


def _dataset(its: Measured, columns: _Columns, targets: Sequence[Target], rows: list[int]) -> Dataset:
    """Return the problems that are sought, of some rows; `targets` have the values of all rows."""
    chosen = [target for target in targets if not its.config.only or target.variable in its.config.only]
    return Dataset(
        tuple(columns.symbols.values()),
        np.ascontiguousarray(columns.values[:, rows]),
        tuple(replace(target, values=np.ascontiguousarray(target.values[rows])) for target in chosen),
        dict(columns.symbols),
        its.warnings,
    )


def _estimated(its: Measured, way: Way) -> list[Estimate]:
    """Smooth or interpolate measured states, and differentiate them."""
    assert its.trajectories is not None
    estimates = []
    for name in its.roles.states:
        runs = [
            Run(each, part, precision=None if its.weights is None else its.weights[first:last])
            for each, part, (first, last) in zip(its.trajectories.times, its.states[name], its.runs, strict=True)
        ]
        estimates.append(estimate(runs, way, its.held_out))
        _derivative_spread(name, estimates[-1].derivative)
    return estimates


def _span(its: Estimate) -> int:
    """Return how many rows are looked at together."""
    return its.choice.rows if its.choice is not None else 2 * HALF_WIDTHS + 1


def _differentiated(its: Measured, estimates: Sequence[Estimate], *, paper: bool) -> Preparation:
    """Return the problems and the recording that smoothed and differentiated states make."""
    lengths = [last - first for first, last in its.runs]
    kept = kept_rows(estimates, lengths, its.indices(held_out=False), its.indices(held_out=True), paper=paper)
    its = replace(its, warnings=(*its.warnings, *kept.warnings, *_remarks(its, estimates, kept)))
    velocities = velocity_columns(its.roles, its.config.order)
    inputs = [its.along(name) for name in its.roles.inputs]
    symbols = symbols_for(variable_columns(its.roles, its.config.order))
    values = [each.values for each in estimates]
    values += [each.velocity for each in estimates if velocities]
    values += [np.concatenate(parts) for parts in inputs]
    columns = _Columns(symbols, np.array(values))
    targets = [
        _target(name, left_hand_side(its.roles, name, its.config.order), each, kept.seen)
        for name, each in zip(its.roles.states, estimates, strict=True)
    ]
    return Preparation(
        _dataset(its, columns, targets, kept.seen),
        recorded(its, velocities, inputs, symbols, estimates, kept),
        _dataset(its, columns, targets, kept.held_out) if kept.held_out else None,
    )


def _remarks(its: Measured, estimates: Sequence[Estimate], kept: Kept) -> list[str]:
    """Return sentences about what smoothing met; raises DataError when it left too little."""
    if len(kept.seen) < MIN_ROWS:
        states = ", ".join(its.roles.states)
        raise DataError(f"only {len(kept.seen)} rows of {states} can be differentiated; sample more of them")
    named = list(zip(its.roles.states, estimates, strict=True))
    remarks = [_outliers(name, each.outliers, len(each.values)) for name, each in named if each.outliers]
    tailed = [name for name, each in named if each.has_heavy_tails]
    if tailed:
        remarks.append(
            f"Some measurements of {', '.join(tailed)} look like outliers; --robust takes their weight away."
        )
    if any(its.held_out) and not kept.held_out:
        remarks.append("No row that was held out can be differentiated well; equations are not judged by them.")
    return remarks


def _outliers(state: str, count: int, rows: int) -> str:
    """Return a sentence about the outliers of a state."""
    sentence = f"State '{state}' has {count} {'outlier' if count == 1 else 'outliers'} without weight"
    many = "; so many suggest that rows are too far apart for --robust, not that they are wrong"
    return sentence + (many if count > MANY_OUTLIERS * rows else "") + "."


def _target(name: str, lhs: str, its: Estimate, kept: list[int]) -> Target:
    """Return the target over all rows, with floor and deviation of those `kept`."""
    values = np.ascontiguousarray(its.derivative[kept])
    deviation = _derivative_spread(name, values)
    floor, _ = moments(np.ascontiguousarray(its.uncertainty[kept] / deviation))
    if not math.isfinite(floor):
        raise DataError(f"the uncertainty of the derivative of '{name}' cannot be told; sample more often")
    _, spread = moments(values)
    if spread < deviation:  # constant but for rounding, of which a comparison of two orders sees only a part
        floor = max(floor, spread / deviation)
    return Target(name, lhs, its.derivative, floor, deviation, its.noise)


def _derivative_spread(state: str, values: FloatArray) -> float:
    """Return the standard deviation of a state's derivative; raises DataError when there is none to compute with."""
    if not values.any():
        raise DataError(
            f"state '{state}' stands still wherever it can be differentiated, as one that is switched between values "
            f"does, so that no equation can be sought; make it an input with --inputs {state}"
        )
    return finite_spread(f"derivative of {state}", values)
