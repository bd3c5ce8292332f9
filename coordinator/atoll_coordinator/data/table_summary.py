"""What was read, in a few lines for a person. Pure, and cheap: nothing is smoothed or compiled."""

from collections.abc import Mapping, Sequence

import numpy as np

from atoll_coordinator.data.columns.examination import examine
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.roles.roles import Roles, assign_symbols
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table


def describe(table: Table, config: JobConfig, *, has_warnings: bool = True) -> str:
    """Return lines on files, how they were read, trajectories, rows, time, columns, what is known beforehand.

    Where it `has_warnings`, what the columns say themselves follows.

    Raises UsageError where options or what is known beforehand cannot be used, DataError where the measurements cannot.
    """
    examination = examine(table, config)
    roles, options, measurements = examination.roles, examination.options, examination.measurements
    config = config.model_copy(update={"data": options})
    resolved, _ = resolve_equations(config, roles, assign_symbols(roles.variables))
    units = {**dict(zip(table.names, table.units, strict=True)), **options.units}
    lines = [_size(table, measurements)]
    if table.read_as:
        lines.append(f"read as {table.read_as}")
    if roles.time is not None:
        times = _times(measurements.columns[roles.time], measurements.ranges)
        lines.append(f"time {_with_unit(roles.time, units)}: {times}")
    named = [("states", roles.states), ("derivatives", roles.derivatives), ("inputs", roles.inputs)]
    if roles.target is not None:
        named = [("target", (roles.target,)), ("inputs", roles.inputs)]
    named.append(("weights", () if roles.weights is None else (roles.weights,)))
    lines += [f"{role}: {', '.join(_with_unit(name, units) for name in names)}" for role, names in named if names]
    if measurements.group_names:
        lines.append(f"constants may differ between {len(measurements.group_names)} groups of trajectories")
    warnings = [f"warning: {finding.sentence}" for finding in examination.findings if has_warnings]
    return "\n".join([*lines, *_prior(resolved, roles), *warnings])


def _prior(config: JobConfig, roles: Roles) -> list[str]:
    prior, side = config.prior, roles.left_hand_side
    lines = [f"known: {side(name)} = {text}" for name, text in prior.known.items()]
    lines += [f"guess: {side(name)} = {text}" for name, texts in prior.guesses.items() for text in texts]
    lines += [f"required: {side(name)} has {', '.join(names)}" for name, names in config.space.required_of.items()]
    return lines + [f"bounds: {side(name)}: {'; '.join(texts)}" for name, texts in prior.bounds.items()]


def _size(table: Table, measurements: Measurements) -> str:
    files = ", ".join(table.files) if len(table.files) <= 3 else f"{len(table.files)} files"
    count = len(measurements.ranges)
    trajectories = f"{count} trajectories, " if count > 1 else ""
    used = f" ({measurements.row_count} that can be used)" if measurements.row_count < table.rows else ""
    return f"{files}: {trajectories}{table.rows} rows{used}"


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f"{name} [{units[name]}]" if units.get(name) else name


def _times(times: FloatArray, ranges: Sequence[tuple[int, int]]) -> str:
    """Return range and step of the times, such as ``0 to 9.98, step 0.02``."""
    steps = np.sort(np.concatenate([np.diff(times[first:last]) for first, last in ranges]))
    text = f"{float(np.min(times)):g} to {float(np.max(times)):g}"
    if not len(steps):
        return text
    low, high, middle = float(steps[0]), float(steps[-1]), float(steps[len(steps) // 2])
    is_even = high - low <= 1e-6 * abs(middle) + 8.0 * float(np.spacing(np.max(np.abs(times))))
    return f"{text}, step {middle:g}" if is_even else f"{text}, steps {low:g} to {high:g}"
