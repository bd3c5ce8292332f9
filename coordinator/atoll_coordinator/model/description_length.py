"""The three description lengths by which equations are compared, in nats; the shortest wins.

Each is the length of the data given the model plus the length of the model (Rissanen 1978). The three lengths differ in
the data and in the prices (nats) of operators and constants. So two lengths of different kinds are never compared.

- `selection.front_member.front_length`: errors on the target; each node costs ln 8, each constant 1/2 ln n. It decides
  which member of a front is shown while the search runs, and whether the search stagnates.
- `RegressionCriterion`: errors on the target; each node costs ln 8, each further use of a node 1.4, each constant
  1/2 ln n. It decides which equation is shown if there are no trajectories.
- `system_length`: errors of simulated states; the price of an operator depends on its kind (`structure_length`); each
  constant costs 1/2 ln N. It decides which equations together are the model.

Letters: n, the number of rows; N, the number of rows divided by their correlation length (in rows); k, the number of
constants; O, the number of measured states.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Target
from atoll_core.expression.operators import ARITY, DIVIDE, INVERSE, NEGATE, POW, SQUARE
from atoll_core.expression.program import Program, constant_places, structure

SMALLEST_UNCERTAINTY: Final = 1e-12
"""Errors below this share of the target's standard deviation are rounding errors."""

_LN2: Final = 0.6931471805599453
_SQRT_HALF: Final = 0.7071067811865476


def log(value: float) -> float:
    """Return ln(value), value > 0, by the series of artanh. The result has equal bits on every machine, unlike the
    result of the C library."""
    mantissa, exponent = math.frexp(value)
    if mantissa < _SQRT_HALF:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    square = ratio * ratio
    series = 0.0
    for odd in range(23, 0, -2):
        series = series * square + 1.0 / odd
    return exponent * _LN2 + 2.0 * ratio * series


# ------------------------------------------------------------------------------------ an equation without trajectories

_TINY: Final = 1e-290


def program_length(program: Program) -> float:
    """Return the nats of a program without the values of its constants: ln 8 for each node, and 1.4 for each further
    use of a node."""
    codes: list[int] = program.operators.tolist()
    uses = sum(ARITY[code] for code in codes)
    return SETTINGS.criterion.node * len(program) + SETTINGS.criterion.common * (uses + 1 - len(program))


@dataclass(frozen=True)
class RegressionCriterion:
    """Description lengths of the models of one target with n `rows` (Rissanen 1978).

        n/2 (ln v + MSE/v - 1) + nodes ln 8 + 1.4 for each further use of a node + k/2 ln n

    The misfit is minus the log-likelihood of independent Gaussian errors, up to a constant. Their variance v is fitted,
    but it is at least `least_variance`, the square of the target's uncertainty: v = max(MSE, least variance).
    """

    rows: int
    least_variance: float

    @classmethod
    def of(cls, target: Target) -> "RegressionCriterion":
        """Return the criterion for the models of `target`."""
        uncertainty = max(target.uncertainty, SMALLEST_UNCERTAINTY) * target.standard_deviation
        return cls(len(target.values), max(uncertainty * uncertainty, _TINY))

    def variance(self, mse: float) -> float:
        """Return the variance of an error on one row."""
        return max(mse, self.least_variance)

    def misfit(self, mse: float) -> float:
        """Return the nats of the errors."""
        if not math.isfinite(mse):
            return math.inf
        variance = self.variance(mse)
        return 0.5 * self.rows * (math.log(variance) + mse / variance - 1.0)

    def mse_of(self, misfit: float) -> float:
        """Return the mean squared error that has this misfit (the inverse of the method `misfit`), at least twice
        `least_variance`."""
        return max(math.exp(min(2.0 * misfit / self.rows, 700.0)), 2.0 * self.least_variance)

    def length_of_program(self, program: Program) -> float:
        """Return the nats of a program with fitted constants: each constant costs 1/2 ln n (Schwarz 1978)."""
        return program_length(program) + constant_nats_of(self.rows) * len(constant_places(program))

    def length(self, mse: float, program: Program) -> float:
        """Return the description length of a program with this mean squared error; it is infinite if the error is
        infinite."""
        return self.misfit(mse) + self.length_of_program(program)


# -------------------------------------------------------------------------------------- a system along trajectories

_SMALLEST_COUNT: Final = 1e-6
"""Guard: the smallest number of independent rows. It counts if there are as many fitted numbers as rows."""


def system_length(misfit: float, programs: Sequence[Program], constants: int, constant_nats: float) -> float:
    """Return the description length of a fitted system: misfit + structures + k/2 ln N (Schwarz 1978).

    Args:
        misfit: see `TrajectoryMisfit`.
        programs: the equations, except the equations that the user gave.
        constants: k, the number of fitted constants.
        constant_nats: nats of one constant, see `constant_nats_of`.
    """
    return misfit + sum(map(structure_length, programs)) + constant_nats * constants


def least_term_length(constant_nats: float) -> float:
    """Return the length of the cheapest term that can be added to an equation, a constant times a variable."""
    return 4.0 * SETTINGS.criterion.common + constant_nats


@lru_cache(maxsize=1_000)
def constant_nats_of(rows: float) -> float:
    """Return the nats of a constant, 1/2 ln N. `rows` is N, the number of rows divided by their correlation length."""
    return 0.5 * log(max(rows, 2.0))


@dataclass(frozen=True, eq=False)
class TrajectoryMisfit:
    """Nats of the errors of simulations of O states: minus their log-likelihood up to a constant (ADR 0032).

    An error is the sum of two parts. Independent errors have the variance v in each of n rows. Systematic errors (of a
    solver, of a filter, of terms that a law lacks) vary no faster than the state itself, so they consist of m < n
    independent numbers. The mean square of the residuals is s, and v is known to lie between a and b. The nats are

        n/2 ln s   for a <= s <= b
        n/2 ln b + m/2 ln(1 + (n/m) (s/b - 1))   above
        n/2 ln a - m/2 ln(1 + (n/m) (a/s - 1))   below

    The derivative of the nats by ln s is n/2 if s is near v, and m/2 if s is much larger. If the variance and the p
    fitted numbers of a system are integrated out of the likelihood, n - p rows count instead of n. So m is at most n -
    p (`with_fitted`), and a system with as many fitted numbers as rows gains nothing by a perfect fit.

    Args:
        low: a (O,).
        high: b (O,).
        least: mean squares (O,) below which errors are integration errors.
        counts: n, the number of rows that count for each state (O,): all measured rows if the state has noise, m rows
            if it has none.
        pieces: m, the independent numbers of each state (O,).
        below: m for mean squares below a (O,).
        measured: number of measured values of each state (O,); the number of fitted numbers is subtracted from it.
    """

    low: FloatArray
    high: FloatArray
    least: FloatArray
    counts: FloatArray
    pieces: FloatArray
    below: FloatArray
    measured: FloatArray

    def with_fitted(self, numbers: float) -> "TrajectoryMisfit":
        """Return the misfit for systems with `numbers` fitted numbers for each state. If there are many more rows than
        fitted numbers, this is the same misfit."""
        free = np.maximum(self.measured - numbers, _SMALLEST_COUNT)
        if (free >= np.maximum(self.pieces, self.below)).all():
            return self
        return replace(self, pieces=np.minimum(self.pieces, free), below=np.minimum(self.below, free))

    def total(self, squares: FloatArray) -> float:
        """Return the nats of errors with these mean squares (O,)."""
        inside = np.clip(np.maximum(squares, self.least), self.low, self.high)
        total = 0.5 * float(self.counts @ np.log(inside))
        for ratio, count, pieces, is_above in self._excess_ratios(squares):
            excess_nats = 0.5 * pieces * math.log1p(count / pieces * (ratio - 1.0))
            total += excess_nats if is_above else -excess_nats
        return total

    def effective_rows(self, squares: FloatArray) -> FloatArray:
        """Return the effective number of independent rows (O,) at these mean squares (O,), between m and n.

        It is twice the derivative of the nats by ln s.
        """
        return np.array(
            [
                count * ratio / (1.0 + count / pieces * (ratio - 1.0))
                for ratio, count, pieces, _ in self._excess_ratios(squares)
            ]
        )

    def _excess_ratios(self, squares: FloatArray) -> Iterator[tuple[float, float, float, bool]]:
        """Yield four values for each state: the ratio of its mean square to the exceeded bound (a or b), n, m, and
        whether the mean square is above b."""
        clipped = np.maximum(squares, self.least)
        above, under = np.maximum(clipped / self.high, 1.0), np.maximum(self.low / clipped, 1.0)
        is_above = above > 1.0
        pieces = np.where(is_above, self.pieces, self.below)
        counts = np.where(is_above, self.counts, np.where(self.low < self.high, self.counts, self.below))
        return zip(
            np.where(is_above, above, under).tolist(), counts.tolist(), pieces.tolist(), is_above.tolist(), strict=True
        )


# --------------------------------------------------------------------------------------------- the price of operators


def structure_length(program: Program) -> float:
    """Return the nats of a program without the values of its constants.

    Sums, products and whole powers are common in equations of motion, functions are less common, and nested functions
    are rare (compare the counts of Guimerà et al. 2020 in a corpus of named equations).
    """
    return _structure_length(structure(program), len(program))


@lru_cache(maxsize=20_000)
def _structure_length(key: bytes, size: int) -> float:
    """Return the nats of a structure of `size` nodes; cached, since a local search tries the same structure many
    times."""
    codes = np.frombuffer(key, np.int8, size).tolist()
    lefts, rights = np.frombuffer(key, np.int16, 2 * size, size).reshape(2, size).tolist()
    total = 0.0
    has_function: list[bool] = []
    uses = [0] * size
    for code, left, right in zip(codes, lefts, rights, strict=True):
        arguments = (left, right)[: ARITY[code]]
        inner = any(has_function[argument] for argument in arguments)
        calls = is_function(code)
        has_function.append(inner or calls)
        total += _operator_length(code) + (SETTINGS.criterion.nested if inner and calls else 0.0)
        for argument in arguments:
            uses[argument] += 1
    return total + SETTINGS.criterion.common * sum(max(count - 1, 0) for count in uses)


def is_function(code: int) -> bool:
    """Tell whether an operator is a function such as a sine, and neither an algebraic operator nor a leaf."""
    return ARITY[code] == 1 and code not in (SQUARE, NEGATE, INVERSE)


def _operator_length(code: int) -> float:
    prices = SETTINGS.criterion
    if code == NEGATE:
        return 0.0
    if code in (DIVIDE, INVERSE):
        return prices.quotient
    return prices.function if is_function(code) or code == POW else prices.common
