"""Columns of few values: inputs that are held between rows, states that are rounded coarsely or switched. Pure."""

import math
from collections.abc import Iterator

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding, Parts, listed
from atoll_coordinator.data.columns.sums import dot, mean, middle, variance
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns


def check_held_inputs(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for the inputs that seem to be constant from row to row; between rows others are curves."""
    data = columns.config.data
    if not columns.is_in_time or data.stochastic:
        return
    given = tuple(getattr(data, "hold", ()))
    held = [
        name
        for name in columns.roles.inputs
        if name not in (*given, *columns.angles) and (is_held(columns.values[name]) or _is_new(columns.values[name]))
    ]
    if held:
        named = " and ".join(f"'{name}'" for name in held)
        jump = "jumps, as an input that is" if len(held) == 1 else "jump, as inputs that are"
        yield Finding(
            f"{named} {jump} constant from each row to the next",
            f"if so, add --hold {listed((*given, *held))}, since inputs are smooth curves between rows otherwise",
        )


def check_few_levels(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for each state of a few values: it was rounded, or it is switched."""
    if not columns.is_in_time:
        return
    inputs = columns.roles.inputs
    for name in columns.roles.states:
        values = columns.finite(name)
        levels = np.unique(values)
        as_input = f"add --inputs {listed((*inputs, name))}"
        if has_few_levels(columns.values[name]):
            error = float(np.min(np.diff(levels))) / math.sqrt(12.0)
            share = error / math.sqrt(variance(values))
            yield Finding(
                f"'{name}' takes {len(levels)} values only; if it was rounded to them, its errors are {error:.2g} at "
                f"least ({100.0 * share:.2g} % of its standard deviation)",
                f"record it in finer steps, or, if it is switched, {as_input}",
            )
        elif is_held(columns.values[name]):
            yield Finding(
                f"'{name}' keeps its value for several rows and then jumps, so that it has no derivative",
                f"if it acts on the others from outside, {as_input}",
            )


def has_few_levels(parts: Parts) -> bool:
    """Say whether values are repeated so often that a quantity in finer steps would have shown others.

    What was recorded in half of these steps, or finer, takes one of the values shown by chance in every second row. A
    wave in step with the rows repeats its values, too, each of them once or twice a period.
    """
    values = _finite(parts)
    levels = len(np.unique(values))
    by_chance = math.log2(1.0 / SETTINGS.quantisation.improbable)
    if not 1 < levels < SETTINGS.quantisation.fewest_values or len(values) - levels < by_chance:
        return False
    return levels == 2 or not repeats_in_step(parts)


def repeats_in_step(parts: Parts) -> bool:
    """Say whether a column is a wave in step with the rows, which repeats each of its values once or twice a period."""
    levels = len(np.unique(_finite(parts)))
    return any(_has_period(parts, period) for period in range(levels, 2 * levels + 1))


def _has_period(parts: Parts, period: int) -> bool:
    repeated = 0
    for part in parts:
        later, earlier = part[period:], part[:-period]
        both = np.isfinite(later) & np.isfinite(earlier)
        if not np.array_equal(later[both], earlier[both]):
            return False
        repeated += int(np.count_nonzero(both))
    return repeated >= period


def _finite(parts: Parts) -> FloatArray:
    values: FloatArray = np.concatenate(list(parts))
    return values[np.isfinite(values)]


def is_held(parts: Parts) -> bool:
    """Say whether a column is constant from most rows to the next and then jumps; few values are always switched.

    A quantity that moves smoothly and was rounded goes to the next of its values; jumps are larger.
    """
    values = _finite(parts)
    if has_few_levels(parts):
        return True
    steps = np.abs(np.concatenate([np.diff(part) for part in parts]))
    steps, levels = steps[np.isfinite(steps)], np.unique(values)
    jumps = steps[steps > 0.0]
    if len(jumps) < LIMITS.least_repeats or 2 * len(jumps) > len(steps):
        return False
    typical = middle(jumps)
    return typical > SETTINGS.inference.part * float(levels[-1] - levels[0]) and typical > 1.5 * middle(np.diff(levels))


def _is_new(parts: Parts) -> bool:
    """Say whether a column is as if drawn anew in each row: rows beside it tell nothing of a row.

    Of a wave they do, however few rows a period has: the correlation with the sum of both neighbours is 1 or -1.
    """
    rows = np.concatenate([part[1:-1] for part in parts if len(part) > 2] or [np.zeros(0)])
    around = np.concatenate([part[2:] + part[:-2] for part in parts if len(part) > 2] or [np.zeros(0)])
    is_there = np.isfinite(rows) & np.isfinite(around)
    rows, around = rows[is_there], around[is_there]
    if len(rows) < LIMITS.least_rows:
        return False
    product = variance(rows) * variance(around)
    covariance = dot(rows - mean(rows), around - mean(around)) / len(rows)
    return product > 0.0 and covariance * covariance < LIMITS.significant**2 * product / len(rows)
