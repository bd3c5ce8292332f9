"""Constants as they are shown: simple numbers where the data single them out, else estimates with few digits.

A constant is either a simple number, one of length L with the probability e^-L, or any number of the same
neighbourhood; before the data both are as likely (`simple_numbers`). Near its minimum the misfit is a quadratic form of
the constants, so that what the data say of each of these decisions is known: constants are decided one after another,
each by a few simple numbers near where it lies once the earlier ones are fixed, and a beam of the most probable
decisions is kept (a sequential decoding, as in integer least squares). A simple number takes the place of an estimate
when its odds, against all other decisions together, are at least those of `InferenceSettings.distinct_nats`.
"""

import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import Program, constant_places, with_constants
from atoll.expression.writing.shortest import collected
from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.refinement import SimpleNumber
from atoll_coordinator.model.regression.covariance import covariance_of, description_length, standard_errors
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.simple_numbers import continuum_density, fitted_length, simple_numbers
from atoll_coordinator.settings import SETTINGS

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
class Rounding:
    """What becomes of constants: their `values` (K,) as they are shown, and the nearest simple number of each."""

    values: FloatArray
    simple: tuple[SimpleNumber | None, ...]


def round_estimates(
    means: FloatArray,
    covariance: FloatArray,
    digits: int = ERROR_DIGITS[0],
    estimates: Collection[int] = (),
) -> Rounding:
    """Return fitted constants, `means` (K,) with this `covariance`, as they are shown.

    Estimates are rounded to so many digits of their standard errors, one after another, each where it lies once the
    earlier ones are: so the last of several constants that only together are determined keeps the digits it needs.
    Simple numbers that are singled out take their place, but for those of the `estimates`, by number.
    """
    is_open = len(estimates) < len(means)
    numbers, odds = _singled_out(means, covariance) if is_open else ({}, {})
    numbers = {index: number for index, number in numbers.items() if index not in estimates}
    decision = _start(means, covariance)
    for index, number in numbers.items():
        decision = _decided(decision, decision.open.index(index), number, 0.0)
    while decision.open:
        number = _rounded(float(decision.means[0]), math.sqrt(float(decision.covariance[0, 0])), digits)
        decision = _decided(decision, 0, number, 0.0)
    values = np.array([value for _, value in decision.numbers])
    remarks = [_simple_number(*each, odds) for each in zip(range(len(means)), means, np.diag(covariance), strict=True)]
    return Rounding(values, tuple(remarks))


def find_simple(means: FloatArray, covariance: FloatArray) -> dict[int, float]:
    """Return the simple numbers that the data single out, by the number of the constant."""
    return _singled_out(means, covariance)[0]


def round_constants(fitted: Fitted, criterion: RegressionCriterion, least_squares: LeastSquares) -> Model:
    """Return the shortest model that comes from `fitted` by making constants simple; itself when none is shorter.

    That is what equations are compared by: simple numbers speak for an equation before any of them is singled out.
    """
    best = Model(fitted.program, description_length(fitted, criterion), fitted.mse)
    places = constant_places(fitted.program)
    if not 0 < len(places) <= SETTINGS.effort.beam or not math.isfinite(best.length):
        return best
    found = decisions(fitted.program.constants[places], covariance_of(fitted, criterion))
    probable = sorted((each for each in found if each.numbers), key=lambda each: -each.nats)
    for decision in probable[: SETTINGS.effort.beam]:
        model = _measured(fitted.program, places, dict(decision.numbers), criterion, least_squares)
        if model.length <= best.length:
            best = model
    return best


def _singled_out(means: FloatArray, covariance: FloatArray) -> tuple[dict[int, float], dict[tuple[int, float], float]]:
    """Return the simple numbers that are shown, by constant, and the odds of all that were considered."""
    found = decisions(means, covariance)
    most = max(each.nats for each in found)
    weights = [math.exp(each.nats - most) for each in found]
    shares: dict[tuple[int, float], float] = {}
    for each, weight in zip(found, weights, strict=True):
        for number in each.numbers:
            shares[number] = shares.get(number, 0.0) + weight
    total = sum(weights)
    odds = {number: share / max(total - share, 1e-300) for number, share in shares.items()}
    return {
        index: value for (index, value), its in odds.items() if its >= math.exp(SETTINGS.inference.distinct_nats)
    }, odds


def decisions(means: FloatArray, covariance: FloatArray) -> list[Decision]:
    """Return the most probable decisions on constants with these `means` (K,) and `covariance`, none among them."""
    found = beam = [_start(means, covariance)]
    while beam:
        following = {each.numbers: each for decision in beam for each in _next(decision)}
        beam = sorted(following.values(), key=lambda each: -each.nats)[: SETTINGS.effort.beam]
        found = [*found, *beam]
    return found


def _start(means: FloatArray, covariance: FloatArray) -> Decision:
    """Return the decision on nothing; variances are at least those of arithmetic."""
    least = np.maximum((_ROUNDING * means) ** 2, np.finfo(np.float64).tiny)
    spread = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
    return Decision((), 0.0, tuple(range(len(means))), means, spread)


def _next(decision: Decision) -> Iterator[Decision]:
    """Yield `decision` with one more constant decided."""
    for k in range(len(decision.open)):
        gains = _gains(float(decision.means[k]), math.sqrt(float(decision.covariance[k, k])))
        for number in sorted(gains, key=lambda each: -gains[each])[: SETTINGS.effort.beam]:
            yield _decided(decision, k, number, gains[number])


def _gains(value: float, error: float) -> dict[float, float]:
    """Return for the simple numbers near an estimate the nats by which each is more probable than any number."""
    if value == 0.0:
        return {}
    least = math.log(error * math.sqrt(2.0 * math.pi)) + math.log(continuum_density(value))
    numbers = simple_numbers(value, error, in_any_unit=True)
    return {number: -its - 0.5 * ((number - value) / error) ** 2 - least for number, its in numbers.items()}


def _decided(decision: Decision, k: int, number: float, nats: float) -> Decision:
    """Return `decision` with the k-th of the open constants fixed; the others move along."""
    column = np.delete(decision.covariance[:, k], k)
    rest = np.delete(np.delete(decision.covariance, k, 0), k, 1)
    variance = float(decision.covariance[k, k])
    means = np.delete(decision.means, k) + column * ((number - decision.means[k]) / variance)
    spread = rest - np.outer(column, column) / variance
    least = np.maximum((_ROUNDING * means) ** 2, np.finfo(np.float64).tiny)
    return Decision(
        numbers=tuple(sorted((*decision.numbers, (decision.open[k], number)))),
        nats=decision.nats + nats,
        open=(*decision.open[:k], *decision.open[k + 1 :]),
        means=means,
        covariance=spread + np.diag(np.maximum(least - np.diag(spread), 0.0)),
    )


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
    near = {number: its for (constant, number), its in odds.items() if constant == index}
    if not near:
        return None
    number = max(near, key=near.__getitem__)
    error = math.sqrt(max(float(variance), 0.0))
    return SimpleNumber(number, near[number], abs(number - float(mean)) / error if error > 0.0 else 0.0)


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
    opened = refitted.program.constants[[place for place in places if place not in values]].tolist()
    prices |= dict(zip(opened, map(fitted_length, opened, standard_errors(refitted, criterion)), strict=True))
    shown = collected(refitted.program)
    mse = least_squares.mse(shown)
    known = {abs(number): price for number, price in prices.items()}
    numbers = sum(
        known[number] if number in known else min(simple_numbers(number, 0.0).values(), default=0.0)
        for number in set(np.abs(shown.constants[constant_places(shown)]).tolist())
    )
    return Model(shown, criterion.length(mse, shown, numbers), mse)
