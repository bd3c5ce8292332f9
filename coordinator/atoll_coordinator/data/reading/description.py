"""What was read, in a few lines for a person. Pure, and cheap: nothing is smoothed or compiled."""

from collections.abc import Sequence

import numpy as np

from atoll.config import JobConfig, PriorConfig
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll_coordinator.data.prior_knowledge import resolve_roles
from atoll_coordinator.data.reading.columns import left_hand_side
from atoll_coordinator.data.reading.measured import Measured, measured


def describe(table: Table, config: JobConfig) -> str:
    """Return lines on files, trajectories, rows, time, columns and what is known beforehand.

    Raises:
        UsageError: options contradict each other, or what is known beforehand cannot be used.
        DataError: the measurements cannot be used as they are.
    """
    its = measured(table, config.data)
    resolved, _ = resolve_roles(config.model_copy(update={"data": its.config}), its.roles)
    lines = [_size(its)]
    if its.roles.time is not None:
        lines.append(f"time {_with_unit(table, its.roles.time)}: {_times(its.column(its.roles.time), its.runs)}")
    roles = its.roles
    parts = [("states", roles.states), ("derivatives", roles.derivatives), ("inputs", roles.inputs)]
    if roles.target is not None:
        parts = [("target", (roles.target,)), ("inputs", roles.inputs)]
    parts.append(("weights", () if roles.weights is None else (roles.weights,)))
    lines += [f"{part}: {', '.join(_with_unit(table, name) for name in names)}" for part, names in parts if names]
    return "\n".join([*lines, *_prior(resolved.prior, its)])


def _prior(prior: PriorConfig, its: Measured) -> list[str]:
    sides = {name: left_hand_side(its.roles, name, its.config.order) for name in its.roles.equations}
    known = [f"known: {sides[name]} = {text}" for name, text in prior.known.items()]
    return known + [f"guess: {sides[name]} = {text}" for name, texts in prior.guesses.items() for text in texts]


def _size(its: Measured) -> str:
    files = its.table.files
    named = ", ".join(files) if len(files) <= 3 else f"{len(files)} files"
    runs = f"{len(its.runs)} trajectories, " if len(its.runs) > 1 else ""
    kept = f" ({len(its.rows)} without missing values)" if len(its.rows) < its.table.rows else ""
    return f"{named}: {runs}{its.table.rows} rows{kept}"


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
