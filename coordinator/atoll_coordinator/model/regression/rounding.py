"""Fitted constants made simple numbers, as far as the data cannot tell the difference.

Near its minimum the misfit is a quadratic form of the constants. So the constants are decided one after another, each
by a few simple numbers near where it lies once the earlier ones are fixed; a beam of the best partial decisions is
kept (a sequential decoding, as in integer least squares). The best whole decisions are then fitted and measured.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import Program, constant_places, with_constants
from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.regression.covariance import covariance_of, description_length, standard_errors
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.simple_numbers import fitted_length, simple_numbers
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.structure.algebra import tidied


@dataclass(frozen=True, eq=False)
class Model:
    """A program as it would be shown: its length in nats and its mean squared error."""

    program: Program
    length: float
    mse: float


@dataclass(frozen=True, eq=False)
class Decision:
    """Some constants decided, by their number in node order; where the others lie now, and their covariance."""

    numbers: tuple[tuple[int, float], ...]
    """Decided constants and their values, by rising index."""
    decided: float
    """Nats of the decided numbers and of what they add to the misfit."""
    open: tuple[int, ...]
    means: FloatArray
    covariance: FloatArray

    def length(self) -> float:
        """Return the nats of all constants when the others stay fitted."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).tolist()
        return self.decided + sum(map(fitted_length, self.means.tolist(), errors))


def round_constants(fitted: Fitted, criterion: RegressionCriterion, least_squares: LeastSquares) -> Model:
    """Return the shortest model that comes from `fitted` by making constants simple; itself when none is shorter."""
    best = Model(fitted.program, description_length(fitted, criterion), fitted.mse)
    places = constant_places(fitted.program)
    if not 0 < len(places) <= SETTINGS.regression.most_rounded_constants or not math.isfinite(best.length):
        return best
    for decision in decisions(fitted.program.constants[places], covariance_of(fitted, criterion)):
        model = _measured(fitted.program, places, decision, criterion, least_squares)
        if model.length <= best.length:
            best = model
    return best


def decisions(means: FloatArray, covariance: FloatArray) -> list[Decision]:
    """Return the most promising decisions, whole or partial, on constants with these `means` (K,) and `covariance`."""
    beam = [Decision((), 0.0, tuple(range(len(means))), means, covariance)]
    found: list[Decision] = []
    while beam:
        following = {each.numbers: each for decision in beam for each in _next(decision)}
        beam = sorted(following.values(), key=Decision.length)[: SETTINGS.regression.beam]
        found += beam
    return sorted(found, key=Decision.length)[: SETTINGS.regression.decisions_measured]


def _next(decision: Decision) -> Iterator[Decision]:
    """Yield `decision` with one more constant decided."""
    for k, index in enumerate(decision.open):
        variance = float(decision.covariance[k, k])
        value = float(decision.means[k])
        if not variance > 0.0:
            continue
        priced = {
            number: length + 0.5 * (number - value) ** 2 / variance
            for number, length in simple_numbers(value, math.sqrt(variance)).items()
        }
        for number in sorted(priced, key=priced.__getitem__)[: SETTINGS.regression.numbers_per_constant]:
            yield _decided(decision, k, index, number, priced[number])


def _decided(decision: Decision, k: int, index: int, number: float, nats: float) -> Decision:
    """Return `decision` with constant `index`, the k-th of the open ones, fixed; the others move along."""
    column = np.delete(decision.covariance[:, k], k)
    rest = np.delete(np.delete(decision.covariance, k, 0), k, 1)
    variance = decision.covariance[k, k]
    means = np.delete(decision.means, k) + column * ((number - decision.means[k]) / variance)
    return Decision(
        numbers=tuple(sorted((*decision.numbers, (index, number)))),
        decided=decision.decided + nats,
        open=(*decision.open[:k], *decision.open[k + 1 :]),
        means=means,
        covariance=rest - np.outer(column, column) / variance,
    )


def _measured(
    program: Program, places: list[int], decision: Decision, criterion: RegressionCriterion, least_squares: LeastSquares
) -> Model:
    """Return the model of a decision, its open constants fitted and its neutral ones gone."""
    values = {places[index]: number for index, number in decision.numbers}
    prices = {number: min(simple_numbers(number, 0.0).values(), default=0.0) for number in values.values()}
    values |= {places[index]: float(mean) for index, mean in zip(decision.open, decision.means, strict=True)}
    refitted = least_squares.fit(with_constants(program, values), [places[index] for index, _ in decision.numbers])
    opened = refitted.program.constants[[places[index] for index in decision.open]].tolist()
    prices |= dict(zip(opened, map(fitted_length, opened, standard_errors(refitted, criterion)), strict=True))
    shown = tidied(refitted.program)
    mse = least_squares.mse(shown)
    remaining = set(np.abs(shown.constants[constant_places(shown)]).tolist())
    numbers = sum(price for number, price in prices.items() if abs(number) in remaining)
    return Model(shown, criterion.length(mse, shown, numbers), mse)
