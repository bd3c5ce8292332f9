"""Sums of terms fitted to windows with errors in all variables, and the shortest of them.

The misfit is half the square of what is left in each window over its variance, which depends on the sum: by errors of
the side and of the terms, to first order, and by the difference of two quadratures. Large ones count less (Cauchy).
Each window counts by its share in a new one.

Letters: K terms of a library, M terms of a sum, W windows.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.least_squares import Descent, Solver, inverse, minimize, solver
from atoll_coordinator.model.sparse import elimination
from atoll_coordinator.model.sparse.elimination import on_the_way, shortest, without_one
from atoll_coordinator.model.sparse.kernels.errors_in_variables import measure
from atoll_coordinator.model.sparse.kernels.robust import NORMAL_DEVIATION, robust_fit
from atoll_coordinator.model.sparse.shapes import Atom, program_of
from atoll_coordinator.model.sparse.windows.terms import Terms, covariances, gradient
from atoll_coordinator.model.sparse.windows.window_rows import WindowRows
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.program import Program


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


Columns = tuple[FloatArray, FloatArray, FloatArray]
"""Integrals (K, W), the covariances of their errors (W, K, K), and those with the errors of the sides (W, K)."""


@dataclass(frozen=True, eq=False)
class _Misfit:
    """What windows are left with (W,) by coefficients (M,), in standard errors, and that in nats.

    With its gradient (M,) and the matrix (M, M) of the normal equations.
    """

    coefficients: FloatArray
    scaled: FloatArray
    nats: float
    gradient: FloatArray
    normal: FloatArray


def _misfit(rows: WindowRows, columns: Columns, variances: FloatArray, kept: Ints, coefficients: FloatArray) -> _Misfit:
    """Return the misfit of a sum of the columns `kept` (M,) with these `coefficients` (M,).

    The `variances` (W,) are those of what windows are left with beside the errors of columns.
    """
    values, products, cross = columns
    scaled, pull, normal = np.zeros(len(variances)), np.zeros(len(kept)), np.zeros((len(kept), len(kept)))
    loss = measure(
        kept, values, rows.sides[0], products, cross, variances, rows.typical, coefficients, scaled, normal, pull
    )
    share = rows.independent / len(variances)
    return _Misfit(coefficients, scaled, rows.independent * loss, -share * pull, share * normal)


def _moved(terms: Terms, places: Ints, begun: FloatArray, quadrature: FloatArray, rounds: int) -> WindowSum:
    rows = terms.rows
    misfit = partial(_misfit, rows, (terms.integrals[0], *terms.errors), rows.own + quadrature, places)

    def move(at: _Misfit, step: FloatArray) -> tuple[_Misfit, float]:
        there = misfit(at.coefficients + step)
        return there, at.nats - there.nats

    end = minimize(Descent(misfit(begun), lambda at: solver(at.normal, at.gradient), move, _settled), rounds)
    price = math.fsum(terms.price(place) for place in places.tolist())
    nats = end.nats + rows.independent * _unresolved(terms, places, end.coefficients, quadrature) + price
    return WindowSum(terms, tuple(places.tolist()), end.coefficients, end.scaled, end.normal, quadrature, nats)


def _settled(_: object) -> float:
    """Return the nats below which a step gains nothing: windows are few, and a tenth moves constants half an error."""
    return SETTINGS.process.settled


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
    for kept in without_one(window_sum.kept, SETTINGS.effort.longest_sum):
        yield fitted(window_sum.terms, kept, window_sum)


def _without_least(window_sum: WindowSum) -> WindowSum | None:
    if len(window_sum.kept) < 2:
        return None
    covariance = inverse(window_sum.normal)
    variances = np.maximum(np.diag(covariance), 1e-300)
    least = int(np.argmin(window_sum.coefficients**2 / variances))
    moved = window_sum.coefficients - covariance[:, least] / variances[least] * window_sum.coefficients[least]
    near = replace(window_sum, coefficients=moved)
    kept = window_sum.kept[:least] + window_sum.kept[least + 1 :]
    return fitted(
        window_sum.terms, kept, near, SETTINGS.windows.brief_rounds if len(kept) > SETTINGS.effort.beam else 0
    )


def _promising(window_sum: WindowSum) -> list[int]:
    """Return the other terms of the library that lower the misfit most, to second order, a few of them."""
    terms, count = window_sum.terms, len(window_sum.terms.atoms)
    coefficients = np.zeros(count)
    coefficients[list(window_sum.kept)] = window_sum.coefficients
    columns, variances = (terms.integrals[0], *terms.errors), terms.rows.own + window_sum.quadrature
    here = _misfit(terms.rows, columns, variances, np.arange(count), coefficients)
    normal, slope = here.normal, here.gradient
    kept = list(window_sum.kept)
    others = [place for place in range(count) if place not in window_sum.kept]
    beside = normal[np.ix_(others, kept)]
    carried = beside @ inverse(normal[np.ix_(kept, kept)])
    free = np.diag(normal)[others] - (carried * beside).sum(axis=1)
    pull = slope[others] - carried @ slope[kept]
    gains = np.where(free > 1e-9 * np.diag(normal)[others], pull**2 / np.maximum(free, 1e-300), 0.0)
    return [others[place] for place in np.argsort(-gains, kind="stable")[: SETTINGS.effort.beam // 2].tolist()]


def polished(window_sum: WindowSum) -> WindowSum:
    """Return the sum with its inner constants fitted, as a library of its own.

    The slopes of terms by their inner constants are terms themselves here, with errors of their own.
    """
    begun = fitted(Terms(window_sum.terms.rows, window_sum.atoms), range(len(window_sum.kept)))
    inner = [place for place, atom in enumerate(window_sum.atoms) if atom.shape.has_constant]
    if begun is None or not inner:
        return begun or window_sum
    rows, count = window_sum.terms.rows, len(window_sum.kept)
    every = np.arange(count + len(inner))

    def linearise(at: WindowSum) -> Solver[FloatArray]:
        chosen, factors = [at.atoms[place] for place in inner], at.coefficients[inner][:, None]
        slopes = factors * np.array([atom.slopes for atom in chosen])
        others = factors[:, :, None] * np.array([gradient(atom, rows, is_slope=True) for atom in chosen])
        columns = np.concatenate([at.terms.integrals[0], rows.integrals(slopes)])
        errors = covariances(rows, np.concatenate([[gradient(atom, rows) for atom in at.atoms], others]))
        coefficients = np.concatenate([at.coefficients, np.zeros(len(inner))])
        here = _misfit(rows, (columns, *errors), rows.own + at.quadrature, every, coefficients)
        return solver(here.normal, here.gradient)

    def move(at: WindowSum, step: FloatArray) -> tuple[WindowSum, float] | None:
        moves = dict(zip(inner, step[count:].tolist(), strict=True))
        atoms = tuple(atom.moved(moves.get(place, 0.0)) for place, atom in enumerate(at.atoms))
        terms = Terms(rows, atoms)
        near = replace(at, terms=terms, coefficients=at.coefficients + step[:count])
        following = fitted(terms, range(count), near)
        return None if following is None else (following, at.nats - following.nats)

    return minimize(Descent(begun, linearise, move, _settled))
