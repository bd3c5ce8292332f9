"""From a raw table to the regression problems of a job: the one place where measurements become a `Dataset`. Pure."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from common.config import JobConfig
from common.dataset import Dataset, FloatArray, Target
from common.errors import DataError
from common.table import Table
from coordinator.data.checks import MIN_ROWS
from coordinator.data.columns import Roles, left_hand_side, variable_columns, velocity_columns
from coordinator.data.derivatives import END_ROWS, Estimate, end_rows, estimate
from coordinator.data.describe import describe
from coordinator.data.kernels_smoothing import moments
from coordinator.data.measured import Measured, measured
from coordinator.data.prior import resolve_roles
from coordinator.data.recorded import recorded
from coordinator.data.recording import Preparation
from coordinator.data.smoothing import Run
from coordinator.data.symbols import symbols_for

__all__ = ["describe", "prepare"]


GOOD_ENOUGH: Final = 1e-5
"""Rows whose derivative is uncertain by less than this share of its standard deviation are always kept."""
FAR_OUT: Final = 5.0
"""Rows whose uncertainty is less than this many times the median one are kept as well."""
LEAST_KEPT: Final = 0.7
"""Share of the rows that is kept however uncertain they are."""
MOST_UNEVEN: Final = 2.0
"""Root mean square of the uncertainty over its mean, at most, on the rows kept."""
LEAST_SPREAD: Final = 1e-3
"""A derivative that varies less than this share of its mean is judged by the mean: it may well be constant."""
ROUNDING: Final = 1e-12
SMALLEST: Final = 1e-150
"""Numbers below this, or above its inverse, have no square that can be told from zero or infinity."""
PASSES: Final = 3
"""A wild row swells the standard deviation by which rows are judged, so that they are judged again without it."""


def prepare(table: Table, config: JobConfig) -> Preparation:
    """Return the regression problems that `table` holds under `config`, and the recording that they come from.

    Raises:
        UsageError: options contradict each other.
        DataError: the measurements cannot be used as they are; the message says where and what to do.
    """
    its = measured(table, config.data)
    _, equations = resolve_roles(config.model_copy(update={"data": its.config}), its.roles)
    if its.trajectories is None:
        return Preparation(_given(its, equations))
    return _differentiated(its, equations, paper=config.preset == "paper")


def _given(its: Measured, equations: Sequence[str]) -> Dataset:
    """Prepare a table that holds the left-hand sides: labels or derivatives, taken as exact."""
    names = variable_columns(its.roles, its.config.order)
    symbols = symbols_for(names)
    targets = []
    for name, column in zip(its.roles.equations, its.roles.derivatives or its.roles.equations, strict=True):
        values = its.column(column, angle_of=name)
        deviation = _finite_spread(column, values)
        targets.append(Target(name, left_hand_side(its.roles, name, its.config.order), values, 0.0, deviation))
    inputs = np.array([its.column(name) for name in names])
    return Dataset(tuple(symbols[name] for name in names), inputs, _chosen(targets, equations), symbols, its.warnings)


def _chosen(targets: Sequence[Target], equations: Sequence[str]) -> tuple[Target, ...]:
    return tuple(target for target in targets if target.variable in equations)


def _differentiated(its: Measured, equations: Sequence[str], *, paper: bool) -> Preparation:
    """Prepare measured states: smooth or interpolate them, and differentiate."""
    assert its.trajectories is not None
    times = its.trajectories.times
    estimates = []
    for name in its.roles.states:
        runs = [Run(each, part) for each, part in zip(times, its.states[name], strict=True)]
        estimates.append(estimate(runs, its.config.order, paper=paper))
        _finite_spread(f"derivative of {name}", estimates[-1].derivative)
    kept, warnings = _kept(estimates, [len(each) for each in times], its.roles)
    velocities = velocity_columns(its.roles, its.config.order)
    inputs = [its.along(name) for name in its.roles.inputs]
    symbols = symbols_for(variable_columns(its.roles, its.config.order))
    targets = [
        _target(name, left_hand_side(its.roles, name, its.config.order), each, kept)
        for name, each in zip(its.roles.states, estimates, strict=True)
    ]
    values = [each.values for each in estimates]
    values += [each.velocity for each in estimates if velocities]
    values += [np.concatenate(parts) for parts in inputs]
    dataset = Dataset(
        tuple(symbols.values()),
        np.ascontiguousarray(np.array(values)[:, kept]),
        _chosen(targets, equations),
        symbols,
        (*its.warnings, *warnings),
    )
    return Preparation(dataset, recorded(its, velocities, inputs, symbols, estimates))


def _kept(estimates: Sequence[Estimate], lengths: Sequence[int], roles: Roles) -> tuple[list[int], list[str]]:
    """Return the rows that every target uses, and sentences about what was left out.

    Where a state is interpolated, the ends of trajectories and rows of very uncertain derivatives are left out: jumps
    and passages by a singularity that the sampling does not resolve.
    """
    uncertain = [each for each in estimates if each.interpolated]
    everything = list(range(sum(lengths)))
    if not uncertain:
        return everything, []
    warnings = []
    ends = end_rows(lengths)
    inner = [row for row in everything if ends[row] == 0.0]
    if len(inner) < len(everything):
        rows = f"{END_ROWS} rows at each end of a trajectory"
        warnings.append(f"Data without noise are interpolated, not smoothed; {rows} are left out.")
    kept = _certain(uncertain, inner)
    if len(kept) < len(inner):
        count = len(inner) - len(kept)
        warnings.append(f"{count} of {len(inner)} rows change too fast for the sampling step and are left out.")
    if len(kept) < MIN_ROWS:
        states = ", ".join(roles.states)
        raise DataError(f"only {len(kept)} rows of {states} can be differentiated; sample more of them")
    return kept, warnings


def _certain(estimates: Sequence[Estimate], inner: list[int]) -> list[int]:
    """Return the rows of `inner` whose relative uncertainty, the worst of all states, is small enough."""
    kept = inner
    for _ in range(PASSES):
        worst = np.zeros(len(inner))
        for its in estimates:
            worst = np.maximum(worst, its.uncertainty[inner] / _spread(its.derivative[kept], LEAST_SPREAD))
        ordered = np.sort(worst).tolist()
        limit = max(GOOD_ENOUGH, FAR_OUT * ordered[len(inner) // 2], ordered[math.ceil(LEAST_KEPT * len(inner)) - 1])
        kept = [row for row, uncertainty in zip(inner, worst.tolist(), strict=True) if uncertainty <= limit]
    return _evenly_uncertain(estimates, kept, math.ceil(LEAST_KEPT * len(inner)))


def _evenly_uncertain(estimates: Sequence[Estimate], kept: list[int], least: int) -> list[int]:
    """Return `kept` without the rows that alone would decide a mean square, at least `least` of them.

    The floor of a target is the mean uncertainty, yet equations are compared by mean squared error: where a few rows
    are far more uncertain than the others, their errors exceed the floor and a wrong term that mends them pays. So the
    most uncertain rows go until, for every state, the root mean square is at most `MOST_UNEVEN` times the mean.
    """
    for its in estimates:
        uncertainty = its.uncertainty[kept].tolist()
        ordered = sorted(uncertainty)
        total, square, enough = 0.0, 0.0, 0
        for count, value in enumerate(ordered, start=1):
            total += value
            square += value * value
            if count <= least or square * count <= (MOST_UNEVEN * total) ** 2:
                enough = count
        limit = ordered[enough - 1] if enough else math.inf
        kept = [row for row, value in zip(kept, uncertainty, strict=True) if value <= limit]
    return kept


def _target(name: str, lhs: str, its: Estimate, kept: list[int]) -> Target:
    values = np.ascontiguousarray(its.derivative[kept])
    deviation = _finite_spread(f"derivative of {name}", values)
    floor, _ = moments(np.ascontiguousarray(its.uncertainty[kept] / deviation))
    if not math.isfinite(floor):
        raise DataError(f"the uncertainty of the derivative of '{name}' cannot be told; sample more often")
    _, spread = moments(values)
    if spread < deviation:  # constant but for rounding, of which a comparison of two orders sees only a part
        floor = max(floor, spread / deviation)
    return Target(name, lhs, values, floor, deviation, its.noise)


def _finite_spread(name: str, values: FloatArray) -> float:
    """Return the standard deviation; raises DataError when it is beyond the range of numbers."""
    spread = _spread(values, ROUNDING)
    if not SMALLEST < spread < 1.0 / SMALLEST:
        raise DataError(f"the values of '{name}' are too large or too small to compute with; choose another unit")
    return spread


def _spread(values: FloatArray, least: float) -> float:
    """Return the standard deviation, or `least` times the mean's size where the values hardly vary."""
    mean, deviation = moments(values)
    return max(deviation, least * abs(mean), SMALLEST)
