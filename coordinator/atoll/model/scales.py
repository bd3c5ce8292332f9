"""How large the states of a model are: what "small" means for each of them, whatever its unit.

The one place that says so is the result: the ranges that were measured. Integrators, root finders and comparisons take
the size of each state from here, or from the box of an analysis, which is laid about these ranges.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any


def measured_ranges(found: Mapping[str, Any], states: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value of each of `states` (symbols) that was measured, of a result."""
    symbols = found.get("symbols") or {}
    ranges = ((found.get("system") or {}).get("ranges") or {}).items()
    named = {symbols.get(name, name): tuple(its or ()) for name, its in ranges}
    return {
        name: (float(its[0]), float(its[1]))
        for name, its in named.items()
        if name in states and len(its) == 2 and all(end is not None and math.isfinite(end) for end in its)
    }


def measured_sizes(found: Mapping[str, Any], states: Sequence[str]) -> tuple[float, ...]:
    """Return the largest absolute value of each of `states` that was measured; 0 where none but 0 was, or none."""
    ranges = measured_ranges(found, states)
    return tuple(max(map(abs, ranges.get(name, (0.0, 0.0)))) for name in states)
