"""Fits the constants of a program to the rows of a target, by damped least squares within bounds.

`LeastSquares.fit` evaluates the program and its derivatives by the constants, builds the normal equations, and lets
`least_squares.minimize` take the steps. This is the maximum-likelihood fit if the errors are normal and independent.
Their variance must be the same on all rows, or inversely proportional to the weight of the row.

Doubtful: the fit finds a local minimum near the initial constants of the program. If the program has no finite value on
a single row, its error is infinite. So one pole excludes the program.

Letters: R rows, K fitted constants.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.model.least_squares import SETTLED, Fitter, Solver, minimize, solver
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Problem, Target
from atoll_core.expression.evaluation import values_and_gradient, values_of
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.restrictions import NONE, Restrictions

_OVERHEAD_ROWS: Final = 500
"""The fixed cost of a program: evaluating this number of rows takes as long."""
_EQUAL_SHARE: Final = 1e-9
"""Two functions are equal if the mean square of their difference is below this share of the mean square."""


@dataclass(frozen=True, eq=False)
class FittedProgram:
    """A program with fitted constants.

    `mse` is the mean squared error on all rows; it is infinite if the program has no finite value on some row. `normal`
    (K, K) is the matrix of the normal equations for the fitted constants, in node order. `gradient` (K,) is the
    gradient of half the sum of squares by these constants.
    """

    program: Program
    mse: float
    normal: FloatArray
    gradient: FloatArray


class LeastSquares:
    """Fits programs to the rows of one problem. `evaluations` counts point evaluations, including the overhead."""

    def __init__(self, problem: Problem, weights: FloatArray | None = None, restrictions: Restrictions = NONE) -> None:
        """Set the rows, their `weights` (R,), and the `restrictions` of programs. The mean of the weights is 1; None:
        all weights are equal.

        `half_count` is half the number of rows: half the sum of squares is `half_count` times the mean squared error.
        """
        self.restrictions: Final = restrictions
        self._inputs = problem.inputs
        self._target = problem.target.values
        self._roots = None if weights is None else np.sqrt(weights)
        self.half_count: Final = 0.5 * len(self._target)
        self.evaluations = 0

    def mse(self, program: Program) -> float:
        """Return the mean squared error of `program`."""
        self.evaluations += len(self._target) + _OVERHEAD_ROWS
        with np.errstate(all="ignore"):
            return _mse(self._weight(values_of(program, self._inputs) - self._target))

    def r2(self, program: Program) -> float | None:
        """Return the share of the target's variance that `program` explains; None if this share is not finite."""
        mean = np.average(self._target, weights=None if self._roots is None else self._roots**2)
        variance, mse = _mse(self._weight(self._target - mean)), self.mse(program)
        return 1.0 - mse / variance if variance and math.isfinite(mse) else None

    def _weight(self, rows: FloatArray) -> FloatArray:
        return rows if self._roots is None else np.asarray(rows * self._roots)

    def fit(
        self,
        program: Program,
        fixed: Sequence[int] = (),
        enough: float = 0.0,
        steps: int = SETTINGS.effort.steps,
    ) -> FittedProgram:
        """Return `program` with fitted constants. If constants have bounds, the program is rewritten in the form to
        which the bounds apply.

        A program that the restrictions do not admit has an infinite error.

        Args:
            program: its constants are the start of the fit.
            fixed: indices of nodes whose constants are not fitted.
            enough: a mean squared error; the fit stops early if it will not reach this error.
            steps: the largest number of steps; successful and failed steps count.
        """
        admitted = self.restrictions.admitted(program)
        if admitted is None or (fixed and admitted is not program):
            return FittedProgram(program, math.inf, np.zeros((0, 0)), np.zeros(0))
        program = admitted if self.restrictions.bounds is None else self.restrictions.bounds.clipped(admitted)
        return minimize(_TargetFit(self, program, fixed, enough, steps), steps)

    def linearise(self, program: Program, places: Sequence[int], limit: float = math.inf) -> FittedProgram:
        """Return the unchanged program with its normal equations, which are empty if the error exceeds `limit`."""
        values, slopes = values_and_gradient(program, self._inputs, places)
        with np.errstate(all="ignore"):
            errors = self._weight(values - self._target)
        self.evaluations += len(errors) + _OVERHEAD_ROWS
        mse = _mse(errors)
        if not mse <= limit or math.isinf(mse):
            return FittedProgram(program, mse, np.zeros((0, 0)), np.zeros(0))
        self.evaluations += 2 * len(errors)
        with np.errstate(all="ignore"):
            slopes = self._weight(slopes)
            gradient, normal = slopes @ errors, slopes @ slopes.T
        is_finite = bool(np.isfinite(gradient).all() and np.isfinite(normal).all())
        return FittedProgram(program, mse if is_finite else math.inf, normal, gradient)


class _TargetFit(Fitter[FittedProgram, FloatArray, FittedProgram]):
    """The fit of one program to the rows of a target; the cost is half the sum of squares."""

    def __init__(
        self, rows: LeastSquares, program: Program, fixed: Sequence[int], enough: float, steps: int
    ) -> None:  # fmt: skip
        self._rows, self._program, self._enough, self._steps = rows, program, enough, steps
        self._places = [place for place in constant_places(program) if place not in fixed]
        self._lower, self._upper = rows.restrictions.ranges(program, fixed)
        self._start = rows.linearise(program, self._places)

    def init(self) -> FittedProgram | None:
        return self._start if self._places and math.isfinite(self._start.mse) else None

    def equations(self, point: FittedProgram) -> Solver[FloatArray]:
        values = point.program.constants[self._places]
        return solver(point.normal, point.gradient, (self._lower - values, self._upper - values))

    def step(self, point: FittedProgram, step: FloatArray) -> tuple[FittedProgram, float]:
        constants = point.program.constants.copy()
        constants[self._places] = np.clip(constants[self._places] + step, self._lower, self._upper)
        moved = self._rows.linearise(replace(self._program, constants=constants), self._places, point.mse)
        return moved, self._rows.half_count * (point.mse - moved.mse)

    def least_gain(self, point: FittedProgram) -> float:
        return SETTLED * self._rows.half_count * point.mse

    def done(self, point: FittedProgram, promise: float, taken: int) -> bool:
        """Tell whether the fit will not reach the error `enough`. It is assumed that each remaining step has the
        relative gain that is predicted for the next step."""
        if taken <= SETTINGS.effort.brief_steps or not self._enough > 0.0:
            return False
        left = max(1.0 - promise / (self._rows.half_count * point.mse), 0.0)
        return bool(point.mse * left ** (self._steps - taken) > self._enough)

    def result(self, point: FittedProgram | None) -> FittedProgram:
        return self._start if point is None else point


def _mse(errors: FloatArray) -> float:
    with np.errstate(all="ignore"):
        mse = float(errors @ errors) / len(errors)
    return mse if math.isfinite(mse) else math.inf


def contains(program: Program, other: Program, points: FloatArray) -> bool:
    """Tell whether `program` equals the program `other` at these points (V, R), for some values of the constants of
    `program`."""
    values = values_of(other, points)
    square = float(np.mean(values * values))
    names = tuple(str(number) for number in range(len(points)))
    fitted = LeastSquares(Problem(names, points, Target("", "", values, 0.0, 1.0))).fit(program)
    return fitted.mse <= _EQUAL_SHARE * square
