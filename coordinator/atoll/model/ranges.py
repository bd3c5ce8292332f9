"""What lies outside of what was measured, where a model is extrapolated."""

import math
from collections.abc import Mapping
from typing import Final

from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig

_PRINTED: Final = 5e-4
"""Largest relative error of an end as `outside_sentence` prints it, with four digits: who copies it is not outside."""


def measured_ranges(result: Result) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value that was measured of states and inputs, by symbol.

    Of the rows that were searched, and of those that were not. Angles have none: they come round again.
    """
    data = DataConfig.model_validate(result.data_settings)
    angles = {result.symbols.get(angle.column, angle.column) for angle in data.angles}
    ranges = dict(result.ranges)
    for part in result.recorded:
        for column, curve in {**part.measured, **part.inputs}.items():
            name, known = result.symbols.get(column, column), [value for value in curve if value is not None]
            if known:
                low, high = ranges.get(name, (math.inf, -math.inf))
                ranges[name] = min(low, *known), max(high, *known)
    return {name: ends for name, ends in ranges.items() if name not in angles}


def names_outside(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Return the names of values that lie outside of their range; those without a range are in none."""
    outside = []
    for name, value in values.items():
        low, high = ranges.get(name, (value, value))
        if not low - _PRINTED * abs(low) <= value <= high + _PRINTED * abs(high):
            outside.append(name)
    return tuple(outside)


def outside_sentence(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> str:
    """Return that an initial state lies outside of the measured ranges, and what follows; "" where it does not."""
    names = names_outside(values, ranges)
    if not names:
        return ""
    each = [f"{name} = {values[name]:.4g} (measured: {ranges[name][0]:.4g} to {ranges[name][1]:.4g})" for name in names]
    return f"the initial state is outside of the measured range: {', '.join(each)}; the model is extrapolated there"
