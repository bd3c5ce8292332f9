"""Sums of products that describe one state's equation: elimination of terms, the search among sums."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.criteria import constant_nats_of, log, structure_length
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.sparse.elimination import Elimination, eliminated, improved, shortest, without_one
from atoll_coordinator.model.sparse.kernels.elimination import sum_error_products
from atoll_coordinator.model.sparse.products import Product, sum_of_products
from atoll_coordinator.model.sparse.weak_form import WeakForm
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


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


@dataclass(frozen=True, eq=False)
class ProductSum:
    """A fitted sum of the products `kept` (places), with its `coefficients` and `nats`.

    `squares` is the sum of squares of what it leaves in windows that know nothing of each other, in standard errors.
    """

    kept: tuple[int, ...]
    coefficients: list[float]
    nats: float
    squares: float = math.inf


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
            found = self._best_sum(start, weights, is_extended=reweighting > 0)
            its_own = self._weights(found)
            if its_own is None:
                return None
            weights = its_own
        whole = self.refitted(found.kept, weights)
        if whole is None:
            return None
        best = improved(whole, lambda fit: (self.refitted(kept, weights) for kept in without_one(fit.kept)))
        return self.law_of(best, is_tested=is_tested)

    def law_of(self, fit: ProductSum, *, is_tested: bool) -> Law:
        """Return a refitted sum as a law: what it leaves has the degrees of freedom beyond its coefficients."""
        from scipy import special

        degrees_of_freedom = max(self._form.independent - len(fit.kept), 1.0)
        return Law(
            sum_of_products([self._terms[place] for place in fit.kept], fit.coefficients),
            fit.nats,
            math.sqrt(fit.squares / degrees_of_freedom),
            is_tested,
            probability=float(special.chdtrc(degrees_of_freedom, fit.squares)),
        )

    def _price(self, places: Sequence[int]) -> float:
        return math.fsum(self._prices[place] for place in places)

    def _variances(self, fit: ProductSum) -> FloatArray:
        return self._form.variances([self._terms[place] for place in fit.kept], fit.coefficients)

    def _weights(self, fit: ProductSum) -> FloatArray | None:
        """Return the weights of windows that a sum itself gives them, None where it leaves one without a variance."""
        variances = self._variances(fit)
        return 1.0 / np.sqrt(variances) if (variances > 0.0).all() else None

    def _by_own_weights(self, fit: ProductSum) -> ProductSum:
        """Return a sum with its nats by the variances that it has itself."""
        return replace(fit, nats=misfit(self._form, self._left(fit), self._variances(fit)) + self._price(fit.kept))

    def _left(self, fit: ProductSum) -> FloatArray:
        """Return what a sum leaves of the left sides (W,)."""
        left = self._sides.copy()
        for coefficient, place in zip(fit.coefficients, fit.kept, strict=True):
            left -= coefficient * self._columns[place]
        return left

    def refitted(self, places: Sequence[int], weights: FloatArray) -> ProductSum | None:
        """Return the sum of these terms, fitted and weighted by turns; None where it leaves one without a variance."""
        for _ in range(SETTINGS.sparse.reweightings - 1):
            weighted = (self._columns * weights, self._sides * weights, self._errors(weights, places))
            fit = ProductSum(tuple(places), self._path(places, *weighted).factors(0), math.inf)
            its_own = self._weights(fit)
            if its_own is None:
                return None
            weights = its_own
        left = self._left(fit) * weights
        squares = self._form.independent * math.fsum((left * left).tolist()) / len(left)
        return replace(fit, nats=0.5 * squares + self._price(places), squares=squares)

    def _best_sum(self, start: Sequence[int], weights: FloatArray, *, is_extended: bool) -> ProductSum:
        """Return the sum of the shortest description that is found from the terms of `start`.

        Elimination may lose a term early for others that it nearly depends on. So single terms are taken in again,
        and what the sum can then do without eliminated, as long as that is shorter by more than the best of so many
        tries is by chance (Bonferroni).
        """
        count = len(self._terms)
        weighted = (self._columns * weights, self._sides * weights)
        errors = self._errors(weights, range(count) if is_extended else start)
        begun = self._eliminated(start, *weighted, errors)
        if not is_extended:
            return begun

        def longer(fit: ProductSum) -> Iterator[ProductSum]:
            others = [place for place in range(count) if place not in fit.kept]
            tried = (self._eliminated(sorted([*fit.kept, place]), *weighted, errors) for place in others)
            best = shortest(tried)
            if best is not None:
                yield self._by_own_weights(best)

        return improved(self._by_own_weights(begun), longer, log(float(count)))

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
        chosen = np.asarray(places)
        return eliminated(columns[chosen], sides, (errors[0][np.ix_(chosen, chosen)], errors[1][chosen]))

    def _eliminated(
        self, places: Sequence[int], columns: FloatArray, sides: FloatArray, errors: tuple[FloatArray, FloatArray]
    ) -> ProductSum:
        """Return the best sum on the way from these terms to none, by the weights of the windows."""
        path = self._path(places, columns, sides, errors)
        independent = self._form.independent
        squares, price = path.squares.tolist(), 0.0
        best, least = 0, math.inf
        for step in reversed(range(len(places))):
            price += self._prices[places[path.order[step]]]
            nats = 0.5 * independent * log(max(squares[step], 1e-300)) + price
            if nats <= least:
                best, least = step, nats
        return ProductSum(tuple(places[index] for index in path.kept(best)), path.factors(best), least)
