"""What kind of fixed point a point is, by the eigenvalues of its Jacobian, and whether it attracts.

An eigenvalue counts as 0 only beside its own uncertainty: what rounding makes of the Jacobian and of the point, carried
to first order by its left and right eigenvectors (Golub and Van Loan 2013, section 7.2). Where that does not decide,
simulations from beside the point do. Letters: D states.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.box import Box
from atoll.analysis.flow import UNBOUNDED, Flow, IntegrationBatch, crossing, steps
from atoll.analysis.newton import (
    EXACT,
    jacobian_in_widths,
    rate_scale,
    scaled_jacobian,
    singular_directions,
    time_scale,
)
from atoll_core.data.dataset import FloatArray

Complexes = npt.NDArray[np.complex128]

NON_HYPERBOLIC: Final = "non-hyperbolic"

_AMPLITUDES: Final = (0.02, 0.1, 0.3)
"""Of orbits around a centre, in widths of the box."""

_CLOSED: Final = 1e-6
"""Share of its distance by which an orbit around a centre may miss itself: a hundred times the error of a turn."""

_ROUNDING: Final = 10.0 * float(np.finfo(np.float64).eps)
"""Share of itself by which an entry of a Jacobian errs: sums and products of a few terms."""

_SHIFTS: Final = 10.0 ** np.arange(-12.0, -1.0)
"""Widths by which a point is moved to see how far rounding leaves its place open."""

_BESIDE: Final = 0.05
"""Widths from a point within which courses begin that tell whether it attracts."""

_STARTS: Final = 16
_MOST_STEPS: Final = 3000
"""Of such a course."""

_DURATIONS: Final = (20.0, 200.0, 2e3, 2e4, 1e6, 1e9)
"""Lengths of such courses, in times that a state takes through the box: along an eigenvalue of 0 points are approached
by a power of time. Steps get longer on the way, but not where courses go round."""


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A point (D,) with dx/dt = 0, the `eigenvalues` (D,) of the Jacobian there by falling real part, and its `kind`.

    It `is_stable` where it attracts from all sides: by its eigenvalues, or where one of these is 0 by simulations from
    beside it. One that `attracts_in_box` does so from the part of the box beside it, which is all that counts of states
    that are never below 0.
    """

    point: FloatArray
    eigenvalues: Complexes
    kind: str
    is_stable: bool
    attracts_in_box: bool


@np.errstate(all="ignore")
def classified(flow: Flow, point: FloatArray, box: Box, along: FloatArray | None = None) -> FixedPoint:
    """Return a fixed point with its eigenvalues and kind.

    Of one on a curve or surface of fixed points, whose directions `along` it are (k, D) in widths, k eigenvalues are 0;
    its kind and whether it attracts are by the others.
    """
    matrix, along = jacobian_in_widths(flow, point, box), np.zeros((0, flow.size)) if along is None else along
    if not np.isfinite(matrix).all():
        return FixedPoint(point, np.full(flow.size, np.nan + 0j), "not differentiable", False, False)
    eigenvalues, uncertainties = _eigenvalues(flow, point, box, matrix, along)
    across = np.sort(np.argsort(np.abs(eigenvalues), kind="stable")[len(along) :])
    kind = kind_of(eigenvalues[across], uncertainties[across])
    if kind == "centre" and (len(along) or not _is_centre(flow, point, eigenvalues, box)):
        kind = NON_HYPERBOLIC
    is_stable = attracts_in_box = kind in ("stable node", "stable focus")
    if kind == NON_HYPERBOLIC and len(across) and (eigenvalues.real[across] <= uncertainties[across]).all():
        attracts_in_box, is_stable = _attracts(flow, point, box, along)
    return FixedPoint(point, eigenvalues, kind, is_stable, attracts_in_box)


def kind_of(eigenvalues: Complexes, uncertainties: FloatArray | float = 0.0) -> str:
    """Return the kind of a fixed point by the eigenvalues (D,) of its Jacobian and the uncertainty of each.

    "stable" or "unstable" with "node" or "focus"; "saddle"; "saddle-focus", a saddle with a complex pair; "centre", an
    imaginary pair in two dimensions, as the linear part has it; "non-hyperbolic" otherwise.
    """
    real, has_pair = eigenvalues.real, bool((np.abs(eigenvalues.imag) > uncertainties).any())
    if not len(real) or (np.abs(real) <= uncertainties).any():
        is_pair = len(eigenvalues) == 2 and has_pair
        return "centre" if is_pair else NON_HYPERBOLIC
    if (real < 0.0).any() and (real > 0.0).any():
        return "saddle-focus" if has_pair else "saddle"
    return ("stable " if real[0] < 0.0 else "unstable ") + ("focus" if has_pair else "node")


def _eigenvalues(
    flow: Flow, point: FloatArray, box: Box, matrix: FloatArray, along: FloatArray
) -> tuple[Complexes, FloatArray]:
    """Return the eigenvalues (D,) of the Jacobian `matrix` by falling real part, and the uncertainty of each (D,).

    To first order an error E of the matrix changes an eigenvalue by y^H E x / y^H x, by its eigenvectors x and y. Of
    eigenvectors that coincide that has no end; an eigenvalue changes by about |A| (|E|/|A|)^(1/D) at most. What is not
    told from 0 is 0, and so are as many eigenvalues as there are directions `along` a curve or surface.
    """
    from scipy.linalg import eig

    values, left, right = eig(matrix, left=True, right=True)
    values = values.astype(np.complex128)
    conditions = np.maximum(np.abs((left.conj() * right).sum(axis=0)), 1e-300)
    errors = [_rounding(flow, point, box, matrix), *_changes(flow, point, box, matrix, along)]
    by_errors = [np.einsum("ij,ik,kj->j", np.abs(left), error, np.abs(right)) for error in errors]
    size = float(np.linalg.norm(matrix))
    by_errors.append(np.full(len(values), _ROUNDING * size))  # the backward error of the algorithm
    total = _ROUNDING * size + float(np.linalg.norm(np.sum(errors, axis=0)))
    most = size * (total / size) ** (1.0 / len(values)) if size > 0.0 else total
    uncertainties = np.minimum(np.sum(by_errors, axis=0) / conditions, most)
    values.real[np.abs(values.real) <= uncertainties] = 0.0
    values.imag[np.abs(values.imag) <= uncertainties] = 0.0
    values[np.argsort(np.abs(values), kind="stable")[: len(along)]] = 0.0
    rounded = [float(f"{value:.12g}") for value in values.real.tolist()]  # of a pair both real parts are to be one
    falling = np.lexsort((values.imag, -np.array(rounded)))
    return values[falling] + 0.0, uncertainties[falling]


def _rounding(flow: Flow, point: FloatArray, box: Box, matrix: FloatArray) -> FloatArray:
    """Return by how much entries of the Jacobian (D, D) err by rounding: their own, and that of the point."""
    shifts = _ROUNDING * np.diag(np.maximum(np.abs(point), box.widths))
    changes = np.abs(jacobian_in_widths(flow, point + np.vstack([shifts, -shifts]), box) - matrix).max(axis=0)
    return np.asarray(_ROUNDING * np.abs(matrix) + np.where(np.isfinite(changes), changes, 0.0))


def _changes(flow: Flow, point: FloatArray, box: Box, matrix: FloatArray, along: FloatArray) -> Iterator[FloatArray]:
    """Yield by how much the Jacobian (D, D) changes between the places that rounding does not tell from the point.

    They are, in each direction, those where rates are below `EXACT` of typical ones, or no larger than at the point;
    directions `along` a curve of fixed points do not count.
    """
    scale = rate_scale(flow, box)
    directions = np.linalg.svd(scaled_jacobian(flow, point[None], box, scale)[0])[2]
    limit = max(EXACT, 2.0 * float(np.abs(flow.rates(point) / scale).max()))
    for direction in directions - directions @ along.T @ along:
        moved = point + _SHIFTS[:, None, None] * np.array([[1.0], [-1.0]]) * direction * box.widths
        sizes = np.abs(flow.rates(moved.reshape(-1, flow.size)) / scale).max(axis=1).reshape(-1, 2).max(axis=1)
        open_places = int(np.logical_and.accumulate(sizes <= limit).sum())
        if open_places:
            change = np.abs(jacobian_in_widths(flow, moved[open_places - 1], box) - matrix).max(axis=0)
            yield np.where(np.isfinite(change), change, 0.0)


def _attracts(flow: Flow, point: FloatArray, box: Box, along: FloatArray) -> tuple[bool, bool]:
    """Tell whether courses from beside `point` within the `box` come nearer to it and stay, and whether all do.

    They begin all around it, and on both sides of it in the directions in which rates hardly change, where it may
    attract from one side alone. By directions `along` a curve or surface through the point, only how far from that they
    are counts.
    """
    beside = Box(point - _BESIDE * box.widths, point + _BESIDE * box.widths)
    slow = _BESIDE * singular_directions(flow, point[None], box)[0] * box.widths
    starts = np.vstack([beside.points(_STARTS), point + slow, point - slow])
    within = np.clip(starts, box.lower, box.upper)
    batch = IntegrationBatch.of(np.vstack([within, starts]), 1e-3 * time_scale(flow, box))
    first = _distances(batch.states, point, box, along)
    most, sizes = _MOST_STEPS // len(_DURATIONS), 1e-3 * box.widths
    for duration in _DURATIONS:
        until = duration * time_scale(flow, box)
        batch.advance(flow.rates, until, sizes, rtol=1e-5, most_steps=most, jacobian=flow.jacobian)
        batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
        if batch.is_lost[: len(within)].any():
            return False, False
    last = _distances(batch.states, point, box, along)
    is_nearer = ~batch.is_lost & (last < 0.5 * first.max())
    return bool(is_nearer[: len(within)].all()), bool(is_nearer.all())


def _distances(states: FloatArray, point: FloatArray, box: Box, along: FloatArray) -> FloatArray:
    """Return how far states (N, D) are from a point (N,), in widths, or from the surface `along` which it lies."""
    away = (states - point) / box.widths
    return np.asarray(np.abs(away - away @ along.T @ along).max(axis=1))


def _is_centre(flow: Flow, point: FloatArray, eigenvalues: Complexes, box: Box) -> bool:
    """Tell whether orbits beside `point` close: the nearest comes round, and each that does is where it began.

    Several are looked at, since a damping that grows with the amplitude is not seen near the point.
    """
    turns = [_turn(flow, point, share * box.widths[0], eigenvalues, box) for share in _AMPLITUDES]
    return turns[0] is not None and all(turn is None or abs(turn - 1.0) < _CLOSED for turn in turns)


def _turn(flow: Flow, point: FloatArray, radius: float, eigenvalues: Complexes, box: Box) -> float | None:
    """Return the distance from `point` on its first side after a turn, over the `radius` before; None: it has none."""
    period = 2.0 * np.pi / float(np.abs(eigenvalues.imag).max())
    start = point + np.array([radius, 0.0])

    def height(x: FloatArray) -> float:
        return float((x - point)[1])

    for step in steps(flow.rates, start, 3.0 * period, box.widths):
        before, after = step.start - point, step.end - point
        if before[1] * after[1] <= 0.0 < after[0] and step.after > 0.5 * period:
            return float((step.at(crossing(step, height)) - point)[0] / radius)
    return None
