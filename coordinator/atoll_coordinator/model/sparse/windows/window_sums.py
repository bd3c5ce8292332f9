"""Sums of terms fitted to windows with errors in all variables, and the shortest of them.

The misfit is half the square of what is left in each window over its variance, which depends on the sum: by errors of
the side and of the terms, to first order, and by the difference of two quadratures. Large ones count less (Cauchy).
Each window counts by its share in a new one.

Letters: K terms of a library, M terms of a sum, W windows.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.sparse import elimination
from atoll_coordinator.model.sparse.elimination import on_the_way, shortest, without_one
from atoll_coordinator.model.sparse.kernels.errors_in_variables import fit_errors_in_variables, measure
from atoll_coordinator.model.sparse.kernels.robust import NORMAL_DEVIATION, robust_fit
from atoll_coordinator.model.sparse.shapes import Atom, program_of
from atoll_coordinator.model.sparse.windows.terms import Terms, covariances, gradient
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.program import Program

_SETTLED = 1e-1
"""Numerics: nats below which a step of a fit gains nothing."""


@dataclass(frozen=True, eq=False)
class WindowSum:
    """A fitted sum of the terms `kept` (M,) of a library, with its `coefficients` (M,) and `nats`.

    `scaled` (W,) is what it leaves in standard errors, `normal` (M, M) the matrix of its normal equations, `quadrature`
    (W,) the variances by which it was fitted beside those of errors of the variables.
    """

    terms: Terms
    kept: tuple[int, ...]
    coefficients: FloatArray
    scaled: FloatArray
    normal: FloatArray
    quadrature: FloatArray
    nats: float

    @property
    def excess(self) -> float:
        """How many times as large as its standard error what is left is, by the median.

        What a fit takes away by its coefficients is added as for a variance over its degrees of freedom (Rousseeuw &
        Leroy 1987, section 5.1, without what they add for other estimators).
        """
        independent = self.terms.rows.independent
        fitted_away = math.sqrt(independent / max(independent - len(self.kept), 1.0))
        return float(fitted_away * NORMAL_DEVIATION * np.sort(np.abs(self.scaled))[len(self.scaled) // 2])

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """The terms without their coefficients."""
        return tuple(self.terms.atoms[place] for place in self.kept)

    def program(self) -> Program:
        """Return the sum as an expression."""
        return program_of(self.atoms, self.coefficients)


def fitted(terms: Terms, kept: Sequence[int], near: WindowSum | None = None, rounds: int = 0) -> WindowSum | None:
    """Return the fitted sum of the terms `kept`; None where one has no finite value.

    With `near`, a sum of the same library, it is fitted from there by so many rounds, 0: until it has settled.
    """
    if not terms.is_finite or 2 * len(kept) > len(terms.rows.first):
        return None
    places = np.array(kept, np.int64)
    if near is None:
        coefficients = _by_least_squares(terms, places)
        turns = SETTINGS.windows.turns
    else:
        at = dict(zip(near.kept, near.coefficients.tolist(), strict=True))
        coefficients = np.array([at.get(place, 0.0) for place in kept])
        turns = 1 if rounds else 2
    quadrature = None if near is None or not rounds else near.quadrature
    for _ in range(turns):
        quadrature = _quadrature(terms, places, coefficients) if quadrature is None else quadrature
        window_sum = _moved(terms, places, coefficients, quadrature, rounds or SETTINGS.effort.steps)
        coefficients, quadrature = window_sum.coefficients, None
    return window_sum


def _by_least_squares(terms: Terms, places: Ints) -> FloatArray:
    """Return the coefficients (M,) by which windows are fitted robustly as if terms had no errors."""
    rows = terms.rows
    coefficients, weights = np.zeros(len(places)), np.ones(len(rows.first))
    errors = np.sqrt(rows.own + rows.spread(rows.sides[0] - rows.sides[1]) ** 2)
    robust_fit(
        terms.integrals[0][places], rows.sides[0], np.maximum(errors, 1e-300), SETTINGS.effort.steps, coefficients,
        weights,
    )  # fmt: skip
    return coefficients


def _quadrature(terms: Terms, places: Ints, coefficients: FloatArray) -> FloatArray:
    """Return the variances (W,) of errors of quadrature."""
    rows = terms.rows
    left = rows.sides.copy()
    for place, coefficient in zip(places.tolist(), coefficients.tolist(), strict=True):
        left -= coefficient * terms.integrals[:, place]
    return rows.spread(left[0] - left[1]) ** 2


def _moved(terms: Terms, places: Ints, begun: FloatArray, quadrature: FloatArray, rounds: int) -> WindowSum:
    rows, count = terms.rows, len(places)
    products, cross = terms.errors
    coefficients, scaled, normal = begun.copy(), np.zeros(len(rows.first)), np.zeros((count, count))
    loss = fit_errors_in_variables(
        places, terms.integrals[0], rows.sides[0], products, cross, rows.own + quadrature, rows.typical, rounds,
        _SETTLED / rows.independent, coefficients, scaled, normal,
    )  # fmt: skip
    loss += _unresolved(terms, places, coefficients, quadrature)
    price = math.fsum(terms.price(place) for place in places.tolist())
    return WindowSum(
        terms, tuple(places.tolist()), coefficients, scaled, normal, quadrature, rows.independent * loss + price
    )


def _unresolved(terms: Terms, places: Ints, coefficients: FloatArray, quadrature: FloatArray) -> float:
    """Return the mean of 1/2 ln((q^2 + v)/(s^2 + v)) where q^2 is above s^2.

    q^2 is the error of quadrature of what a window is left with, s^2 that of its side, v the variance by other errors.
    Without it, sums would be best that no quadrature resolves. Windows whose side is not resolved tell no sums apart.
    """
    products, cross = terms.errors
    rows = terms.rows
    moved = products[:, places][:, :, places] @ coefficients + 2.0 * cross[:, places]
    others = np.maximum(rows.own + moved @ coefficients, 1e-300)
    ratios = (quadrature + others) / (rows.spread(rows.sides[0] - rows.sides[1]) ** 2 + others)
    return 0.5 * math.fsum(np.log(np.maximum(ratios, 1.0)).tolist()) / len(others)


def eliminated(window_sum: WindowSum | None) -> WindowSum | None:
    """Return the best sum on the way to a single term, the least significant one going first (Wald's test)."""
    if window_sum is None:
        return None
    way: Iterator[WindowSum] = on_the_way(window_sum, _without_least)
    return shortest(way)


def improved(best: WindowSum) -> WindowSum:
    """Return the end of a search around a sum of a library.

    Single terms are taken in again, those first that promise most, and what the sum can then do without leaves, as long
    as that is shorter by more than the best of so many tries is by chance.
    """
    least_gain = log(max(float(len(best.terms.atoms)), 2.0))
    return elimination.improved(elimination.improved(best, _longer, least_gain), _fewer)


def _longer(window_sum: WindowSum) -> Iterator[WindowSum | None]:
    for place in _promising(window_sum):
        yield eliminated(fitted(window_sum.terms, sorted([*window_sum.kept, place]), window_sum))


def _fewer(window_sum: WindowSum) -> Iterator[WindowSum | None]:
    for kept in without_one(window_sum.kept, SETTINGS.structure.longest_sum):
        yield fitted(window_sum.terms, kept, window_sum)


def _without_least(window_sum: WindowSum) -> WindowSum | None:
    if len(window_sum.kept) < 2:
        return None
    sizes = np.sqrt(np.maximum(np.diag(window_sum.normal), 1e-300))
    covariance = np.linalg.pinv(window_sum.normal / np.outer(sizes, sizes), hermitian=True)
    variances = np.maximum(np.diag(covariance), 1e-300)
    scaled = window_sum.coefficients * sizes
    least = int(np.argmin(scaled**2 / variances))
    moved = (scaled - covariance[:, least] / variances[least] * scaled[least]) / sizes
    near = replace(window_sum, coefficients=moved)
    kept = window_sum.kept[:least] + window_sum.kept[least + 1 :]
    return fitted(
        window_sum.terms, kept, near, SETTINGS.windows.brief_rounds if len(kept) > SETTINGS.windows.few else 0
    )


def _promising(window_sum: WindowSum) -> list[int]:
    """Return the other terms of the library that lower the misfit most, to second order, a few of them."""
    terms, count = window_sum.terms, len(window_sum.terms.atoms)
    coefficients = np.zeros(count)
    coefficients[list(window_sum.kept)] = window_sum.coefficients
    products, cross = terms.errors
    normal, slope = np.zeros((count, count)), np.zeros(count)
    measure(
        np.arange(count), terms.integrals[0], terms.rows.sides[0], products, cross,
        terms.rows.own + window_sum.quadrature, terms.rows.typical, coefficients, np.zeros(len(terms.rows.first)),
        normal, slope, True,
    )  # fmt: skip
    kept = list(window_sum.kept)
    others = [place for place in range(count) if place not in window_sum.kept]
    inverse = np.linalg.pinv(normal[np.ix_(kept, kept)], hermitian=True)
    beside = normal[np.ix_(others, kept)]
    free = np.diag(normal)[others] - ((beside @ inverse) * beside).sum(axis=1)
    pull = slope[others] - beside @ inverse @ slope[kept]
    gains = np.where(free > 1e-9 * np.diag(normal)[others], pull**2 / np.maximum(free, 1e-300), 0.0)
    return [others[place] for place in np.argsort(-gains, kind="stable")[: SETTINGS.windows.promising].tolist()]


def polished(window_sum: WindowSum) -> WindowSum:
    """Return the sum with its inner constants fitted, as a library of its own: steps, halved until it is shorter."""
    best: WindowSum | None = fitted(Terms(window_sum.terms.rows, window_sum.atoms), range(len(window_sum.kept)))
    if best is None:
        return window_sum
    for _ in range(SETTINGS.effort.steps if any(atom.shape.has_constant for atom in best.atoms) else 0):
        following = _stepped(best)
        if following is None:
            break
        is_settled = following.nats > best.nats - _SETTLED
        best = following
        if is_settled:
            break
    return best


def _stepped(window_sum: WindowSum) -> WindowSum | None:
    """Return the sum after one step of its inner constants, None where none makes it shorter.

    The slopes of terms by their inner constants are terms themselves here, with errors of their own.
    """
    moves = _moves(window_sum)
    for halving in range(_HALVINGS):
        atoms = []
        for atom, move in zip(window_sum.atoms, moves, strict=True):
            limit = 0.5 * abs(atom.constant)
            atoms.append(Atom(atom.shape, atom.constant + min(max(move, -limit), limit) * 0.5**halving))
        terms = Terms(window_sum.terms.rows, tuple(atoms))
        following = fitted(terms, range(len(atoms)), replace(window_sum, terms=terms))
        if following is not None and following.nats < window_sum.nats:
            return following
    return None


_HALVINGS = 4
"""Numerics: a step that is too long is halved so many times at most."""


def _moves(window_sum: WindowSum) -> list[float]:
    """Return the step of each term's inner constant, 0 where it has none."""
    rows, count = window_sum.terms.rows, len(window_sum.kept)
    inner = [place for place, atom in enumerate(window_sum.atoms) if atom.shape.has_constant]
    factors = window_sum.coefficients[inner][:, None]
    slopes = factors * np.array([window_sum.atoms[place].slopes for place in inner])
    gradients = np.array([gradient(atom, rows) for atom in window_sum.atoms])
    others = factors[:, :, None] * np.array([gradient(window_sum.atoms[place], rows, is_slope=True) for place in inner])
    columns = np.concatenate([window_sum.terms.integrals[0], rows.integrals(slopes)])
    products, cross = covariances(rows, np.concatenate([gradients, others]))
    if not (np.isfinite(columns).all() and np.isfinite(products).all() and np.isfinite(cross).all()):
        return [0.0] * count
    coefficients, total = np.concatenate([window_sum.coefficients, np.zeros(len(inner))]), count + len(inner)
    fit_errors_in_variables(
        np.arange(total), columns, rows.sides[0], products, cross, rows.own + window_sum.quadrature,
        rows.typical, SETTINGS.windows.brief_rounds, 0.0, coefficients, np.zeros(len(rows.first)),
        np.zeros((total, total)),
    )  # fmt: skip
    moves = [0.0] * count
    for place, move in zip(inner, coefficients[count:].tolist(), strict=True):
        moves[place] = move
    return moves
