"""Constants as they are shown: simple numbers where the data single them out, else estimates with few digits.

*Simple numbers.* A simple number is p/q times a power of ten, p and q whole numbers and q small, or pi times that:
whole numbers and short decimals have q = 1. No unit is preferred: a number is as long as ten times it.

*One constant.* It is either a simple number, one of length L with the probability e^-L, or any number of the same
neighbourhood; before the data both are as likely. Near its minimum the misfit is a quadratic form of the constants, so
that the effect of each decision is known: constants are decided one after another, each by a few simple numbers near
its estimate once the earlier ones are fixed, and a beam of the most probable decisions is kept (a sequential decoding,
as in integer least squares). A simple number takes the place of an estimate when its odds, against all other decisions
together, reach `InferenceSettings.distinct_nats`.

*All constants together.* The share of simple constants is not known beforehand, and any share is as likely: m given
constants of K are simple with the probability m! (K - m)!/(K + 1)! (Laplace's rule of succession), so that
simple numbers support each other, and estimates speak against a single simple number. And a constant may be simple
as a factor of one that is decided already: 0.9 (c + f) with c = 0.1111 is 0.1 + 0.9 f with the bracket expanded.

All routes round by this module: equations of a target (`equation`), systems along trajectories and groups of them
(`selection.rounding`, `inference`), and processes.
"""

import math
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import compress
from typing import Final

import numpy as np

from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.result.equations import SimpleNumber, SimpleTogether
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

ERROR_DIGITS: Final = tuple(1 + 2**power for power in range(5))
"""Digits of standard errors to which estimates may be rounded, at last all of a double: the first number of digits with
which simulations stay as they are is taken. With two, estimates are off by at most a twentieth of a standard error."""
_ROUNDING: Final = 2.0**-50
"""Standard errors below this share of a constant are rounding errors."""
_DIGIT: Final = math.log(3.0)
"""Nats of each digit beyond the first, in addition to the nats of the whole number."""
_SHORT: Final = 3
"""For numerators with more digits, the sum of probabilities is replaced by an integral."""
_DIGITS_OF_PI: Final = 2
"""Digits of multiples of pi: with more, they would say less than a decimal of the same size."""
_LARGE: Final = 1e200
"""Beyond, and below its inverse, numbers are scaled first, since powers of ten would overflow."""


@dataclass(frozen=True, eq=False)
class Decision:
    """Some constants decided, by their number in node order; the present estimates of the others, and their covariance.

    `nats` is the logarithm of the probability of these simple numbers over the one of any numbers in their place.
    """

    numbers: tuple[tuple[int, float], ...]
    nats: float
    open: tuple[int, ...]
    means: FloatArray
    covariance: FloatArray

    @classmethod
    def none(cls, means: FloatArray, covariance: FloatArray) -> "Decision":
        """Return the decision on no constant; variances are at least the variances of rounding errors."""
        least = np.maximum((_ROUNDING * means) ** 2, np.finfo(np.float64).tiny)
        spread = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
        return cls((), 0.0, tuple(range(len(means))), means, spread)

    def with_next(self, k: int, number: float) -> tuple[tuple[int, float], ...]:
        """Return the decided numbers once the k-th of the open constants is decided."""
        return tuple(sorted((*self.numbers, (self.open[k], number))))

    def followed(self, k: int, number: float, nats: float = 0.0) -> "Decision":
        """Return the decision with the k-th of the open constants decided, too; the other open constants move along."""
        others = [place for place in range(len(self.open)) if place != k]
        column, variance = self.covariance[others, k], float(self.covariance[k, k])
        rest = self.covariance[np.ix_(others, others)]
        spread = rest - np.outer(column, column) / variance
        diagonal, least = np.diag(spread), np.maximum(_ROUNDING * np.diag(rest), np.finfo(np.float64).tiny)
        means = self.means[others] + column / variance * (number - float(self.means[k]))
        return Decision(
            numbers=self.with_next(k, number),
            nats=self.nats + nats,
            open=tuple(self.open[place] for place in others),
            means=means,
            covariance=spread + np.diag(np.maximum(np.maximum((_ROUNDING * means) ** 2, least) - diagonal, 0.0)),
        )


class Considered:
    """Decisions that were compared, and the odds of a property that some of them share."""

    def __init__(self, weighed: Sequence[Decision] = ()) -> None:
        """Weigh these decisions."""
        self.decisions: Final = weighed
        self.numbers: Final = [frozenset(decision.numbers) for decision in weighed]
        most = max((decision.nats for decision in weighed), default=0.0)
        self._weights: Final = [math.exp(decision.nats - most) for decision in weighed]
        self._whole: Final = math.fsum(self._weights)

    def odds_of(self, chosen: Iterable[bool]) -> float:
        """Return the odds of the chosen decisions (true here) against all others."""
        share = math.fsum(compress(self._weights, chosen))
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
    """Constants as they are shown: their `values` (K,), and the nearest simple number of each.

    `means` (K,) and `covariance` belong to the estimates; `considered` are the decisions that were weighed.
    """

    values: FloatArray
    simple: tuple[SimpleNumber | None, ...]
    means: FloatArray
    covariance: FloatArray
    considered: "Considered"

    def together(self, constants: Sequence[int]) -> SimpleTogether | None:
        """Return simple numbers of two and more of these constants that are right together; None if that is unlikely.

        The largest combination that the data single out, else the largest that is likelier than all others together.
        Its places are indices of `constants`.
        """
        decided = self.considered.numbers
        combinations = dict.fromkeys(
            tuple(number for number in decision.numbers if number[0] in constants)
            for decision in self.considered.decisions
        )
        odds = {
            key: self.considered.odds_of([numbers.issuperset(key) for numbers in decided])
            for key in combinations
            if len(key) > 1
        }
        for least in (math.exp(SETTINGS.inference.distinct_nats), 1.0):
            likely = [key for key, key_odds in odds.items() if key_odds >= least]
            if likely:
                best = max(likely, key=lambda key: (len(key), odds[key]))
                numbers = dict(best)
                places = tuple(place for place, index in enumerate(constants) if index in numbers)
                chosen = sorted(numbers)
                away = self.means[chosen] - [numbers[index] for index in chosen]
                chi_square = 2.0 * quadratic_form(away, self.covariance[np.ix_(chosen, chosen)])
                values = tuple(numbers[constants[place]] for place in places)
                return SimpleTogether(constants=places, values=values, odds=odds[best], chi_square=chi_square)
        return None


class Estimates:
    """Fitted constants, and the decisions on them, which are weighed once for any number of digits."""

    def __init__(self, means: FloatArray, covariance: FloatArray) -> None:
        """Take the `means` (K,) and the `covariance` of the constants."""
        self._means: Final = means
        self._covariance: Final = covariance

    @cached_property
    def considered(self) -> Considered:
        """The most probable decisions on them."""
        return Considered(decisions(self._means, self._covariance, has_products=True))

    def rounded(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> Rounding:
        """Return the constants as they are shown.

        Estimates are rounded to this many digits of their standard errors, one after another, each at its estimate
        given the earlier ones: so the last of several constants that are only determined together keeps the digits it
        needs. Simple numbers that the data single out replace estimates, except for the `estimates`, by number.
        """
        means, decision = self._means, Decision.none(self._means, self._covariance)
        covariance = decision.covariance
        considered = self.considered if len(estimates) < len(means) else Considered()
        numbers = {index: number for index, number in considered.singled_out.items() if index not in estimates}
        for index, number in numbers.items():
            decision = decision.followed(decision.open.index(index), number)
        while decision.open:
            number = _rounded(float(decision.means[0]), math.sqrt(float(decision.covariance[0, 0])), digits)
            decision = decision.followed(0, number)
        values = np.array([value for _, value in decision.numbers])
        constants = zip(range(len(means)), means, np.diag(self._covariance), strict=True)
        remarks = [_simple_number(*constant, considered.odds) for constant in constants]
        return Rounding(values, tuple(remarks), means, covariance, considered)


def find_simple(means: FloatArray, covariance: FloatArray) -> dict[int, float]:
    """Return the simple numbers that the data single out, by the number of the constant."""
    return Estimates(means, covariance).considered.singled_out


def quadratic_form(away: FloatArray, covariance: FloatArray) -> float:
    """Return by how many nats the misfit grows when constants move away (K,) from their estimates, near its minimum."""
    return 0.5 * float(away @ inverse(covariance) @ away)


def allowed_growth(means: FloatArray, covariance: FloatArray, numbers: Mapping[int, float]) -> float:
    """Return by how many nats the misfit may grow when constants, by their place, become simple `numbers`.

    By the growth that the quadratic form predicts, and by what is no evidence.
    """
    chosen = sorted(numbers)
    away = means[chosen] - [numbers[index] for index in chosen]
    return quadratic_form(away, covariance[np.ix_(chosen, chosen)]) + SETTINGS.inference.distinct_nats


def decisions(means: FloatArray, covariance: FloatArray, *, has_products: bool = False) -> list[Decision]:
    """Return the most probable decisions on constants with these `means` (K,) and `covariance`, none among them.

    With `has_products` a constant may also be what makes its product with a constant already decided a simple number.
    """
    all_decisions = beam = [Decision.none(means, covariance)]
    while beam:
        following: dict[tuple[tuple[int, float], ...], tuple[float, Decision, int, float]] = {}
        for decision in beam:
            others = [number for _, number in decision.numbers] if has_products else []
            for k in range(len(decision.open)):
                gains = _gains(float(decision.means[k]), math.sqrt(float(decision.covariance[k, k])), others)
                for number in sorted(gains, key=lambda number: -gains[number])[: SETTINGS.effort.beam]:
                    key, nats = decision.with_next(k, number), decision.nats + gains[number]
                    if key not in following or nats > following[key][0]:
                        following[key] = nats, decision, k, gains[number]
        best = sorted(following.items(), key=lambda entry: -entry[1][0])[: SETTINGS.effort.beam]
        beam = [  # of the successors of a beam few go on, and only these are made
            before.followed(k, dict(numbers)[before.open[k]], gain) for numbers, (_, before, k, gain) in best
        ]
        all_decisions = [*all_decisions, *beam]

    def of_share(simple: int) -> float:
        """Return the logarithm of the probability that so many certain constants, and no others, are simple."""
        return -math.log((len(means) + 1) * math.comb(len(means), simple))

    return [replace(decision, nats=decision.nats + of_share(len(decision.numbers))) for decision in all_decisions]


def _gains(value: float, error: float, others: Sequence[float]) -> dict[float, float]:
    """Return for the simple numbers near an estimate the nats by which each is more probable than any number.

    Numbers that are simple as factors of one of `others` are among them: they are half as probable as the others
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


def _rounded(value: float, error: float, digits: int) -> float:
    """Return `value` rounded to this many digits of its error, and to at least as many of its own."""
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


# ------------------------------------------------------------------------------------------------ simple numbers


def number_length(numerator: int, denominator: int = 1) -> float:
    """Return the length in nats of p/q times any power of ten: of p, its digits beyond the first, and q if not one."""
    digits = len(str(abs(numerator))) - 1
    return math.log1p(abs(numerator)) + _DIGIT * digits + (math.log1p(denominator) if denominator > 1 else 0.0)


def simple_numbers(value: float, error: float) -> dict[float, float]:
    """Return numbers within a few standard errors of `value`, each with its length in nats; 0 is not among them.

    The more digits the error justifies, the more are considered, for decimals one digit more.

    Args:
        value: not 0.
        error: its standard error.
    """
    if value != 0.0 and not 1.0 / _LARGE < abs(value) < _LARGE:
        scale = _LARGE**0.5 if abs(value) < 1.0 else _LARGE**-0.5
        near = simple_numbers(value * scale, error * scale).items()
        return {
            quotient: length
            for number, length in near
            if (quotient := number / scale) != 0.0 and math.isfinite(quotient)
        }
    lengths: dict[float, float] = {}
    for unit, digits, price in ((1.0, sys.float_info.dig, 0.0), (math.pi, _DIGITS_OF_PI, SETTINGS.regression.pi_nats)):
        for denominator in SETTINGS.regression.denominators:
            for number, numerator in _near(value, error, denominator, unit, digits):
                length = number_length(numerator, denominator) + price
                lengths[number] = min(length, lengths.get(number, math.inf))
    return lengths


def continuum_density(value: float) -> float:
    """Return the probability of any number per unit at `value`, when each decade is as probable as by simple numbers.

    Simple numbers of length L have the probability e^-L, up to a common factor; the sum of the probabilities between
    two powers of ten, the same for all, is spread evenly over the logarithm of that decade.
    """
    return _probability_of_decade() / math.log(10.0) / abs(value)


@cache
def _probability_of_decade() -> float:
    """Return the sum of e^-L over the simple numbers between a power of ten and ten times that, pi left out."""
    lengths: dict[str, float] = {}
    rest = 0.0
    for denominator in SETTINGS.regression.denominators:
        for numerator in range(1, 10**_SHORT):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                digits = f"{numerator / denominator:.12e}".split("e")[0]
                lengths[digits] = min(number_length(numerator, denominator), lengths.get(digits, math.inf))
        recurs = 10 * denominator
        share = sum(residue % 10 > 0 and math.gcd(residue, denominator) == 1 for residue in range(recurs)) / recurs
        of_digits = share * math.log(10.0) * math.exp(number_length(0) - number_length(0, denominator))
        rest += sum(of_digits * math.exp(-_DIGIT * more) for more in range(_SHORT, sys.float_info.dig))
    return rest + sum(math.exp(-length) for length in lengths.values())


def _near(value: float, error: float, denominator: int, unit: float, digits: int) -> Iterator[tuple[float, int]]:
    """Yield multiples of `unit` by p/q times powers of ten near `value`, with at most this many digits in p."""
    if value == 0.0:
        return
    beside = SETTINGS.regression.numerators_beside
    reach = max(SETTINGS.regression.rounding_reach * error, abs(value) * 4.0 * 2.0**-52)
    size, scale = value / unit * denominator, denominator / unit
    finest = max(error if scale != 1.0 else error / 10.0, abs(value) * 10.0**-sys.float_info.dig) * scale
    first = math.floor(math.log10(abs(size))) + 1
    for exponent in range(first, max(first - digits, -300) - 1, -1):
        step = 10.0**exponent
        if step < 0.999 * finest:  # not equal by chance of rounding in another unit
            return
        nearest, around = round(size / step), beside if reach * scale > 0.25 * step else 0
        if abs(nearest * step - size) > 2.0 * reach * scale:
            continue
        for numerator in range(nearest - around, nearest + around + 1):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                number = _ratio(numerator, denominator, exponent) * unit
                if abs(number - value) <= reach:
                    yield number, numerator


def _ratio(numerator: int, denominator: int, exponent: int) -> float:
    """Return p/q times a power of ten as the nearest number that there is."""
    return float(numerator * 10 ** max(exponent, 0) / (denominator * 10 ** max(-exponent, 0)))
