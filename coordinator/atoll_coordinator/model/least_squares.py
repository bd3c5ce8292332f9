"""Least squares and likelihoods by damped steps: one loop for every fit, and the linear equations of its steps.

How it works. At a point with the gradient g of the cost, the step s solves the normal equations N s = -g. If the cost
is half a sum of squares, N is J'J with the derivatives J of the residuals; for a likelihood, N is Fisher's information
matrix. The diagonal of N is raised by a share, the damping (Levenberg 1944, Marquardt 1963). If a step does not lower
the cost, the damping is multiplied by ten and the step is solved again, with the same N; a successful step divides the
damping by ten.

A `Fitter` defines the data, the cost and the end of a fit. There are three: for the rows of a target
(`regression.fit`), for trajectories (`shooting.multiple_shooting`), and for the steps of a stochastic process
(`stochastic.likelihood`).

Doubts. The loop finds a local minimum; callers choose where a fit begins. The loop stops after a fixed number of steps,
which counts successful and failed steps. So a slow fit can end before it has converged. Letters: K fitted numbers, R
rows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.cholesky import solve_damped
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

SETTLED: Final = 1e-7
"""A fit ends when a step lowers the cost by less than this share."""
FIRST_DAMPING: Final = 1e-3
"""The damping of the first step."""
LEAST_DAMPING: Final = 1e-12
"""Below this damping, a step equals the undamped Gauss-Newton step."""
MOST_DAMPING: Final = 1e9
"""Guard: a fit ends if its equations have no solution at this damping and at all smaller ones."""
_FACTOR: Final = 10.0
"""A failed step multiplies the damping by this factor; a successful step divides the damping by it."""

Point = TypeVar("Point")
Step = TypeVar("Step")
Result = TypeVar("Result", covariant=True)
Solver = Callable[[float], tuple[Step, float] | None]
"""A function of the damping: it computes the step and the predicted decrease of the cost. It returns None if there is
no solution, or if bounds allow no step that lowers the cost."""


class Fitter(Protocol[Point, Step, Result]):
    """One fit by damped steps. The methods are named as in optimistix."""

    def init(self) -> Point | None:
        """Return the first point; None if the cost is undefined there."""
        ...

    def equations(self, point: Point) -> Solver[Step]:
        """Return the normal equations at a point."""
        ...

    def step(self, point: Point, step: Step) -> tuple[Point, float] | None:
        """Return the point after a step and the decrease of the cost; None if the cost is undefined there."""
        ...

    def least_gain(self, point: Point) -> float:
        """Return the smallest decrease of the cost that counts. A step with a smaller predicted decrease is not tried.
        A step with a smaller actual decrease is the last step. The default is for a cost in nats."""
        return SETTINGS.selection.least_gain

    def done(self, point: Point, promise: float, taken: int) -> bool:
        """Tell whether the fit ends at a point, given the predicted decrease of its first step (`promise`) and the
        number of steps tried (`taken`)."""
        return False

    def result(self, point: Point | None) -> Result:
        """Return the outcome of a fit that ended at a point."""
        ...


@dataclass(frozen=True)
class Descent(Generic[Point, Step]):
    """A `Fitter` made of functions. The fit begins at a point whose cost is defined, and its result is the last
    point."""

    start: Point
    equations: Callable[[Point], Solver[Step]]
    step: Callable[[Point, Step], tuple[Point, float] | None]
    least_gain: Callable[[Point], float] = lambda point: SETTINGS.selection.least_gain

    def init(self) -> Point:
        """Return where the fit begins."""
        return self.start

    def done(self, point: Point, promise: float, taken: int) -> bool:
        """Return False: the fit ends when the cost no longer decreases."""
        return False

    def result(self, point: Point | None) -> Point:
        """Return the last point."""
        return self.start if point is None else point


def minimize(fitter: Fitter[Point, Step, Result], steps: int = SETTINGS.effort.steps) -> Result:
    """Return the result at the point of least cost after at most `steps` damped steps, which count successful and
    failed steps."""
    point, solve, damping = fitter.init(), None, FIRST_DAMPING
    for taken in range(steps if point is not None else 0):
        assert point is not None
        is_new, solve = solve is None, solve or fitter.equations(point)
        solved, least, moved = solve(damping), fitter.least_gain(point), None
        if solved is not None and np.isfinite(solved[1]):
            if solved[1] <= least or (is_new and fitter.done(point, solved[1], taken)):
                break
            moved = fitter.step(point, solved[0])
        if moved is None or not moved[1] >= 0.0:
            damping *= _FACTOR
            if damping > MOST_DAMPING:
                break
            continue
        (point, gain), solve, damping = moved, None, max(damping / _FACTOR, LEAST_DAMPING)
        if gain <= least:
            break
    return fitter.result(point)


def solver(
    normal: FloatArray, gradient: FloatArray, reach: tuple[FloatArray, FloatArray] | None = None
) -> Solver[FloatArray]:
    """Return the solver that computes steps (K,) from the normal equations.

    Args:
        normal: the matrix (K, K) of the normal equations.
        gradient: gradient (K,) of the cost.
        reach: least and largest step (K,) of each number. Numbers whose bounds block the step stay fixed, and the step
            of the other numbers is solved without them (Bertsekas 1982).
    """
    if reach is not None:
        held = ((reach[0] >= 0.0) & (gradient >= 0.0)) | ((reach[1] <= 0.0) & (gradient <= 0.0))
        normal, gradient = hold_numbers(normal, gradient, held)

    def solve(damping: float) -> tuple[FloatArray, float] | None:
        step = -gradient
        if not solve_damped(normal, damping, step):
            return None
        step = step if reach is None else np.clip(step, *reach)
        promise = -0.5 * float((gradient * step).sum())
        return (step, promise) if promise >= 0.0 else None

    return solve


def hold_numbers(
    normal: FloatArray, gradient: FloatArray, held: npt.NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations with the step of the `held` numbers (K,) fixed at zero."""
    if not held.any():
        return normal, gradient
    normal, gradient = normal.copy(), gradient.copy()
    normal[held, :] = normal[:, held] = gradient[held] = 0.0
    normal[held, held] = 1.0
    return normal, gradient


def coefficients_of(columns: FloatArray, target: FloatArray) -> FloatArray:
    """Return the coefficients (K,) of `columns` (K, R) with the least squared residuals of the `target` (R,)."""
    sizes = np.sqrt((columns**2).sum(axis=1))
    sizes[sizes == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq((columns / sizes[:, None]).T, target, rcond=_DEPENDENT)[0] / sizes)


_DEPENDENT: Final = 1e-12
"""Relative size of singular values of normalised columns below which they are rounding errors."""


def inverse(matrix: FloatArray, ridge: float = 0.0) -> FloatArray:
    """Return the pseudoinverse (K, K) of a symmetric matrix. It is computed in units in which the diagonal of the
    matrix is one.

    The `ridge` is added to the diagonal in these units: with a ridge, the inverse is huge instead of zero in directions
    that the matrix does not determine.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-200))
    unit = matrix / np.outer(scale, scale) + ridge * np.eye(len(scale))
    return np.asarray(np.linalg.pinv(unit, hermitian=True) / np.outer(scale, scale))
