"""Constants as they are shown: simple numbers where the data single them out, else estimates with few digits.

A constant is either a simple number, one of length L with the probability e^-L, or any number of the same
neighbourhood; before the data both are as likely (`simple_numbers`). Near its minimum the misfit is a quadratic form of
the constants, so that what the data say of each of these decisions is known: constants are decided one after another,
each by a few simple numbers near where it lies once the earlier ones are fixed, and a beam of the most probable
decisions is kept (a sequential decoding, as in integer least squares). A simple number takes the place of an estimate
when its odds, against all other decisions together, are at least those of `InferenceSettings.distinct_nats`.

Constants are judged jointly. What share of them is simple is not known beforehand, and any share is as likely: of K
constants m certain ones are simple with the probability m! (K - m)!/(K + 1)! (Laplace's rule of succession), so that
simple numbers speak for each other, and estimates against a simple number that is alone. And what is simple may be the
product of a constant with one that is decided already: 0.9 (c + f) with c = 0.1111 is 0.1 + 0.9 f with the bracket
expanded.
"""

import math
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Final

import numpy as np

from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.model.regression.covariance import covariance_of, description_length, standard_errors
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.simple_numbers import continuum_density, fitted_length, simple_numbers
from atoll_coordinator.result.equations import SimpleNumber, SimpleTogether
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.writing.shortest import collected

ERROR_DIGITS: Final = tuple(1 + 2**power for power in range(5))
"""Digits of standard errors to which estimates may be rounded, all of a double at last: the first with which
simulations stay as they are. With two they are off by at most a twentieth of a standard error."""
_ROUNDING = 2.0**-50
"""Standard errors below this share of a constant are those of arithmetic."""


@dataclass(frozen=True, eq=False)
class Model:
    """A program as it would be shown: its length in nats and its mean squared error."""

    program: Program
    length: float
    mse: float


@dataclass(frozen=True, eq=False)
class Decision:
    """Some constants decided, by their number in node order; where the others lie now, and their covariance.

    `nats` is the logarithm of the probability of these simple numbers over that of any numbers in their place.
    """

    numbers: tuple[tuple[int, float], ...]
    nats: float
    open: tuple[int, ...]
    means: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class _Successor:
    """A decision with the k-th of its open constants decided, too; `numbers` and `nats` are as in the decision.

    It is `made` of those only that go on: of a beam's successors few do.
    """

    before: Decision
    k: int
    number: float
    numbers: tuple[tuple[int, float], ...]
    nats: float

    def made(self) -> Decision:
        """Return the decision; the constants that are open move along."""
        before, k = self.before, self.k
        others = [place for place in range(len(before.open)) if place != k]
        column, variance = before.covariance[others, k], float(before.covariance[k, k])
        rest = before.covariance[np.ix_(others, others)]
        spread = rest - np.outer(column, column) / variance
        diagonal, least = np.diag(spread), np.maximum(_ROUNDING * np.diag(rest), np.finfo(np.float64).tiny)
        means = before.means[others] + column / variance * (self.number - float(before.means[k]))
        return Decision(
            numbers=self.numbers,
            nats=self.nats,
            open=tuple(before.open[place] for place in others),
            means=means,
            covariance=spread + np.diag(np.maximum(np.maximum((_ROUNDING * means) ** 2, least) - diagonal, 0.0)),
        )


class Considered:
    """Decisions that were weighed, and the odds of what is held by some of them."""

    def __init__(self, weighed: Sequence[Decision] = ()) -> None:
        """Weigh these decisions."""
        self.decisions: Final = weighed
        self.numbers: Final = [frozenset(decision.numbers) for decision in weighed]
        most = max((decision.nats for decision in weighed), default=0.0)
        self._weights: Final = [math.exp(decision.nats - most) for decision in weighed]
        self._whole: Final = math.fsum(self._weights)

    def odds_of(self, held: Iterable[bool]) -> float:
        """Return the odds of what some decisions hold, those that are true here, against all others."""
        share = math.fsum(compress(self._weights, held))
        return share / max(self._whole - share, 1e-300)

    @cached_property
    def odds(self) -> dict[tuple[int, float], float]:
        """The odds of each number of each constant against all decisions without it."""
        found = dict.fromkeys(number for decision in self.decisions for number in decision.numbers)
        return {number: self.odds_of([number in numbers for numbers in self.numbers]) for number in found}

    @property
    def singled_out(self) -> dict[int, float]:
        """The simple numbers whose odds suffice, by constant."""
        least = math.exp(SETTINGS.inference.distinct_nats)
        return {index: value for (index, value), odds in self.odds.items() if odds >= least}


@dataclass(frozen=True, eq=False)
class Rounding:
    """What becomes of constants: their `values` (K,) as they are shown, and the nearest simple number of each.

    `means` (K,) and `covariance` are those of the estimates, `considered` the decisions that were weighed.
    """

    values: FloatArray
    simple: tuple[SimpleNumber | None, ...]
    means: FloatArray
    covariance: FloatArray
    considered: "Considered"

    def together(self, constants: Sequence[int]) -> SimpleTogether | None:
        """Return simple numbers of two and more of these constants that are right together; None if that is unlikely.

        Of those that the data single out together the most, else of those that are likelier than everything else.
        Places in it are those in `constants`.
        """
        decided = self.considered.numbers
        combinations = dict.fromkeys(tuple(number for number in decision.numbers if number[0] in constants)
                                     for decision in self.considered.decisions)  # fmt: skip
        odds = {
            key: self.considered.odds_of([numbers.issuperset(key) for numbers in decided])
            for key in combinations
            if len(key) > 1
        }
        for least in (math.exp(SETTINGS.inference.distinct_nats), 1.0):
            likely = [key for key, key_odds in odds.items() if key_odds >= least]
            if likely:
                best = max(likely, key=lambda key: (len(key), odds[key]))
                return self._together(constants, dict(best), odds[best])
        return None

    def _together(self, constants: Sequence[int], numbers: Mapping[int, float], odds: float) -> SimpleTogether:
        places = tuple(place for place, index in enumerate(constants) if index in numbers)
        chosen = sorted(numbers)
        away = self.means[chosen] - [numbers[index] for index in chosen]
        return SimpleTogether(
            constants=places,
            values=tuple(numbers[constants[place]] for place in places),
            odds=odds,
            chi_square=2.0 * quadratic_form(away, self.covariance[np.ix_(chosen, chosen)]),
        )


class Estimates:
    """Fitted constants, and what is considered of them: once, in however many digits they are shown."""

    def __init__(self, means: FloatArray, covariance: FloatArray) -> None:
        """Know constants by their `means` (K,) and `covariance`."""
        self._means: Final = means
        self._covariance: Final = covariance

    @cached_property
    def considered(self) -> Considered:
        """The most probable decisions on them."""
        return Considered(decisions(self._means, self._covariance, has_products=True))

    def rounded(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> Rounding:
        """Return the constants as they are shown.

        Estimates are rounded to so many digits of their standard errors, one after another, each where it lies once the
        earlier ones are: so the last of several constants that only together are determined keeps the digits it needs.
        Simple numbers that are singled out take their place, but for those of the `estimates`, by number.
        """
        means, decision = self._means, _start(self._means, self._covariance)
        covariance = decision.covariance
        considered = self.considered if len(estimates) < len(means) else Considered()
        numbers = {index: number for index, number in considered.singled_out.items() if index not in estimates}
        for index, number in numbers.items():
            decision = _decided(decision, decision.open.index(index), number)
        while decision.open:
            number = _rounded(float(decision.means[0]), math.sqrt(float(decision.covariance[0, 0])), digits)
            decision = _decided(decision, 0, number)
        values = np.array([value for _, value in decision.numbers])
        constants = zip(range(len(means)), means, np.diag(self._covariance), strict=True)
        remarks = [_simple_number(*constant, considered.odds) for constant in constants]
        return Rounding(values, tuple(remarks), means, covariance, considered)


def find_simple(means: FloatArray, covariance: FloatArray) -> dict[int, float]:
    """Return the simple numbers that the data single out, by the number of the constant."""
    return Estimates(means, covariance).considered.singled_out


def round_constants(fitted: Fitted, criterion: RegressionCriterion, least_squares: LeastSquares) -> Model:
    """Return the shortest model that comes from `fitted` by making constants simple; itself when none is shorter.

    That is what equations are compared by: simple numbers speak for an equation before any of them is singled out.
    """
    best = Model(fitted.program, description_length(fitted, criterion), fitted.mse)
    places = constant_places(fitted.program)
    if not 0 < len(places) <= SETTINGS.effort.beam or not math.isfinite(best.length):
        return best
    candidates = decisions(fitted.program.constants[places], covariance_of(fitted, criterion))
    probable = sorted((decision for decision in candidates if decision.numbers), key=lambda decision: -decision.nats)
    for decision in probable[: SETTINGS.effort.beam]:
        model = _measured(fitted.program, places, dict(decision.numbers), criterion, least_squares)
        if model.length <= best.length:
            best = model
    return best


def quadratic_form(away: FloatArray, covariance: FloatArray) -> float:
    """Return by how many nats the misfit grows when constants move away (K,) from their estimates, near its minimum."""
    return 0.5 * float(away @ inverse(covariance) @ away)


def decisions(means: FloatArray, covariance: FloatArray, *, has_products: bool = False) -> list[Decision]:
    """Return the most probable decisions on constants with these `means` (K,) and `covariance`, none among them.

    With `has_products` a constant may also be what makes its product with one that is decided a simple number.
    """
    all_decisions = beam = [_start(means, covariance)]
    while beam:
        following: dict[tuple[tuple[int, float], ...], _Successor] = {}
        for successor in (successor for decision in beam for successor in _next(decision, has_products=has_products)):
            known = following.get(successor.numbers)
            if known is None or successor.nats > known.nats:
                following[successor.numbers] = successor
        best = sorted(following.values(), key=lambda successor: -successor.nats)[: SETTINGS.effort.beam]
        beam = [successor.made() for successor in best]
        all_decisions = [*all_decisions, *beam]
    return [
        replace(decision, nats=decision.nats + _of_share(len(decision.numbers), len(means)))
        for decision in all_decisions
    ]


def _of_share(simple: int, constants: int) -> float:
    """Return the logarithm of the probability that so many certain ones of all constants, and no others, are simple.

    Any share of simple ones is as likely as any other (Laplace's rule of succession).
    """
    return -math.log((constants + 1) * math.comb(constants, simple))


def _start(means: FloatArray, covariance: FloatArray) -> Decision:
    """Return the decision on nothing; variances are at least those of arithmetic."""
    least = np.maximum((_ROUNDING * means) ** 2, np.finfo(np.float64).tiny)
    spread = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
    return Decision((), 0.0, tuple(range(len(means))), means, spread)


def _next(decision: Decision, *, has_products: bool) -> Iterator[_Successor]:
    """Yield `decision` with one more constant decided."""
    others = [number for _, number in decision.numbers] if has_products else []
    for k in range(len(decision.open)):
        gains = _gains(float(decision.means[k]), math.sqrt(float(decision.covariance[k, k])), others)
        best = sorted(gains, key=lambda number: -gains[number])[: SETTINGS.effort.beam]
        yield from (_successor(decision, k, number, gains[number]) for number in best)


def _gains(value: float, error: float, others: Sequence[float] = ()) -> dict[float, float]:
    """Return for the simple numbers near an estimate the nats by which each is more probable than any number.

    Among them are those that are simple as factors of one of `others`: they are half as probable as the others
    together, and only of interest where none of these is more probable than any number.
    """
    if value == 0.0 or not math.isfinite(value) or not math.isfinite(error):  # no number is near
        return {}
    least = math.log(error * math.sqrt(2.0 * math.pi)) + math.log(continuum_density(value))
    own = _priced(simple_numbers(value, error), value, error, least)
    factors = {abs(number) for number in others}
    if not factors:
        return own
    of_both = math.log(1.5)
    gains = {number: nats - of_both for number, nats in own.items()}
    if max(own.values(), default=0.0) > 0.0:
        return gains
    for factor in factors:
        numbers = simple_numbers(value * factor, error * factor)
        price = least + of_both + math.log(2.0 * len(factors))
        for product, nats in _priced(numbers, value * factor, error * factor, price).items():
            gains[product / factor] = max(nats, gains.get(product / factor, -math.inf))
    return gains


def _priced(numbers: Mapping[float, float], value: float, error: float, least: float) -> dict[float, float]:
    """Return the nats of simple numbers of known lengths near an estimate, beyond `least`."""
    return {number: -length - 0.5 * ((number - value) / error) ** 2 - least for number, length in numbers.items()}


def _successor(decision: Decision, k: int, number: float, gain: float) -> _Successor:
    """Return what makes `decision` with the k-th of the open constants fixed at a number of so many nats."""
    numbers = tuple(sorted((*decision.numbers, (decision.open[k], number))))
    return _Successor(decision, k, number, numbers, decision.nats + gain)


def _decided(decision: Decision, k: int, number: float) -> Decision:
    """Return `decision` with the k-th of the open constants fixed; the others move along."""
    return _successor(decision, k, number, 0.0).made()


def _rounded(value: float, error: float, digits: int) -> float:
    """Return `value` rounded to so many digits of its error, and to as many of its own at least."""
    if value == 0.0 or not math.isfinite(value):
        return value
    size = min(error, abs(value)) if error > 0.0 else abs(value)
    places = math.floor(math.log10(abs(value))) - math.floor(math.log10(size)) + digits
    return float(f"{value:.{min(places, sys.float_info.dig) - 1}e}") if places < 17 else value


def _simple_number(
    index: int, mean: float, variance: float, odds: Mapping[tuple[int, float], float]
) -> SimpleNumber | None:
    """Return the most probable simple number near a constant; None when none was considered."""
    near = {number: number_odds for (constant, number), number_odds in odds.items() if constant == index}
    if not near:
        return None
    number = max(near, key=near.__getitem__)
    error = math.sqrt(max(float(variance), 0.0))
    away = abs(number - float(mean)) / error if error > 0.0 else 0.0
    return SimpleNumber(value=number, odds=near[number], standard_errors=away)


def _measured(
    program: Program,
    places: Sequence[int],
    decided: Mapping[int, float],
    criterion: RegressionCriterion,
    least_squares: LeastSquares,
) -> Model:
    """Return the model of simple numbers, its other constants fitted and its neutral ones gone."""
    values = {places[index]: number for index, number in decided.items()}
    prices = {number: min(simple_numbers(number, 0.0).values(), default=0.0) for number in values.values()}
    refitted = least_squares.fit(with_constants(program, values), [*values])
    if not math.isfinite(refitted.mse):
        return Model(refitted.program, math.inf, math.inf)
    freed = refitted.program.constants[[place for place in places if place not in values]].tolist()
    prices |= dict(zip(freed, map(fitted_length, freed, standard_errors(refitted, criterion)), strict=True))
    shown = collected(refitted.program)
    mse = least_squares.mse(shown)
    known = {abs(number): price for number, price in prices.items()}
    numbers = sum(
        known[number] if number in known else min(simple_numbers(number, 0.0).values(), default=0.0)
        for number in set(np.abs(shown.constants[constant_places(shown)]).tolist())
    )
    return Model(shown, criterion.length(mse, shown, numbers), mse)
