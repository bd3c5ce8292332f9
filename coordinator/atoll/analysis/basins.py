"""Basins of attraction: the attractors that simulations from the box reach.

Initial states are the cells of a grid (two states) or random points of the box. All are integrated together. A
simulation ends when its state is near a stable attractor, diverges, or meets an undefined rate. States that are nearly
at rest at the end are integrated for longer, because they may move slowly towards an attractor.

Doubtful: a state that only passes near an attractor counts as having reached it. Basins thinner than the grid are not
resolved. Letters: N initial states, D states.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.fixed_points import NON_HYPERBOLIC, FixedPoint, FixedSet, time_scale
from atoll.analysis.flow import EXTENSIONS, SETTLING, UNBOUNDED, Box, Flow, IntegrationBatch, is_nearly_at_rest
from atoll.analysis.limit_cycles import LimitCycle
from atoll_core.data.dataset import FloatArray

GRID: Final = 40
"""Number of cells in each direction for a system of two states."""

STARTS: Final = 1000
"""Number of random initial states of other systems: the standard error of a fraction is below 1.6 percentage points."""

_MOST_STEPS: Final = 4000
"""Largest number of steps of one simulation. With a tolerance of 1e-5 most simulations take some hundred steps, and
stiff ones ten times as many."""

UNDECIDED: Final = -1
RUNS_AWAY: Final = -2
NO_VALUE: Final = -3

_PARTS: Final = 60
"""Number of tests whether the states have reached an attractor: one test in each time needed to cross the box."""

_CAPTURE_RADIUS: Final = 1e-2
"""Distance, in widths of the box, at which an attractor counts as reached, but at most a tenth of the distance to the
next attractor."""

Attractor = FixedPoint | FixedSet | LimitCycle


@dataclass(frozen=True, eq=False)
class Basins:
    """The attractors that simulations from the initial states `starts` (N, D) reached.

    `reached` (N,) has the index of an attractor, or a code: `UNDECIDED` (no attractor within `duration`), `RUNS_AWAY`,
    or `NO_VALUE` (a rate became undefined). In a `grid` of (n, n) initial states, the first state varies slowest.
    """

    attractors: tuple[Attractor, ...]
    starts: FloatArray = field(repr=False)
    reached: npt.NDArray[np.int64] = field(repr=False)
    duration: float
    grid: int | None

    def fraction(self, which: int) -> tuple[float, float]:
        """Return the share of initial states that reached an attractor (or code), and its binomial standard error."""
        share = float(np.mean(self.reached == which))
        return share, float(np.sqrt(share * (1.0 - share) / len(self.reached)))


def basins(flow: Flow, box: Box, attractors: Sequence[Attractor], *, grid: int = GRID) -> Basins:
    """Return the stable `attractors` that initial states in `box` reach.

    For two states, the initial states are the middles of the cells of a grid. Otherwise they are drawn uniformly.
    """
    if flow.size == 2:
        axes = [low + width * (np.arange(grid) + 0.5) / grid for low, width in zip(box.lower, box.widths, strict=True)]
        starts = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    else:
        starts = box.lower + box.widths * np.random.default_rng(0).random((STARTS, flow.size))
    duration = SETTLING * time_scale(flow, box)
    reached, _ = destinations(flow, box, attractors, starts, duration)
    return Basins(tuple(attractors), starts, reached, duration, grid if flow.size == 2 else None)


def destinations(
    flow: Flow, box: Box, attractors: Sequence[Attractor], starts: FloatArray, duration: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return the attractors (N,) that are reached from `starts` (N, D) within `duration`, and the last states (N, D).

    Attractors are indices or codes, as in `Basins`. States that are nearly at rest after `duration` are simulated for
    longer.
    """
    reached, ends = np.full(len(starts), UNDECIDED, dtype=np.int64), np.array(starts)
    radii = _radii(attractors, box)
    batch = IntegrationBatch.of(starts, 1e-4 * duration)
    rows, before, is_last_part = np.arange(len(starts)), batch.states, False
    for until in [duration * part / _PARTS for part in range(1, _PARTS + 1)] + [duration * more for more in EXTENSIONS]:
        if is_last_part:
            is_slow = is_nearly_at_rest(batch.states, before, box, SETTLING / _PARTS)
            batch, rows = batch.of_rows(is_slow), rows[is_slow]
        is_last_part = until == duration
        before = batch.states.copy()
        batch.settle(flow, box, until, rtol=1e-5, most_steps=_MOST_STEPS // _PARTS)
        destination = np.full(len(rows), UNDECIDED, dtype=np.int64)
        with np.errstate(invalid="ignore"):
            destination[box.excursions(batch.states) > UNBOUNDED] = RUNS_AWAY
        for index, (attractor, radius) in enumerate(zip(attractors, radii, strict=True)):
            destination[(destination == UNDECIDED) & _is_reached(attractor, radius, flow, batch.states, box)] = index
        destination[(destination == UNDECIDED) & batch.is_lost] = NO_VALUE
        reached[rows], ends[rows] = destination, batch.states
        rows, before = rows[destination == UNDECIDED], before[destination == UNDECIDED]
        if not len(rows):
            break
        batch = batch.of_rows(destination == UNDECIDED)
    return reached, ends


def _is_reached(attractor: Attractor, radius: float, flow: Flow, states: FloatArray, box: Box) -> np.ndarray:
    """Tell which of the `states` (N, D) are within `radius` of an attractor, or of an attracting part of a set."""
    if not isinstance(attractor, FixedSet):
        return np.asarray(attractor.distances(states, box) < radius)
    is_reached = attractor.distances(flow, states, box) < radius
    is_reached[is_reached] = attractor.attracts_at(flow, states[is_reached], box)
    return is_reached


def _radii(attractors: Sequence[Attractor], box: Box) -> list[float]:
    """Return the distance at which each attractor counts as reached; it is larger if the approach is slow."""
    radii = []
    for attractor in attractors:
        members = attractor.points if isinstance(attractor, FixedSet) else (attractor,)
        is_slow = any(
            isinstance(point, FixedPoint) and point.attracts_in_box and point.kind == NON_HYPERBOLIC
            for point in members
        )
        gaps = [np.inf]
        for other in attractors:
            if other is attractor:
                continue
            if isinstance(attractor, FixedSet):
                away = (attractor.outline[:, None] - other.outline) / box.widths
                gaps.append(float(np.sqrt((away**2).sum(axis=2).min())))
            else:
                gaps.append(float(attractor.distances(other.outline, box).min()))
        radii.append(min(5.0 * _CAPTURE_RADIUS if is_slow else _CAPTURE_RADIUS, 0.1 * min(gaps)))
    return radii
