"""The constants of a program fitted to the rows of a target.

Maximum likelihood for noise of one variance on every row, or of one that the rows' weights divide. Letters: R rows, K
constants that are fitted.
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
"""Rows whose evaluation takes as long as everything else about a program."""
_SAME: Final = 1e-9
"""Share of the mean square of a function by which equal functions in other words differ: where fits have settled."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A program with its constants fitted.

    `mse` is the mean squared error on all rows, infinite where the program has no finite value on one of them;
    `normal` (K, K) is the matrix of the normal equations at the constants that were fitted, in node order, and
    `gradient` (K,) the slope of half the sum of squares there.
    """

    program: Program
    mse: float
    normal: FloatArray
    gradient: FloatArray


class LeastSquares:
    """Fits programs to the rows of one problem; `evaluations` counts the point evaluations, overhead included."""

    def __init__(self, problem: Problem, weights: FloatArray | None = None, restrictions: Restrictions = NONE) -> None:
        """`weights` (R,) of the rows, 1 on average; None: all alike. Programs keep to the `restrictions`.

        `half` is half the sum of squares over its mean.
        """
        self.restrictions: Final = restrictions
        self._inputs = problem.inputs
        self._target = problem.target.values
        self._roots = None if weights is None else np.sqrt(weights)
        self.half: Final = 0.5 * len(self._target)
        self.evaluations = 0

    def mse(self, program: Program) -> float:
        """Return the mean squared error of `program`."""
        self.evaluations += len(self._target) + _OVERHEAD_ROWS
        with np.errstate(all="ignore"):
            return _mse(self._weighed(values_of(program, self._inputs) - self._target))

    def r2(self, program: Program) -> float | None:
        """Return the share of the target's variance that `program` explains; None if that is not finite."""
        mean = np.average(self._target, weights=None if self._roots is None else self._roots**2)
        variance, mse = _mse(self._weighed(self._target - mean)), self.mse(program)
        return 1.0 - mse / variance if variance and math.isfinite(mse) else None

    def _weighed(self, rows: FloatArray) -> FloatArray:
        return rows if self._roots is None else np.asarray(rows * self._roots)

    def fit(
        self,
        program: Program,
        fixed: Sequence[int] = (),
        enough: float = 0.0,
        steps: int = SETTINGS.effort.steps,
    ) -> Fitted:
        """Return `program` with its constants fitted, laid out for their bounds if there are any.

        One that the restrictions do not admit has an infinite error.

        Args:
            program: where the fit begins.
            fixed: indices of nodes whose constants stay.
            enough: a mean squared error; a fit that will not come near it ends early.
            steps: most steps, successful or not.
        """
        admitted = self.restrictions.admitted(program)
        if admitted is None or (fixed and admitted is not program):
            return Fitted(program, math.inf, np.zeros((0, 0)), np.zeros(0))
        program = admitted if self.restrictions.bounds is None else self.restrictions.bounds.clipped(admitted)
        return minimize(_TargetFit(self, program, fixed, enough, steps), steps)

    def linearised(self, program: Program, places: Sequence[int], limit: float = math.inf) -> Fitted:
        """Return the program as it is, with its normal equations, which are empty beyond the error `limit`."""
        values, slopes = values_and_gradient(program, self._inputs, places)
        with np.errstate(all="ignore"):
            errors = self._weighed(values - self._target)
        self.evaluations += len(errors) + _OVERHEAD_ROWS
        mse = _mse(errors)
        if not mse <= limit or math.isinf(mse):
            return Fitted(program, mse, np.zeros((0, 0)), np.zeros(0))
        self.evaluations += 2 * len(errors)
        with np.errstate(all="ignore"):
            slopes = self._weighed(slopes)
            gradient, normal = slopes @ errors, slopes @ slopes.T
        is_finite = bool(np.isfinite(gradient).all() and np.isfinite(normal).all())
        return Fitted(program, mse if is_finite else math.inf, normal, gradient)


class _TargetFit(Fitter[Fitted, FloatArray, Fitted]):
    """The fit of one program to the rows of a target; its cost is half the sum of squares."""

    def __init__(
        self, rows: LeastSquares, program: Program, fixed: Sequence[int], enough: float, steps: int
    ) -> None:  # fmt: skip
        self._rows, self._program, self._enough, self._steps = rows, program, enough, steps
        self._places = [place for place in constant_places(program) if place not in fixed]
        self._lower, self._upper = rows.restrictions.ranges(program, fixed)
        self._begun = rows.linearised(program, self._places)

    def init(self) -> Fitted | None:
        return self._begun if self._places and math.isfinite(self._begun.mse) else None

    def equations(self, point: Fitted) -> Solver[FloatArray]:
        values = point.program.constants[self._places]
        return solver(point.normal, point.gradient, (self._lower - values, self._upper - values))

    def step(self, point: Fitted, step: FloatArray) -> tuple[Fitted, float]:
        constants = point.program.constants.copy()
        constants[self._places] = np.clip(constants[self._places] + step, self._lower, self._upper)
        moved = self._rows.linearised(replace(self._program, constants=constants), self._places, point.mse)
        return moved, self._rows.half * (point.mse - moved.mse)

    def least_gain(self, point: Fitted) -> float:
        return SETTLED * self._rows.half * point.mse

    def done(self, point: Fitted, promise: float, taken: int) -> bool:
        """Tell whether further steps with the gain of the next one would not reach the error that is enough."""
        if taken <= SETTINGS.effort.brief_steps or not self._enough > 0.0:
            return False
        left = max(1.0 - promise / (self._rows.half * point.mse), 0.0)
        return bool(point.mse * left ** (self._steps - taken) > self._enough)

    def result(self, point: Fitted | None) -> Fitted:
        return self._begun if point is None else point


def _mse(errors: FloatArray) -> float:
    with np.errstate(all="ignore"):
        mse = float(errors @ errors) / len(errors)
    return mse if math.isfinite(mse) else math.inf


def contains(program: Program, other: Program, points: FloatArray) -> bool:
    """Tell whether `program` is the `other` with some values of its constants, by its values at points (V, R)."""
    values = values_of(other, points)
    square = float(np.mean(values * values))
    names = tuple(str(number) for number in range(len(points)))
    fitted = LeastSquares(Problem(names, points, Target("", "", values, 0.0, 1.0))).fit(program)
    return fitted.mse <= _SAME * square
