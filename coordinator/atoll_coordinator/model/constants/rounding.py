"""Constants as they are shown: simple numbers if the data support them, or else estimates with few digits.

`search_decisions` computes the odds of simple numbers, and `Estimates.accepted_numbers` decides which simple numbers
replace estimates. `FittedEquations.accept_simple_numbers` and `FittedEquations.round_equations` write the accepted
numbers into the equations.

*Simple numbers.* A simple number is p/q times a power of ten, or pi times such a number; p and q are whole numbers, and
q is small. Whole numbers and short decimals have q = 1. Each simple number has a length in nats, the price of its
digits and its denominator (`number_length`). A number and ten times this number have the same length, so the choice of
a unit hardly matters.

*One constant.* The constant is either a simple number or an arbitrary number; both cases have the same prior
probability. A simple number of length L has the prior probability e^-L. Near its minimum the misfit is a quadratic form
of the constants, so the effect of each decision is known. Constants are decided one after another. For each constant, a
few simple numbers near its estimate are tried; the estimate depends on the earlier decisions. Only a beam of the most
probable decisions is kept (sequential decoding, as in integer least squares). The odds of a simple number are the odds
against all decisions without it. It replaces an estimate if the logarithm of these odds is at least
`InferenceSettings.distinct_nats`.

*All constants together.* The share of simple constants is not known, and every share has the same prior probability. So
the probability that m particular constants of K are simple, and the others are not, is m! (K - m)!/(K + 1)! (Laplace's
rule of succession). So each simple constant makes further simple constants more probable, and each constant that is not
simple makes them less probable. The product of a constant and a constant that is already decided may also be simple:
0.9 (c + f) with c = 0.1111 is 0.1 + 0.9 f after expansion.

*Doubtful.* The lengths are a convention: another law may really have an unusual constant that lies near a simple
number. The quadratic form is only valid near the minimum, so `FittedEquations.accept_simple_numbers` measures the
misfit again and keeps the estimates if the misfit grows more than predicted. The beam may miss the most probable
decision. With more constants than `SETTINGS.effort.beam`, no constant becomes simple.
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
"""Numbers of digits that are tried. An estimate is rounded to this number of digits of its standard error; the last
number keeps all digits of a double. The smallest number with which simulations do not change is used. With two digits,
the rounding error is at most 1/20 of a standard error."""
_ROUNDING_ERROR: Final = 2.0**-50
"""Standard errors below this share of a constant are rounding errors."""
_NATS_PER_DIGIT: Final = math.log(3.0)
"""Nats for each digit beyond the first, in addition to the nats of the whole number."""
_MOST_ENUMERATED_DIGITS: Final = 3
"""For numerators with more digits, the sum of probabilities is replaced by an integral."""
_MOST_STANDARD_ERRORS: Final = 4.0
"""Simple numbers are considered within this many standard errors of a constant: the probability of other simple numbers
is negligible."""
_NUMERATORS_EACH_SIDE: Final = 2
"""Number of numerators that are tried on either side of the nearest numerator: other numerators are far less
probable."""
_DIGITS_OF_PI: Final = 2
"""Most digits of multiples of pi: with more digits, a decimal of the same size would be as simple."""
_LARGEST_NUMBER: Final = 1e200
"""Numbers above this value, or below its inverse, are not simple: powers of ten would overflow."""


@dataclass(frozen=True, eq=False)
class Decision:
    """Decisions that some constants are simple numbers, and the estimates of the other constants.

    `numbers` has the index of each decided constant, in node order, and its simple number. `undecided` has the indices
    of the U other constants. `means` (U,) are the estimates of these constants, and `covariance` (U, U) is their
    covariance, both under the condition of the decisions. `nats` is the log odds of these simple numbers against
    arbitrary numbers.
    """

    numbers: tuple[tuple[int, float], ...]
    nats: float
    undecided: tuple[int, ...]
    means: FloatArray
    covariance: FloatArray

    @classmethod
    def start(cls, means: FloatArray, covariance: FloatArray) -> "Decision":
        """Return the state before any decision. Variances are at least the variances of rounding errors."""
        least = np.maximum((_ROUNDING_ERROR * means) ** 2, np.finfo(np.float64).tiny)
        spread = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
        return cls((), 0.0, tuple(range(len(means))), means, spread)

    def numbers_with(self, k: int, number: float) -> tuple[tuple[int, float], ...]:
        """Return the decided numbers together with `number` for the k-th undecided constant."""
        return tuple(sorted((*self.numbers, (self.undecided[k], number))))

    def decide(self, k: int, number: float, nats: float = 0.0) -> "Decision":
        """Decide that the k-th undecided constant is `number`; the estimates of the other constants follow."""
        others = [place for place in range(len(self.undecided)) if place != k]
        column, variance = self.covariance[others, k], float(self.covariance[k, k])
        rest = self.covariance[np.ix_(others, others)]
        spread = rest - np.outer(column, column) / variance
        diagonal, least = np.diag(spread), np.maximum(_ROUNDING_ERROR * np.diag(rest), np.finfo(np.float64).tiny)
        means = self.means[others] + column / variance * (number - float(self.means[k]))
        return Decision(
            numbers=self.numbers_with(k, number),
            nats=self.nats + nats,
            undecided=tuple(self.undecided[place] for place in others),
            means=means,
            covariance=spread + np.diag(np.maximum(np.maximum((_ROUNDING_ERROR * means) ** 2, least) - diagonal, 0.0)),
        )


class Estimates:
    """Fitted constants, and the decisions on them. The odds of decisions are computed once, and used for every number
    of digits."""

    def __init__(self, means: FloatArray, covariance: FloatArray) -> None:
        """Set the `means` (K,) and the `covariance` (K, K) of the constants."""
        self.count: Final = len(means)
        self._start: Final = Decision.start(means, covariance)
        self._errors: Final = np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @cached_property
    def _weighted_decisions(self) -> list[tuple[dict[int, float], float]]:
        """The simple numbers of the most probable decisions, with their relative probabilities; empty if there are too
        many constants."""
        compared = search_decisions(self._start) if self.count <= SETTINGS.effort.beam else []
        most = max((decision.nats for decision in compared), default=0.0)
        return [(dict(decision.numbers), math.exp(decision.nats - most)) for decision in compared]

    def _odds_of_numbers(self, numbers: Mapping[int, float]) -> float:
        """Return the odds of the decisions that have these simple numbers against all other decisions."""
        weights = [weight for decided, weight in self._weighted_decisions if numbers.items() <= decided.items()]
        share = math.fsum(weights)
        return share / max(math.fsum(weight for _, weight in self._weighted_decisions) - share, 1e-300)

    @cached_property
    def odds(self) -> dict[tuple[int, float], float]:
        """The odds of each simple number of each constant against all decisions without this number."""
        found = dict.fromkeys(number for decided, _ in self._weighted_decisions for number in decided.items())
        return {number: self._odds_of_numbers(dict([number])) for number in found}

    @property
    def accepted_numbers(self) -> dict[int, float]:
        """The simple numbers whose odds are high enough to replace the estimates, by the index of the constant."""
        least = math.exp(SETTINGS.inference.distinct_nats)
        return {index: value for (index, value), odds in self.odds.items() if odds >= least}

    @cached_property
    def simple(self) -> tuple[SimpleNumber | None, ...]:
        """The most probable simple number near each constant; None if no simple number was considered."""
        found: list[SimpleNumber | None] = []
        for index, (mean, error) in enumerate(zip(self._start.means.tolist(), self._errors.tolist(), strict=True)):
            near = {number: odds for (constant, number), odds in self.odds.items() if constant == index}
            number = max(near, key=near.__getitem__, default=0.0)
            away = abs(number - mean) / error if error > 0.0 else 0.0
            found.append(SimpleNumber(value=number, odds=near[number], standard_errors=away) if near else None)
        return tuple(found)

    def joint_simple_numbers(self, constants: Sequence[int]) -> SimpleTogether | None:
        """Return a combination of simple numbers, for two or more of these constants, that is likely as a whole; None
        if there is none.

        It is the largest combination whose odds are high enough to replace estimates. If there is no such combination,
        it is the largest combination with odds of at least one. The places in the result are indices of `constants`.
        """
        combinations = dict.fromkeys(
            tuple(number for number in decided.items() if number[0] in constants)
            for decided, _ in self._weighted_decisions
        )
        odds = {numbers: self._odds_of_numbers(dict(numbers)) for numbers in combinations if len(numbers) > 1}
        for least in (math.exp(SETTINGS.inference.distinct_nats), 1.0):
            likely = [numbers for numbers in odds if odds[numbers] >= least]
            if likely:
                best = max(likely, key=lambda numbers: (len(numbers), odds[numbers]))
                chosen = dict(best)
                places = tuple(place for place, index in enumerate(constants) if index in chosen)
                values = tuple(chosen[constants[place]] for place in places)
                chi_square = 2.0 * self.misfit_increase(chosen)
                return SimpleTogether(constants=places, values=values, odds=odds[best], chi_square=chi_square)
        return None

    def misfit_increase(self, numbers: Mapping[int, float]) -> float:
        """Return the increase of the misfit in nats, near its minimum, if constants (by index) are set to `numbers`."""
        chosen = sorted(numbers)
        away = self._start.means[chosen] - [numbers[index] for index in chosen]
        return quadratic_misfit_increase(away, self._start.covariance[np.ix_(chosen, chosen)])

    def round_values(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> FloatArray:
        """Return the constants (K,) as they are shown.

        Estimates are rounded to `digits` digits of their standard errors, one after another. Before an estimate is
        rounded, it moves to its best value for the constants that are already rounded. So if the data determine several
        constants only jointly, the last of them keeps the digits that it needs. Accepted simple numbers replace
        estimates, except for the constants `estimates`, by index.
        """
        decision = self._start
        for index, number in self.accepted_numbers.items():
            if index not in estimates:
                decision = decision.decide(decision.undecided.index(index), number)
        while decision.undecided:
            number = _round_to_error(float(decision.means[0]), math.sqrt(float(decision.covariance[0, 0])), digits)
            decision = decision.decide(0, number)
        return np.array([value for _, value in decision.numbers])


@dataclass(frozen=True, eq=False)
class RoundedEquations:
    """The equations with constants as they are shown.

    `simple` has the nearest simple number of each constant of each equation; it is empty for an equation that the user
    gave. `together` has the joint odds of the simple numbers of each equation; it is empty if these odds were not
    computed. `parameters` are the values of the parameters of a template, which are rounded, but never replaced by
    simple numbers.
    """

    programs: tuple[Program, ...]
    simple: tuple[tuple[SimpleNumber | None, ...], ...]
    together: tuple[SimpleTogether | None, ...] = ()
    parameters: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FittedEquations:
    """Equations with fitted constants, from any fit, and the `estimates` of the fitted numbers (Q,).

    The constants of the equations `given`, by index, were not fitted. The other equations obey their `restrictions`.
    Constant p of the other equations is fitted number `columns[p]` times `multiples[p]`; by default it is fitted number
    p. Further elements of `columns` belong to the parameters of a template.
    """

    programs: Sequence[Program]
    estimates: Estimates
    restrictions: Sequence[Restrictions]
    given: Collection[int] = ()
    columns: Ints | None = None
    multiples: FloatArray | None = None

    def accept_simple_numbers(self, misfit_increase: Callable[[Sequence[Program]], float]) -> tuple[Program, ...]:
        """Return the programs with accepted simple numbers as constants. Terms that become zero and factors that become
        one are dropped.

        The programs are unchanged if no simple number is accepted, or if the misfit grows by more than the quadratic
        form predicts plus `InferenceSettings.distinct_nats`.

        Args:
            misfit_increase: returns the misfit of programs in nats minus the misfit of the fitted programs.
        """
        numbers = {
            number: value for number, value in self.estimates.accepted_numbers.items() if number not in self._parameters
        }
        simple = self.round_equations(ERROR_DIGITS[-1]).programs if numbers else ()
        if (
            not simple
            or not self._have_shapes(simple)
            or misfit_increase(simple) > self.estimates.misfit_increase(numbers) + SETTINGS.inference.distinct_nats
        ):
            return tuple(self.programs)
        return tuple(
            program if equation in self.given else collected(program) for equation, program in enumerate(simple)
        )

    def round_equations(self, digits: int = ERROR_DIGITS[0], estimates: Collection[int] = ()) -> RoundedEquations:
        """Return the equations with constants as they are shown.

        Args:
            digits: number of digits of the standard errors to which estimates are rounded.
            estimates: indices of the fitted numbers that remain estimates, even if a simple number is accepted.
        """
        kept = {*estimates, *self._parameters}
        rounded, near = self.estimates.round_values(digits, kept), self.estimates.simple
        columns = (np.arange(self.estimates.count) if self.columns is None else self.columns).tolist()
        multiples = (np.ones(len(columns)) if self.multiples is None else self.multiples).tolist()
        programs, simple, together, first = [], [], [], 0
        for equation, (program, restrictions) in enumerate(zip(self.programs, self.restrictions, strict=True)):
            places = [] if equation in self.given else constant_places(program)
            numbers, by = (values[first : first + len(places)] for values in (columns, multiples))
            first += len(places)
            values = [_decimal_product(*pair) for pair in zip(by, rounded[numbers].tolist(), strict=True)]
            moved = with_constants(program, dict(zip(places, values, strict=True)))
            moved = moved if restrictions.bounds is None else restrictions.bounds.clipped(moved)
            programs.append(moved if restrictions.has_shapes(moved) else program)
            simple.append(tuple(_scale_number(near[k], multiple) for k, multiple in zip(numbers, by, strict=True)))
            together.append(_scale_joint_numbers(self.estimates.joint_simple_numbers(numbers), by))
        parameters = rounded[columns[first:]] if len(columns) > first else None
        return RoundedEquations(tuple(programs), tuple(simple), tuple(together), parameters)

    def _have_shapes(self, programs: Sequence[Program]) -> bool:
        """Tell whether all equations have their demanded shapes."""
        return all(
            restrictions.has_shapes(program) for program, restrictions in zip(programs, self.restrictions, strict=True)
        )

    @property
    def _parameters(self) -> list[int]:
        """The indices of the fitted numbers that are parameters of a template."""
        searched = sum(
            len(constant_places(program)) for place, program in enumerate(self.programs) if place not in self.given
        )
        return [] if self.columns is None else self.columns[searched:].tolist()


def _scale_joint_numbers(together: SimpleTogether | None, multiples: Sequence[float]) -> SimpleTogether | None:
    """Return `together` with each simple number multiplied by the element of `multiples` for its constant (the ratio of
    the constant to its fitted number)."""
    if together is None:
        return None
    pairs = zip(together.constants, together.values, strict=True)
    return together.replaced(values=tuple(_decimal_product(multiples[place], value or 0.0) for place, value in pairs))


def _scale_number(number: SimpleNumber | None, multiple: float) -> SimpleNumber | None:
    return None if number is None else number.replaced(value=_decimal_product(multiple, number.value or 0.0))


def _decimal_product(multiple: float, value: float) -> float:
    """Return the product, rounded to the digits of a double so that a decimal stays a short decimal."""
    return value if multiple == 1.0 else float(f"{multiple * value:.{sys.float_info.dig}g}")


def quadratic_misfit_increase(away: FloatArray, covariance: FloatArray) -> float:
    """Return the increase of the misfit in nats, near its minimum, if constants are shifted by `away` (K,)."""
    return 0.5 * float(away @ inverse(covariance) @ away)


def search_decisions(start: Decision) -> list[Decision]:
    """Return the most probable decisions on constants, found by a beam search.

    The result includes `start`, the state without a decision. Instead of a constant itself, the product of this
    constant and a constant that is already decided may be simple.
    """
    count = len(start.undecided)
    all_decisions = beam = [start]
    while beam:
        following: dict[tuple[tuple[int, float], ...], tuple[float, Decision, int, float]] = {}
        for decision in beam:
            others = [number for _, number in decision.numbers]
            for k in range(len(decision.undecided)):
                gains = _simple_number_gains(
                    float(decision.means[k]), math.sqrt(float(decision.covariance[k, k])), others
                )
                for number in sorted(gains, key=lambda number: -gains[number])[: SETTINGS.effort.beam]:
                    key, nats = decision.numbers_with(k, number), decision.nats + gains[number]
                    if key not in following or nats > following[key][0]:
                        following[key] = nats, decision, k, gains[number]
        best = sorted(following.items(), key=lambda entry: -entry[1][0])[: SETTINGS.effort.beam]
        beam = [  # few successors stay in the beam, and only these are created
            before.decide(k, dict(numbers)[before.undecided[k]], gain) for numbers, (_, before, k, gain) in best
        ]
        all_decisions = [*all_decisions, *beam]

    def log_prior_of_count(simple: int) -> float:
        """Return the log probability that this many particular constants are simple, and all others are not."""
        return -math.log((count + 1) * math.comb(count, simple))

    return [
        replace(decision, nats=decision.nats + log_prior_of_count(len(decision.numbers))) for decision in all_decisions
    ]


def _simple_number_gains(value: float, error: float, others: Sequence[float]) -> dict[float, float]:
    """Return the simple numbers near an estimate, with their log odds (nats) against an arbitrary number.

    A number also counts as simple if its product with one of `others` is simple. Such numbers have half the prior
    probability of numbers that are simple themselves. They are only tried if no number that is simple itself is more
    probable than an arbitrary number.
    """
    if value == 0.0 or not math.isfinite(value) or not math.isfinite(error):  # no number is near
        return {}
    least = math.log(error * math.sqrt(2.0 * math.pi)) + math.log(continuum_density(value))
    own = _log_odds(simple_numbers(value, error), value, error, least)
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
        for product, nats in _log_odds(numbers, value * factor, error * factor, price).items():
            gains[product / factor] = max(nats, gains.get(product / factor, -math.inf))
    return gains


def _log_odds(numbers: Mapping[float, float], value: float, error: float, least: float) -> dict[float, float]:
    """Return the log probabilities (nats) of simple numbers with these lengths near an estimate, minus `least`."""
    return {number: -length - 0.5 * ((number - value) / error) ** 2 - least for number, length in numbers.items()}


def _round_to_error(value: float, error: float, digits: int) -> float:
    """Return `value` rounded to this many digits of its error. At least this many significant digits are kept."""
    if value == 0.0 or not math.isfinite(value):
        return value
    size = min(error, abs(value)) if error > 0.0 else abs(value)
    places = math.floor(math.log10(abs(value))) - math.floor(math.log10(size)) + digits
    return float(f"{value:.{min(places, sys.float_info.dig) - 1}e}") if places < 17 else value


# ------------------------------------------------------------------------------------------------ simple numbers


def number_length(numerator: int, denominator: int = 1) -> float:
    """Return the length in nats of p/q times any power of ten: the sum of the price of p, the price of each further
    digit of p, and the price of q if q > 1."""
    digits = len(str(abs(numerator))) - 1
    return math.log1p(abs(numerator)) + _NATS_PER_DIGIT * digits + (math.log1p(denominator) if denominator > 1 else 0.0)


def simple_numbers(value: float, error: float) -> dict[float, float]:
    """Return simple numbers within a few standard errors of `value`, each with its length in nats. The number 0 is
    excluded.

    The number of digits follows from the error; decimals may have one digit more.

    Args:
        value: not 0.
        error: its standard error.
    """
    if not 1.0 / _LARGEST_NUMBER < abs(value) < _LARGEST_NUMBER:
        return {}
    lengths: dict[float, float] = {}
    for unit, digits, price in ((1.0, sys.float_info.dig, 0.0), (math.pi, _DIGITS_OF_PI, number_length(31))):
        for denominator in SETTINGS.inference.denominators:
            for number, numerator in _find_numbers_near(value, error, denominator, unit, digits):
                length = number_length(numerator, denominator) + price
                lengths[number] = min(length, lengths.get(number, math.inf))
    return lengths


def continuum_density(value: float) -> float:
    """Return the prior probability density of an arbitrary number at `value`.

    A simple number of length L has the probability e^-L, up to a common factor. The sum of these probabilities over one
    decade is the same for all decades. Arbitrary numbers in the decade have the same total probability, and the density
    of their logarithm is uniform.
    """
    return _decade_probability() / math.log(10.0) / abs(value)


@cache
def _decade_probability() -> float:
    """Return the sum of e^-L over the simple numbers of one decade, without multiples of pi."""
    lengths: dict[str, float] = {}
    rest = 0.0
    for denominator in SETTINGS.inference.denominators:
        for numerator in range(1, 10**_MOST_ENUMERATED_DIGITS):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                digits = f"{numerator / denominator:.12e}".split("e")[0]
                lengths[digits] = min(number_length(numerator, denominator), lengths.get(digits, math.inf))
        recurs = 10 * denominator
        share = sum(residue % 10 > 0 and math.gcd(residue, denominator) == 1 for residue in range(recurs)) / recurs
        of_digits = share * math.log(10.0) * math.exp(number_length(0) - number_length(0, denominator))
        rest += sum(
            of_digits * math.exp(-_NATS_PER_DIGIT * more) for more in range(_MOST_ENUMERATED_DIGITS, sys.float_info.dig)
        )
    return rest + sum(math.exp(-length) for length in lengths.values())


def _find_numbers_near(
    value: float, error: float, denominator: int, unit: float, digits: int
) -> Iterator[tuple[float, int]]:
    """Yield multiples of `unit` by p/q times powers of ten near `value`, with at most this many digits in p."""
    reach = max(_MOST_STANDARD_ERRORS * error, abs(value) * 4.0 * 2.0**-52)
    size, scale = value / unit * denominator, denominator / unit
    finest = max(error if scale != 1.0 else error / 10.0, abs(value) * 10.0**-sys.float_info.dig) * scale
    first = math.floor(math.log10(abs(size))) + 1
    for exponent in range(first, max(first - digits, -300) - 1, -1):
        step = 10.0**exponent
        if step < 0.999 * finest:  # tolerance for rounding errors
            return
        nearest, around = round(size / step), _NUMERATORS_EACH_SIDE if reach * scale > 0.25 * step else 0
        if abs(nearest * step - size) > 2.0 * reach * scale:
            continue
        for numerator in range(nearest - around, nearest + around + 1):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                number = _nearest_float(numerator, denominator, exponent) * unit
                if abs(number - value) <= reach:
                    yield number, numerator


def _nearest_float(numerator: int, denominator: int, exponent: int) -> float:
    """Return the double nearest to p/q times a power of ten."""
    return float(numerator * 10 ** max(exponent, 0) / (denominator * 10 ** max(-exponent, 0)))
