"""From a raw table to the regression problems of a job: the one place where measurements become a `Dataset`. Pure."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from common.config import Angle, DataConfig, JobConfig
from common.dataset import Dataset, FloatArray, Target
from common.errors import DataError
from common.table import Table
from coordinator.data import checks
from coordinator.data.columns import Roles, resolve
from coordinator.data.derivatives import Estimate, end_rows, estimate
from coordinator.data.kernels_smoothing import moments
from coordinator.data.smoothing import Run
from coordinator.data.symbols import symbols_for
from coordinator.data.trajectories import Trajectories, in_radians, runs_of, trajectories_of, unwrapped

GOOD_ENOUGH: Final = 1e-5
"""Rows whose derivative is uncertain by less than this share of its standard deviation are always kept."""
LEAST_KEPT: Final = 0.7
"""Share of the rows that is kept however uncertain they are."""
PASSES: Final = 3
"""A wild row swells the standard deviation by which rows are judged, so that they are judged again without it."""


def prepare(table: Table, config: JobConfig) -> Dataset:
    """Return the regression problems that `table` holds under `config`.

    Raises:
        UsageError: options contradict each other.
        DataError: the measurements cannot be used as they are; the message says where and what to do.
    """
    roles = resolve(table, config.data)
    checks.check_rows(table, table.rows)
    rows, dropped = checks.finite_rows(table, roles, config.data.missing == "drop")
    checks.check_rows(table, len(rows))
    warnings = [dropped] if dropped else []
    warnings += _remarks(table, roles, config.data)
    if roles.target is not None or roles.derivatives:
        return _given(table, config.data, roles, rows, warnings)
    return _differentiated(table, config, roles, rows, warnings)


def describe(table: Table, config: JobConfig) -> str:
    """Return a few lines on what was read: rows, trajectories, time and columns; raises as `prepare` does."""
    roles = resolve(table, config.data)
    rows, _ = checks.finite_rows(table, roles, drop=True)
    runs = runs_of(table, rows, roles.trajectory)
    files = ", ".join(table.files) if len(table.files) <= 3 else f"{len(table.files)} files"
    several = f"{len(runs)} trajectories" if len(runs) > 1 else "1 trajectory"
    lines = [f"{files}: {several}, {table.rows} rows"]
    if roles.time is not None:
        lines.append(f"time {_with_unit(table, roles.time)}: {_times(table.column(roles.time)[rows], runs)}")
    parts = [("states", roles.states), ("derivatives", roles.derivatives), ("inputs", roles.inputs)]
    if roles.target is not None:
        parts = [("target", (roles.target,)), ("inputs", roles.inputs)]
    lines += [f"{part}: {', '.join(_with_unit(table, name) for name in names)}" for part, names in parts if names]
    return "\n".join(lines)


def _with_unit(table: Table, name: str) -> str:
    unit = table.units[table.names.index(name)]
    return f"{name} [{unit}]" if unit else name


def _times(times: FloatArray, runs: Sequence[tuple[int, int]]) -> str:
    """Return range and step of the times, such as ``0 to 9.98, step 0.02``."""
    steps = np.sort(np.concatenate([np.diff(times[first:last]) for first, last in runs]))
    text = f"{float(np.min(times)):g} to {float(np.max(times)):g}"
    if not len(steps):
        return text
    low, high, middle = float(steps[0]), float(steps[-1]), float(steps[len(steps) // 2])
    is_even = high - low <= 1e-6 * abs(middle) + 8.0 * float(np.spacing(np.max(np.abs(times))))
    return f"{text}, step {middle:g}" if is_even else f"{text}, steps {low:g} to {high:g}"


def _remarks(table: Table, roles: Roles, config: DataConfig) -> list[str]:
    """Return sentences about choices that the user may not expect."""
    remarks = []
    if table.skipped:
        remarks.append(f"Columns of text are not used: {', '.join(table.skipped)}.")
    if roles.target is not None and config.states is None and not config.inputs:
        left = [name for name in ("t", "time") if name in table.names and name not in roles.used]
        remarks += [f"Column '{name}' is taken for time and not used; add --inputs {name} to use it." for name in left]
    degrees = [angle.column for angle in config.angles if angle.degrees]
    if degrees:
        remarks.append(f"Degrees were converted to radians: {', '.join(degrees)}.")
    return remarks


def _given(table: Table, config: DataConfig, roles: Roles, rows: list[int], warnings: list[str]) -> Dataset:
    """Prepare a table that holds the left-hand sides: labels or derivatives, taken as exact."""
    angles = {angle.column: angle for angle in config.angles}
    names = (*roles.states, *roles.inputs)
    inputs = np.array([_column(table, name, rows, angles) for name in names])
    constant = [name for name, values in zip(names, inputs, strict=True) if np.all(values == values[0])]
    warnings += [f"Column '{name}' is constant and of no use to an equation." for name in constant]
    targets = []
    for name, column in zip(roles.equations, roles.derivatives or roles.equations, strict=True):
        values = _column(table, column, rows, {column: angles[name]} if name in angles else {})
        checks.check_varies(table, column, values, "target")
        _, deviation = moments(values)
        targets.append(Target(name, _lhs(name, roles, config), values, 0.0, deviation))
    symbols = symbols_for(names)
    chosen = tuple(target for target in targets if config.only is None or target.variable in config.only)
    return Dataset(tuple(symbols[name] for name in names), inputs, chosen, symbols, tuple(warnings))


def _column(table: Table, name: str, rows: Sequence[int], angles: dict[str, Angle]) -> FloatArray:
    values = np.ascontiguousarray(table.column(name)[list(rows)])
    return in_radians(values, angles[name]) if name in angles else values


def _lhs(name: str, roles: Roles, config: DataConfig) -> str:
    if roles.target is not None:
        return name
    time = roles.time or "t"
    return f"d2{name}/d{time}2" if config.order == 2 else f"d{name}/d{time}"


def _differentiated(table: Table, config: JobConfig, roles: Roles, rows: list[int], warnings: list[str]) -> Dataset:
    """Prepare measured states: smooth or interpolate them, and differentiate."""
    trajectories = trajectories_of(table, roles, rows)
    paper = config.preset == "paper"
    estimates = [
        estimate(_runs(table, name, trajectories, config.data), config.data.order, paper=paper) for name in roles.states
    ]
    kept = _kept(estimates, [last - first for first, last in trajectories.runs], roles, warnings)
    symbols, names, inputs = _variables(table, config.data, roles, trajectories, estimates)
    targets = tuple(
        _target(name, _lhs(name, roles, config.data), its, kept)
        for name, its in zip(roles.states, estimates, strict=True)
        if config.data.only is None or name in config.data.only
    )
    return Dataset(names, np.ascontiguousarray(inputs[:, kept]), targets, symbols, tuple(warnings))


def _runs(table: Table, name: str, trajectories: Trajectories, config: DataConfig) -> list[Run]:
    """Return one state along each trajectory, angles unwrapped; raises DataError when it cannot be a state."""
    values = np.ascontiguousarray(table.column(name)[list(trajectories.rows)])
    checks.check_varies(table, name, values, "state")
    angle = next((each for each in config.angles if each.column == name), None)
    parts = trajectories.split(values)
    if angle is None:
        checks.check_no_turns(name, parts)
    else:
        parts = [unwrapped(in_radians(part, angle)) for part in parts]
    return [Run(times, np.ascontiguousarray(part)) for times, part in zip(trajectories.times, parts, strict=True)]


def _variables(
    table: Table, config: DataConfig, roles: Roles, trajectories: Trajectories, estimates: Sequence[Estimate]
) -> tuple[dict[str, str], tuple[str, ...], FloatArray]:
    """Return symbols, names and values (V, R) of the variables: states, their velocities for order 2, inputs."""
    columns = [*roles.states]
    values = [its.values for its in estimates]
    if config.order == 2:
        columns += [_fresh(f"{name}_dot", (*roles.states, *roles.inputs)) for name in roles.states]
        values += [its.velocity for its in estimates]
    angles = {angle.column: angle for angle in config.angles}
    for name in roles.inputs:
        columns.append(name)
        values.append(_column(table, name, trajectories.rows, angles))
    symbols = symbols_for(columns)
    return symbols, tuple(symbols[name] for name in columns), np.array(values)


def _fresh(name: str, taken: Sequence[str]) -> str:
    return _fresh(name + "_", taken) if name in taken else name


def _kept(estimates: Sequence[Estimate], lengths: Sequence[int], roles: Roles, warnings: list[str]) -> list[int]:
    """Return the rows that every target uses, and say what was left out.

    Where a state is interpolated, the ends of trajectories and rows of very uncertain derivatives are left out: jumps
    and passages by a singularity that the sampling does not resolve.
    """
    uncertain = [its for its in estimates if its.interpolated]
    everything = list(range(sum(lengths)))
    if not uncertain:
        return everything
    ends = end_rows(lengths)
    inner = [row for row in everything if ends[row] == 0.0]
    if len(inner) < len(everything):
        warnings.append("Data without noise are interpolated: 4 rows at each end of a trajectory are left out.")
    kept = _certain(uncertain, inner)
    if len(kept) < len(inner):
        count = len(inner) - len(kept)
        warnings.append(f"{count} of {len(inner)} rows change too fast for the sampling step and are left out.")
    if len(kept) < checks.MIN_ROWS:
        states = ", ".join(roles.states)
        raise DataError(f"only {len(kept)} rows of {states} can be differentiated; sample more of them")
    return kept


def _certain(estimates: Sequence[Estimate], inner: list[int]) -> list[int]:
    """Return the rows of `inner` whose relative uncertainty, the worst of all states, is small enough."""
    kept = inner
    for _ in range(PASSES):
        worst = np.zeros(len(inner))
        for its in estimates:
            _, deviation = moments(its.derivative[kept])
            worst = np.maximum(worst, its.uncertainty[inner] / max(deviation, 1e-300))
        limit = max(GOOD_ENOUGH, float(np.sort(worst)[math.ceil(LEAST_KEPT * len(inner)) - 1]))
        kept = [row for row, uncertainty in zip(inner, worst.tolist(), strict=True) if uncertainty <= limit]
    return kept


def _target(name: str, lhs: str, its: Estimate, kept: list[int]) -> Target:
    values = np.ascontiguousarray(its.derivative[kept])
    _, deviation = moments(values)
    uncertainty, _ = moments(np.ascontiguousarray(its.uncertainty[kept]))
    if not (math.isfinite(deviation) and deviation > 0.0 and math.isfinite(uncertainty)):
        raise DataError(f"the derivative of '{name}' cannot be estimated (it has no finite spread); check its values")
    return Target(name, lhs, values, uncertainty / deviation, deviation, its.noise)
