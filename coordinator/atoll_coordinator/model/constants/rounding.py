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

All fits round by this module: to a target, to trajectories, to the steps of a process.
"""

import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Final

import numpy as np

from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.result.equations import SimpleNumber, SimpleTogether
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.restrictions import Restrictions
from atoll_core.expression.writing.shortest import collected

ERROR_DIGITS: Final = tuple(1 + 2**power for power in range(5))
"""Digits of standard errors to which estimates may be rounded, at last all of a double: the first number of digits with
which simulations stay as they are is taken. With two, estimates are off by at most a twentieth of a standard error."""
_ROUNDING: Final = 2.0**-50
"""Standard errors below this share of a constant are rounding errors."""
_DIGIT: Final = math.log(3.0)
"""Nats of each digit beyond the first, in addition to the nats of the whole number."""
_SHORT: Final = 3
"""For numerators with more digits, the sum of probabilities is replaced by an integral."""
_REACH: Final = 4.0
"""Simple numbers are considered within this many standard errors of a constant: others have no weight."""
_BESIDE: Final = 2
"""Numerators on either side of the nearest that are considered: others are far less probable."""
_DIGITS_OF_PI: Final = 2
"""Digits of multiples of pi: with more, they would say less than a decimal of the same size."""
_LARGE: Final = 1e200
"""Numbers beyond, or below its inverse, are not simple: powers of ten would overflow."""


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


class Estimates:
    """Fitted constants, and the decisions on them, which are weighed once for any number of digits."""

    def __init__(self, means: FloatArray, covariance: FloatArray) -> None:
        """Take the `means` (K,) and the `covariance` of the constants."""
        self.count: Final = len(means)
        self._open: Final = Decision.none(means, covariance)
        self._errors: Final = np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @cached_property
    def _weighed(self) -> list[tuple[dict[int, float], float]]:
        """The simple numbers of the most probable decisions, with their weights; none of too many constants."""
        compared = decisions(self._open) if self.count <= SETTINGS.effort.beam else []
        most = max((decision.nats for decision in compared), default=0.0)
        return [(dict(decision.numbers), math.exp(decision.nats - most)) for decision in compared]

    def _odds_of(self, numbers: Mapping[int, float]) -> float:
        """Return the odds of the decisions that have these simple numbers against all others."""
        weights = [weight for decided, weight in self._weighed if numbers.items() <= decided.items()]
        share = math.fsum(weights)
        return share / max(math.fsum(weight for _, weight in self._weighed) - share, 1e-300)

    @cached_property
    def odds(self) -> dict[tuple[int, float], float]:
        """The odds of each number of each constant against all decisions without it."""
        found = dict.fromkeys(number for decided, _ in self._weighed for number in decided.items())
        return {number: self._odds_of(dict([number])) for number in found}

    @property
    def singled_out(self) -> dict[int, float]:
        """The simple numbers that the data single out, by the number of the constant."""
        least = math.exp(SETTINGS.inference.distinct_nats)
        return {index: value for (index, value), odds in self.odds.items() if odds >= least}

    @cached_property
    def simple(self) -> tuple[SimpleNumber | None, ...]:
        """The most probable simple number near each constant; None where none was considered."""
        found: list[SimpleNumber | None] = []
        for index, (mean, error) in enumerate(zip(self._open.means.tolist(), self._errors.tolist(), strict=True)):
            near = {number: odds for (constant, number), odds in self.odds.items() if constant == index}
            number = max(near, key=near.__getitem__, default=0.0)
            away = abs(number - mean) / error if error > 0.0 else 0.0
            found.append(SimpleNumber(value=number, odds=near[number], standard_errors=away) if near else None)
        return tuple(found)

    def together(self, constants: Sequence[int]) -> SimpleTogether | None:
        """Return simple numbers of two and more of these constants that are right together; None if that is unlikely.

        The largest combination that the data single out, else the largest that is likelier than all others together.
        Its places are indices of `constants`.
        """
        combinations = dict.fromkeys(
            tuple(number for number in decided.items() if number[0] in constants) for decided, _ in self._weighed
        )
        odds = {numbers: self._odds_of(dict(numbers)) for numbers in combinations if len(numbers) > 1}
        for least in (math.exp(SETTINGS.inference.distinct_nats), 1.0):
            likely = [numbers for numbers in odds if odds[numbers] >= least]
            if likely:
                best = max(likely, key=lambda numbers: (len(numbers), odds[numbers]))
                chosen = dict(best)
                places = tuple(place for place, index in enumerate(constants) if index in chosen)
                values = tuple(chosen[constants[place]] for place in places)
                chi_square = 2.0 * self.growth(chosen)
                return SimpleTogether(constants=places, values=values, odds=odds[best], chi_square=chi_square)
        return None

    def growth(self, numbers: Mapping[int, float]) -> float:
        """Return by how many nats the misfit grows, near its minimum, when constants, by number, become `numbers`."""
        chosen = sorted(numbers)
        away = self._open.means[chosen] - [numbers[index] for index in chosen]
        return quadratic_form(away, self._open.covariance[np.ix_(chosen, chosen)])

    def rounded(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> FloatArray:
        """Return the constants (K,) as they are shown.

        Estimates are rounded to this many digits of their standard errors, one after another, each at its estimate
        given the earlier ones: so the last of several constants that are only determined together keeps the digits it
        needs. Simple numbers that the data single out replace estimates, except for the `estimates`, by number.
        """
        decision = self._open
        for index, number in self.singled_out.items():
            if index not in estimates:
                decision = decision.followed(decision.open.index(index), number)
        while decision.open:
            number = _rounded(float(decision.means[0]), math.sqrt(float(decision.covariance[0, 0])), digits)
            decision = decision.followed(0, number)
        return np.array([value for _, value in decision.numbers])


@dataclass(frozen=True, eq=False)
class RoundedEquations:
    """The equations with constants as they are shown; `simple` has for each of its constants the nearest simple number.

    `together` has the joint odds of the simple numbers shown in each equation, empty if these were not judged. A given
    equation has none.
    """

    programs: tuple[Program, ...]
    simple: tuple[tuple[SimpleNumber | None, ...], ...]
    together: tuple[SimpleTogether | None, ...] = ()


@dataclass(frozen=True, eq=False)
class FittedEquations:
    """Equations with fitted constants, of whichever fit, and the `estimates` of the fitted numbers (Q,).

    The constants of `given` equations were not fitted; others keep to their `restrictions`. Constant p of the others is
    the number `columns[p]` times `multiples[p]`, one after another by default. Estimates are rounded, simple numbers
    found once for any number of digits.
    """

    programs: Sequence[Program]
    estimates: Estimates
    restrictions: Sequence[Restrictions]
    given: Collection[int] = ()
    columns: Ints | None = None
    multiples: FloatArray | None = None

    def simplified(self, growth: Callable[[Sequence[Program]], float]) -> tuple[Program, ...]:
        """Return the programs with those constants simple that the data single out, neutral ones left out.

        As they are where there are too many, or where simple ones describe the data less well than they should.

        Args:
            growth: by how many nats the misfit of programs with these constants is larger than the fitted one.
        """
        numbers = self.estimates.singled_out
        simple = self.rounded(ERROR_DIGITS[-1]).programs if numbers else ()
        if not simple or growth(simple) > self.estimates.growth(numbers) + SETTINGS.inference.distinct_nats:
            return tuple(self.programs)
        return tuple(
            program if equation in self.given else collected(program) for equation, program in enumerate(simple)
        )

    def rounded(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> RoundedEquations:
        """Return the equations with constants as they are shown.

        Args:
            digits: number of digits of the standard errors to which estimates are rounded.
            estimates: fitted numbers, by index, that stay estimates although a simple number is singled out.
        """
        rounded, near = self.estimates.rounded(digits, estimates), self.estimates.simple
        columns = (np.arange(self.estimates.count) if self.columns is None else self.columns).tolist()
        multiples = (np.ones(len(columns)) if self.multiples is None else self.multiples).tolist()
        programs, simple, together, first = [], [], [], 0
        for equation, (program, restrictions) in enumerate(zip(self.programs, self.restrictions, strict=True)):
            places = [] if equation in self.given else constant_places(program)
            numbers, by = (values[first : first + len(places)] for values in (columns, multiples))
            first += len(places)
            values = [_tidied(*pair) for pair in zip(by, rounded[numbers].tolist(), strict=True)]
            moved = with_constants(program, dict(zip(places, values, strict=True)))
            programs.append(moved if restrictions.bounds is None else restrictions.bounds.clipped(moved))
            simple.append(tuple(_times(near[k], multiple) for k, multiple in zip(numbers, by, strict=True)))
            together.append(_together(self.estimates.together(numbers), by))
        return RoundedEquations(tuple(programs), tuple(simple), tuple(together))


def _together(together: SimpleTogether | None, multiples: Sequence[float]) -> SimpleTogether | None:
    """Return the joint odds of simple numbers, given how many times its number each constant is."""
    if together is None:
        return None
    pairs = zip(together.constants, together.values, strict=True)
    return together.replaced(values=tuple(_tidied(multiples[place], value or 0.0) for place, value in pairs))


def _times(number: SimpleNumber | None, multiple: float) -> SimpleNumber | None:
    return None if number is None else number.replaced(value=_tidied(multiple, number.value or 0.0))


def _tidied(multiple: float, value: float) -> float:
    """Return the multiple of a decimal as a decimal."""
    return value if multiple == 1.0 else float(f"{multiple * value:.{sys.float_info.dig}g}")


def quadratic_form(away: FloatArray, covariance: FloatArray) -> float:
    """Return by how many nats the misfit grows when constants move away (K,) from their estimates, near its minimum."""
    return 0.5 * float(away @ inverse(covariance) @ away)


def decisions(none: Decision) -> list[Decision]:
    """Return the most probable decisions on constants, that on `none` among them.

    A constant may also be what makes its product with a constant already decided a simple number.
    """
    count = len(none.open)
    all_decisions = beam = [none]
    while beam:
        following: dict[tuple[tuple[int, float], ...], tuple[float, Decision, int, float]] = {}
        for decision in beam:
            others = [number for _, number in decision.numbers]
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
        return -math.log((count + 1) * math.comb(count, simple))

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
    if not 1.0 / _LARGE < abs(value) < _LARGE:
        return {}
    lengths: dict[float, float] = {}
    for unit, digits, price in ((1.0, sys.float_info.dig, 0.0), (math.pi, _DIGITS_OF_PI, number_length(31))):
        for denominator in SETTINGS.inference.denominators:
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
    for denominator in SETTINGS.inference.denominators:
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
    reach = max(_REACH * error, abs(value) * 4.0 * 2.0**-52)
    size, scale = value / unit * denominator, denominator / unit
    finest = max(error if scale != 1.0 else error / 10.0, abs(value) * 10.0**-sys.float_info.dig) * scale
    first = math.floor(math.log10(abs(size))) + 1
    for exponent in range(first, max(first - digits, -300) - 1, -1):
        step = 10.0**exponent
        if step < 0.999 * finest:  # not equal by chance of rounding in another unit
            return
        nearest, around = round(size / step), _BESIDE if reach * scale > 0.25 * step else 0
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
