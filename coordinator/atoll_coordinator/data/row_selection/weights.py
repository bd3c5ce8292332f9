"""Weights of rows, as a column gives them: inverse variances of the measurement errors, up to a factor. Pure.

Rows without weight are left out as if they had not been measured; the others count in proportion.
"""

import math
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import DataError
from atoll_coordinator.data.reading.checks import MIN_ROWS

SMALLEST: Final = 1e-6
"""Rows of a smaller weight, over the largest, tell nothing beside the others."""
FAR_OUT: Final = 25.0
"""Targets whose weight is less than the median one over this have more than five times the error: they are left out of
the search, which counts all rows alike (ADR 0027)."""
LEAST_KEPT: Final = 0.8
"""Share of the rows that is kept whatever their weight."""


def weighty_rows(table: Table, name: str | None) -> tuple[list[int], str | None]:
    """Return the rows that have weight, all of them without a column, and a sentence when others are left out.

    Raises:
        DataError: a weight is negative or no number, or hardly any row has one.
    """
    if name is None:
        return [*range(table.rows)], None
    weights = table.column(name)
    bad = [int(row) for row in np.flatnonzero(~(np.isfinite(weights) & (weights >= 0.0)))]
    if bad:
        value = float(weights[bad[0]])
        found = "an empty cell or NaN" if math.isnan(value) else f"{value:g}"
        raise DataError(
            f"the weights '{name}' hold {found} in {table.places(bad)}; a weight is a number from 0 (a row that is not "
            "used) up, such as 1/variance"
        )
    least = SMALLEST * float(np.max(weights, initial=0.0))
    rows = [int(row) for row in np.flatnonzero(weights > least)]
    if len(rows) < MIN_ROWS:
        raise DataError(
            f"only {len(rows)} rows of {table.files[0]} have a weight above zero in '{name}'; at least {MIN_ROWS} are "
            "needed"
        )
    count = table.rows - len(rows)
    return rows, f"{count} of {table.rows} rows have no weight and are left out." if count else None


def relative_weights(weights: FloatArray) -> FloatArray | None:
    """Return positive weights over their mean; None when all are equal, to 12 digits."""
    from atoll_coordinator.data.differentiation.kernels.stencils import (
        moments,  # not for whoever only looks at tables without weights
    )

    scaled = weights / float(np.max(weights))
    mean, deviation = moments(scaled)
    return None if deviation <= 1e-12 * mean else np.ascontiguousarray(scaled / mean)


def weighty_enough(weights: FloatArray, rows: list[int]) -> list[int]:
    """Return those of `rows` whose weight is not far below the median one, most of them in any case."""
    ordered = np.sort(weights[rows]).tolist()
    limit = min(ordered[len(rows) // 2] / FAR_OUT, ordered[len(rows) - max(1, math.ceil(LEAST_KEPT * len(rows)))])
    return [row for row in rows if weights[row] >= limit]
