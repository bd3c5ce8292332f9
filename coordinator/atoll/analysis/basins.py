"""Basins of attraction: which attractor simulations from a box reach. Letters: N starts, A attractors."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.fixed_points import NON_HYPERBOLIC, FixedPoint, FixedSet, time_scale
from atoll.analysis.flow import LONGER, SETTLING, UNBOUNDED, Box, Flow, IntegrationBatch, is_nearly_at_rest
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

Attractor = FixedPoint | FixedSet | LimitCycle


@dataclass(frozen=True, eq=False)
class Basins:
    """Which of `attractors` each of `starts` (N, D) reached.

    `reached` (N,) has the index of an attractor, `UNDECIDED` (none of them within `duration`), `RUNS_AWAY` or
    `NO_VALUE` (the course met a point without rates); of a grid of (n, n) starts the first state varies slowest.
    """

    attractors: tuple[Attractor, ...]
    starts: FloatArray = field(repr=False)
    reached: npt.NDArray[np.int64] = field(repr=False)
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
    reached, _ = destinations(flow, box, attractors, starts, duration)
    return Basins(tuple(attractors), starts, reached, duration, grid if flow.size == 2 else None)


def destinations(
    flow: Flow, box: Box, attractors: Sequence[Attractor], starts: FloatArray, duration: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return what each of `starts` (N, D) reaches within `duration`, (N,), see `Basins`, and where it is then, (N, D).

    Those that have nearly come to rest by then are followed for longer.
    """
    reached, ends = np.full(len(starts), UNDECIDED, dtype=np.int64), np.array(starts)
    radii = _radii(attractors, box)
    batch = IntegrationBatch.of(starts, 1e-4 * duration)
    rows, before, is_last_look = np.arange(len(starts)), batch.states, False
    for until in _looks(duration):
        if is_last_look:
            is_slow = is_nearly_at_rest(batch.states, before, box, SETTLING / _PARTS)
            batch, rows = batch.of_rows(is_slow), rows[is_slow]
        is_last_look = until == duration
        before = batch.states.copy()
        batch.advance(
            flow.rates,
            until,
            1e-3 * box.widths,
            rtol=1e-5,
            most_steps=MOST_STEPS // _PARTS,
            jacobian=flow.jacobian,
        )
        destination = np.full(len(rows), UNDECIDED, dtype=np.int64)
        with np.errstate(invalid="ignore"):
            destination[box.excursions(batch.states) > UNBOUNDED] = RUNS_AWAY
        for index, (attractor, radius) in enumerate(zip(attractors, radii, strict=True)):
            destination[(destination == UNDECIDED) & _is_caught(attractor, radius, flow, batch.states, box)] = index
        destination[(destination == UNDECIDED) & batch.is_lost] = NO_VALUE
        reached[rows], ends[rows] = destination, batch.states
        rows, before = rows[destination == UNDECIDED], before[destination == UNDECIDED]
        if not len(rows):
            break
        batch = batch.of_rows(destination == UNDECIDED)
    return reached, ends


def _looks(duration: float) -> list[float]:
    """Return the times at which it is looked where starts are."""
    return [*(duration * part / _PARTS for part in range(1, _PARTS + 1)), *(duration * longer for longer in LONGER)]


def _is_caught(attractor: Attractor, radius: float, flow: Flow, states: FloatArray, box: Box) -> np.ndarray:
    """Tell which of `states` (N, D) are within `radius` of an attractor, or of an attracting part."""
    if not isinstance(attractor, FixedSet):
        return _distances(attractor, states, box) < radius
    is_caught = attractor.distances(flow, states, box) < radius
    is_caught[is_caught] = attractor.attracts_at(flow, states[is_caught], box)
    return is_caught


def _distances(attractor: FixedPoint | LimitCycle, states: FloatArray, box: Box) -> FloatArray:
    if isinstance(attractor, LimitCycle):
        return distance(attractor, states, box)
    return np.asarray(np.sqrt((((states - attractor.point) / box.widths) ** 2).sum(axis=1)))


def _radii(attractors: Sequence[Attractor], box: Box) -> list[float]:
    """Return how near to each attractor a course counts as caught: a tenth of the way to the next one at most."""
    points = [_points(attractor) for attractor in attractors]
    radii = []
    for index, attractor in enumerate(attractors):
        others = [points[place] for place in range(len(points)) if place != index]
        ways = [
            _squares(points[index], other, box).min() if isinstance(attractor, FixedSet)
            else float(_distances(attractor, other, box).min()) ** 2
            for other in others
        ]  # fmt: skip
        kinds = [point.kind for point in _fixed_points(attractor) if point.attracts_in_box]
        slow = NON_HYPERBOLIC in kinds
        radii.append(min(5.0 * _CAUGHT if slow else _CAUGHT, 0.1 * float(np.sqrt(min(ways, default=np.inf)))))
    return radii


def _fixed_points(attractor: Attractor) -> Sequence[FixedPoint]:
    """Return fixed points of an attractor; a limit cycle has none."""
    if isinstance(attractor, FixedSet):
        return attractor.points
    return (attractor,) if isinstance(attractor, FixedPoint) else ()


def _points(attractor: Attractor) -> FloatArray:
    """Return points (n, D) of an attractor."""
    if isinstance(attractor, FixedSet):
        return attractor.course
    return np.atleast_2d(attractor.points if isinstance(attractor, LimitCycle) else attractor.point)


def _squares(first: FloatArray, second: FloatArray, box: Box) -> FloatArray:
    """Return the squared distances (n, m) between two sets of points, in widths."""
    return np.asarray((((first[:, None] - second) / box.widths) ** 2).sum(axis=2))
