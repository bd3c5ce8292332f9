"""Basins of attraction: which attractor simulations from a box reach. Letters: N starts, A attractors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.box import Box
from atoll.analysis.fixed_points import FixedPoint, time_scale
from atoll.analysis.flow import SETTLING, UNBOUNDED, Flow, IntegrationBatch
from atoll.analysis.limit_cycles import LimitCycle, distance
from atoll_core.data.dataset import FloatArray

GRID: Final = 40
"""Cells along each state of a system of two."""

STARTS: Final = 1000
"""Seeded random starts of a system of other sizes; a fraction is then known to 1.6 percentage points."""

MOST_STEPS: Final = 4000
"""Of one simulation: with a tolerance of 1e-5 courses take some hundred, stiff ones ten times as many."""

UNDECIDED: Final = -1
RUNS_AWAY: Final = -2
NO_VALUE: Final = -3

_PARTS: Final = 60
"""Looks at where courses are: one in each time that a state takes through the box."""

_CAUGHT: Final = 1e-2
"""Widths of the box within which an attractor has caught a course; beside others a tenth of the way to the next one."""

Attractor = FixedPoint | LimitCycle


@dataclass(frozen=True, eq=False)
class Basins:
    """Which of `attractors` each of `starts` (N, D) reached.

    `reached` (N,) has the index of an attractor, `UNDECIDED` (none of them within `duration`), `RUNS_AWAY` or
    `NO_VALUE` (the course met a point without rates); of a grid of (n, n) starts the first state varies slowest.
    """

    attractors: tuple[Attractor, ...]
    starts: FloatArray
    reached: npt.NDArray[np.int64]
    duration: float
    grid: int | None

    def fraction(self, which: int) -> tuple[float, float]:
        """Return the share of starts that reached an attractor (or code), and its binomial standard error."""
        share = float(np.mean(self.reached == which))
        return share, float(np.sqrt(share * (1.0 - share) / len(self.reached)))


def basins(flow: Flow, box: Box, attractors: Sequence[Attractor], *, grid: int = GRID) -> Basins:
    """Return which of the stable `attractors` starts in `box` reach: the middles of a grid's cells in two dimensions.

    Elsewhere starts are drawn uniformly.
    """
    if flow.size == 2:
        axes = [low + width * (np.arange(grid) + 0.5) / grid for low, width in zip(box.lower, box.widths, strict=True)]
        starts = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    else:
        starts = box.lower + box.widths * np.random.default_rng(0).random((STARTS, flow.size))
    duration = SETTLING * time_scale(flow, box)
    reached = destinations(flow, box, attractors, starts, duration)
    return Basins(tuple(attractors), starts, reached, duration, grid if flow.size == 2 else None)


def destinations(
    flow: Flow, box: Box, attractors: Sequence[Attractor], starts: FloatArray, duration: float
) -> npt.NDArray[np.int64]:
    """Return what each of `starts` (N, D) reaches within `duration`, (N,), see `Basins`."""
    reached = np.full(len(starts), UNDECIDED, dtype=np.int64)
    radii = _radii(attractors, box)
    batch = IntegrationBatch.of(starts, 1e-4 * duration)
    rows = np.arange(len(starts))
    for part in range(1, _PARTS + 1):
        batch.advance(
            flow.rates, duration * part / _PARTS, 1e-3 * box.widths, rtol=1e-5, most_steps=MOST_STEPS // _PARTS
        )
        destination = np.full(len(rows), UNDECIDED, dtype=np.int64)
        with np.errstate(invalid="ignore"):
            destination[box.excursions(batch.states) > UNBOUNDED] = RUNS_AWAY
        for index, (attractor, radius) in enumerate(zip(attractors, radii, strict=True)):
            destination[(destination == UNDECIDED) & (_distances(attractor, batch.states, box) < radius)] = index
        destination[(destination == UNDECIDED) & batch.is_lost] = NO_VALUE
        reached[rows] = destination
        rows = rows[destination == UNDECIDED]
        if not len(rows):
            break
        batch = batch.of_rows(destination == UNDECIDED)
    return reached


def _distances(attractor: Attractor, states: FloatArray, box: Box) -> FloatArray:
    if isinstance(attractor, LimitCycle):
        return distance(attractor, states, box)
    return np.asarray(np.sqrt((((states - attractor.point) / box.widths) ** 2).sum(axis=1)))


def _radii(attractors: Sequence[Attractor], box: Box) -> list[float]:
    """Return how near to each attractor a course counts as caught: a tenth of the way to the next one at most."""
    points = [
        np.atleast_2d(attractor.points if isinstance(attractor, LimitCycle) else attractor.point)
        for attractor in attractors
    ]
    radii = []
    for index, attractor in enumerate(attractors):
        others = [points[place] for place in range(len(points)) if place != index]
        nearest = min((float(_distances(attractor, other, box).min()) for other in others), default=np.inf)
        slow = isinstance(attractor, FixedPoint) and attractor.kind == "non-hyperbolic"
        radii.append(min(5.0 * _CAUGHT if slow else _CAUGHT, 0.1 * nearest))
    return radii
