"""Nullclines of a system of two states: polylines on which one of the rates is 0.

They are followed from cell to cell of a grid (marching squares). Crossings of grid lines are refined by bisection. If
the rate grows during the bisection, it has a pole at this point; a pole is not a crossing.
"""

from typing import Final

import numpy as np

from atoll.analysis.flow import Box, Flow
from atoll_core.data.dataset import FloatArray

GRID: Final = 80
"""Number of cells in each direction."""

_BISECTIONS: Final = 30
"""Number of bisections: they locate a crossing to 1e-9 of a cell."""

_MARGIN: Final = 1e-6
"""The grid is larger than the box by this share of its widths, to include nullclines along the sides of the box."""

_Edge = tuple[int, int, int]
"""A side of a cell: its direction (0 for the first state, 1 for the second), and the indices of its lower corner."""


def nullclines(flow: Flow, box: Box, cells: int = GRID) -> tuple[tuple[FloatArray, ...], ...]:
    """Return for each of the two states of `flow` the polylines (n, 2) in `box` on which its rate is 0."""
    beyond = _MARGIN * box.widths
    lower, upper = box.lower - beyond, box.upper + beyond
    axes = [np.linspace(lower[axis], upper[axis], cells + 1) for axis in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    rates = flow.rates(grid.reshape(-1, 2)).reshape(cells + 1, cells + 1, 2)
    return tuple(_polylines(flow, grid, rates[..., state], state) for state in range(2))


def _polylines(flow: Flow, grid: FloatArray, rates: FloatArray, state: int) -> tuple[FloatArray, ...]:
    """Return polylines (n, 2) that join the crossings of the sides of cells; an open polyline begins at one end."""
    crossings = _crossings(flow, grid, rates, state)
    neighbours: dict[_Edge, list[_Edge]] = {edge: [] for edge in crossings}
    for row, column in np.ndindex(len(grid) - 1, len(grid) - 1):
        sides = [(0, row, column), (1, row + 1, column), (0, row, column + 1), (1, row, column)]
        met = [edge for edge in sides if edge in crossings]
        for first, second in zip(met[::2], met[1::2], strict=False):
            neighbours[first].append(second)
            neighbours[second].append(first)
    polylines, visited = [], set()
    for start in sorted(neighbours, key=lambda edge: (len(neighbours[edge]) != 1, edge)):
        if start in visited:
            continue
        chain, current = [start], start
        visited.add(start)
        while (after := next((edge for edge in neighbours[current] if edge not in visited), None)) is not None:
            chain.append(after)
            visited.add(after)
            current = after
        if len(chain) > 2 and start in neighbours[current]:
            chain.append(start)
        if len(chain) > 1:
            polylines.append(np.array([crossings[edge] for edge in chain]))
    return tuple(polylines)


def _crossings(flow: Flow, grid: FloatArray, rates: FloatArray, state: int) -> dict[_Edge, FloatArray]:
    """Return the points at which the rate changes its sign along the sides of cells."""
    crossings: dict[_Edge, FloatArray] = {}
    for axis in range(2):
        lower, upper = (slice(None, -1), slice(None)), (slice(1, None), slice(None))
        first, second = (lower, upper) if axis == 0 else (lower[::-1], upper[::-1])
        # a rate of exactly 0 counts as positive, so that a line through corners of the grid crosses once
        is_crossed = (rates[first] >= 0.0) != (rates[second] >= 0.0)
        rows, columns = np.nonzero(is_crossed & np.isfinite(rates[first]) & np.isfinite(rates[second]))
        low, high = rates[first][rows, columns], rates[second][rows, columns]
        below, above = grid[first][rows, columns], grid[second][rows, columns]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (below + above)
            is_below = (flow.rates(middle)[:, state] >= 0.0) == (low >= 0.0)
            below[is_below], above[~is_below] = middle[is_below], middle[~is_below]
        points = 0.5 * (below + above)
        is_root = np.abs(flow.rates(points)[:, state]) <= np.maximum(np.abs(low), np.abs(high))
        sides = zip(rows.tolist(), columns.tolist(), points, is_root.tolist(), strict=True)
        crossings |= {(axis, row, column): point for row, column, point, root in sides if root}
    return crossings
