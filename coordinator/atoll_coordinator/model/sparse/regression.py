"""Sums of products that describe one state's equation: elimination of terms, the search among sums."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.model.criteria import constant_nats_of, log, structure_length
from atoll_coordinator.model.refinement import Law
from atoll_coordinator.model.sparse.kernels.corrected import eliminate_corrected, sum_error_products
from atoll_coordinator.model.sparse.kernels.elimination import eliminate
from atoll_coordinator.model.sparse.products import Product, sum_of_products
from atoll_coordinator.model.sparse.weak_form import WeakForm
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Elimination:
    """The sums on the way from a library to nothing: which terms each has, its coefficients, what it leaves."""

    terms: Sequence[Product]
    order: Sequence[int]
    squares: FloatArray
    coefficients: FloatArray

    def kept(self, step: int) -> list[int]:
        return sorted(self.order[step:])

    def sum(self, step: int) -> tuple[list[Product], list[float]]:
        kept = self.kept(step)
        return [self.terms[index] for index in kept], [float(self.coefficients[step, index]) for index in kept]


def eliminated(terms: Sequence[Product], columns: FloatArray, sides: FloatArray) -> Elimination:
    count = len(terms)
    order, squares = np.zeros(count, np.int64), np.zeros(count + 1)
    coefficients = np.zeros((count, count))
    eliminate(np.ascontiguousarray(columns), np.ascontiguousarray(sides), order, squares, coefficients)
    return Elimination(terms, order.tolist(), squares, coefficients)


def misfit(form: WeakForm, left: FloatArray, variances: FloatArray) -> float:
    """Return minus the log-likelihood of what is left in the windows (W,), each counted by its share in a new one.

    That of the true states nearest to the measured ones for which the equation holds, to first order: half the square
    over its variance. The variance depends on the equation, the density of the measurements about these states does
    not: with its logarithm, sums that vary little with the states would be preferred (errors in variables, functional
    case: Fuller 1987, section 2.3).
    """
    if not (variances > 0.0).all():
        return math.inf
    return 0.5 * form.independent * math.fsum((left * left / variances).tolist()) / len(left)


class Regression:
    """Sums of the products of one library, the largest, by which windows are described."""

    def __init__(self, form: WeakForm, terms: Sequence[Product]) -> None:
        self._form = form
        self._terms = terms
        self._places = {term: place for place, term in enumerate(terms)}
        self._columns, self._sides = form.columns(terms), form.sides
        self._gradients, self._rows = form.gradients(terms)
        own = constant_nats_of(form.independent)
        self._prices = [structure_length(sum_of_products([term], [1.5])) + own for term in terms]

    def law(self, begun: Sequence[Product], *, is_tested: bool) -> Law | None:
        """Return the sum that a search from all terms `begun` ends with, windows weighted by its own variances.

        Weights are those of the sum before, which may be a wrong one that they favour: so at last terms are left out as
        long as the description by the weights of what remains is shorter.
        """
        start = [self._places[term] for term in begun]
        if not np.isfinite(self._columns).all() or len(start) >= len(self._sides):
            return None
        weights = np.ones(len(self._sides))
        for reweighting in range(SETTINGS.sparse.reweightings):
            kept, coefficients = self._best_sum(start, weights, is_extended=reweighting > 0)
            its_own = self._weights(kept, coefficients)
            if its_own is None:
                return None
            weights = its_own
        best = self._refitted(kept, weights, is_tested=is_tested)
        while best is not None and len(kept) > 1:
            fewer = [[place for place in kept if place != left_out] for left_out in kept]
            candidates = [(law.nats, places, law) for places in fewer
                          if (law := self._refitted(places, weights, is_tested=is_tested)) is not None]  # fmt: skip
            nats, places, law = min(candidates, key=lambda candidate: candidate[:2], default=(math.inf, kept, best))
            if not nats < best.nats:
                break
            kept, best = places, law
        return best

    def _price(self, places: Sequence[int]) -> float:
        return math.fsum(self._prices[place] for place in places)

    def _weights(self, places: Sequence[int], coefficients: Sequence[float]) -> FloatArray | None:
        """Return the weights of windows that a sum itself gives them, None where it leaves one without a variance."""
        variances = self._form.variances([self._terms[place] for place in places], coefficients)
        return 1.0 / np.sqrt(variances) if (variances > 0.0).all() else None

    def _nats(self, places: Sequence[int], coefficients: Sequence[float]) -> float:
        """Return the nats of a sum of these terms."""
        variances = self._form.variances([self._terms[place] for place in places], coefficients)
        return misfit(self._form, self._left(places, coefficients), variances) + self._price(places)

    def _left(self, places: Sequence[int], coefficients: Sequence[float]) -> FloatArray:
        """Return what a sum leaves of the left sides (W,)."""
        left = self._sides.copy()
        for coefficient, place in zip(coefficients, places, strict=True):
            left -= coefficient * self._columns[place]
        return left

    def _refitted(self, places: Sequence[int], weights: FloatArray, *, is_tested: bool) -> Law | None:
        """Return the sum of these terms, fitted and weighted by turns.

        What it leaves has as many degrees of freedom as there are independent windows beyond its coefficients.
        """
        from scipy import special

        terms, window_weights = [self._terms[place] for place in places], weights
        for _ in range(SETTINGS.sparse.reweightings - 1):
            errors = self._errors(window_weights, places)
            path = self._path(places, self._columns * window_weights, self._sides * window_weights, errors)
            coefficients = path.coefficients[0].tolist()
            next_weights = self._weights(places, coefficients)
            if next_weights is None:
                return None
            window_weights = next_weights
        left = self._left(places, coefficients)
        independent = self._form.independent
        squares = independent * math.fsum((left * left * window_weights * window_weights).tolist()) / len(left)
        degrees_of_freedom = max(independent - len(places), 1.0)
        return Law(
            sum_of_products(terms, coefficients),
            0.5 * squares + self._price(places),
            math.sqrt(squares / degrees_of_freedom),
            is_tested,
            probability=float(special.chdtrc(degrees_of_freedom, squares)),
        )

    def _best_sum(
        self, start: Sequence[int], weights: FloatArray, *, is_extended: bool
    ) -> tuple[list[int], list[float]]:
        """Return the terms of the shortest description that is found from those of `start`, and their coefficients.

        Elimination may lose a term early for others that it nearly depends on. So single terms are taken in again,
        and what the sum can then do without eliminated, as long as that is shorter by more than the best of so many
        tries is by chance (Bonferroni).
        """
        needed = range(len(self._terms)) if is_extended else start
        weighted = (self._columns * weights, self._sides * weights, self._errors(weights, needed))
        best = self._eliminated(start, *weighted)
        least = self._nats(best[1], best[2]) if is_extended else math.inf
        while is_extended:
            others = [place for place in range(len(self._terms)) if place not in best[1]]
            longer = (self._eliminated(sorted([*best[1], place]), *weighted) for place in others)
            candidate = min(longer, default=best)
            nats = self._nats(candidate[1], candidate[2])
            if not others or not nats < least - log(len(others)):
                break
            best, least = candidate, nats
        return best[1], best[2]

    def _errors(self, weights: FloatArray, places: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the covariances of the errors of these terms, summed over windows of these weights, and with the
        sides'; 0 of all other terms."""
        form, count = self._form, len(self._terms)
        squares, halves = form.row_weights(weights * weights, self._rows)
        own_products, own_cross = np.zeros((len(places), len(places))), np.zeros(len(places))
        variances = form.measured.noise * form.measured.noise
        gradients = np.ascontiguousarray(self._gradients[list(places)])
        sum_error_products(gradients, variances, form.target, squares, halves, own_products, own_cross)
        products, cross = np.zeros((count, count)), np.zeros(count)
        products[np.ix_(list(places), list(places))], cross[list(places)] = own_products, own_cross
        return products, cross

    def _path(
        self, places: Sequence[int], columns: FloatArray, sides: FloatArray, errors: tuple[FloatArray, FloatArray]
    ) -> Elimination:
        """Return the sums on the way from these terms to none, errors of the variables in the terms allowed for."""
        count, chosen = len(places), np.asarray(places)
        order, found = np.zeros(count, np.int64), np.zeros((count, count))
        squares, its_errors = np.zeros((2, count + 1))
        products, cross = np.ascontiguousarray(errors[0][np.ix_(chosen, chosen)]), errors[1][chosen]
        eliminate_corrected(columns[chosen], sides, products, cross, order, squares, found, its_errors)
        beyond = np.maximum(squares - its_errors + its_errors[0], squares[0])  # fewer terms leave no less
        return Elimination([self._terms[place] for place in places], order.tolist(), beyond, found)

    def _eliminated(
        self, places: Sequence[int], columns: FloatArray, sides: FloatArray, errors: tuple[FloatArray, FloatArray]
    ) -> tuple[float, list[int], list[float]]:
        """Return the nats, terms and coefficients of the best sum on the way from these terms to none."""
        path = self._path(places, columns, sides, errors)
        independent = self._form.independent
        squares, price = path.squares.tolist(), 0.0
        best, least = 0, math.inf
        for step in reversed(range(len(places))):
            price += self._prices[places[path.order[step]]]
            nats = 0.5 * independent * log(max(squares[step], 1e-300)) + price
            if nats <= least:
                best, least = step, nats
        return least, [places[index] for index in path.kept(best)], path.sum(best)[1]
