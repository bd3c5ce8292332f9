"""The likelihood of a sampled process, and the fit of its constants. Without measurement errors, steps are independent
and Gaussian; with them, the likelihood is the one of a Kalman filter.

`ProcessLikelihood.whiten` computes whitened residuals of steps: for the right law, these residuals are independent and
have variance one. The likelihood, the fit (`fit`, damped Fisher scoring) and the checks use the whitened residuals.

Without measurement errors, steps are independent given their initial states (`moments`). With measurement errors e of
variance Q, a step is measured from y = x + e. To first order in the errors, its residual is r_k = w_k + e_k+1 - A_k
e_k, with the noise w_k of covariance V_k and the Jacobian A_k of the step. All residuals are jointly normal with a
block tridiagonal covariance,

    cov(r_k) = V_k + Q + A_k Q A_k',    cov(r_k, r_k+1) = - Q A_k+1'

This is the likelihood of the extended Kalman filter, linearised about smoothed states (Särkkä 2013, section 9.1). The
Cholesky factor L of the covariance is banded. With the whitened residuals z = L^-1 r and the logarithms l of the
diagonal of L, minus the log-likelihood is sum(z^2)/2 + sum(l). An element of the information matrix belongs to two
constants. It is a sum over all elements of z and l: the derivative by one constant times the derivative by the other.
This is also right for constants that occur in the covariance C = L L' of the residuals, because
E |dz|^2 + |dl|^2 = 1/2 tr (C^-1 dC)^2.

Doubtful: steps are Gaussian only if they are short: drift and diffusion must not change much within a step. For the
linearisation about smoothed states, drift and diffusion must not change much over the size of a measurement error.
Derivatives are central differences.

Letters: S states, N steps, K constants.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from atoll_coordinator.data.increments import Steps
from atoll_coordinator.model.constants.standard_errors import ConstantErrors
from atoll_coordinator.model.least_squares import Fitter, Solver, minimize, solver
from atoll_coordinator.process_steps import Discretisation
from atoll_coordinator.process_steps.moments import Pair, StepMoments, factors_of, predict_step_moments
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.restrictions import NONE, Restrictions

_RELATIVE_DIFFERENCE = 1e-5
"""Relative change of a constant for central differences; the relative error of the differences is about the square of
this change."""


@dataclass(frozen=True, eq=False)
class ProcessModel:
    """A process: the programs of the `drift` (S), and the programs of the components of the diffusion, in the order of
    `pairs`.

    `noise` has the variance of the measurement errors of each state (S); `discretisation` is how a step is computed.
    """

    drift: tuple[Program, ...]
    diffusion: tuple[Program, ...]
    pairs: tuple[Pair, ...]
    noise: tuple[float, ...]
    discretisation: Discretisation = "local linearisation"

    @property
    def programs(self) -> tuple[Program, ...]:
        """All equations: drifts, then components of the diffusion."""
        return (*self.drift, *self.diffusion)

    def with_program(self, number: int, program: Program) -> "ProcessModel":
        """Return the model with equation `number` replaced."""
        return self.with_programs([*self.programs[:number], program, *self.programs[number + 1 :]])

    def with_programs(self, programs: Sequence[Program]) -> "ProcessModel":
        """Return the model with all equations replaced."""
        return replace(self, drift=tuple(programs[: len(self.drift)]), diffusion=tuple(programs[len(self.drift) :]))

    def moments(self, points: FloatArray, lengths: FloatArray) -> StepMoments:
        """Return the moments of steps of these `lengths` (N,) from `points` (V, N)."""
        diffusion = dict(zip(self.pairs, self.diffusion, strict=True))
        return predict_step_moments(self.drift, diffusion, points, lengths, self.discretisation)

    def parameters(self, free: Sequence[int]) -> FloatArray:
        """Return the constants of the equations with the indices `free`, then the logarithms of the standard deviations
        of the measurement noise."""
        constants = [program.constants[constant_places(program)] for program in (self.programs[k] for k in free)]
        return np.concatenate([*constants, [0.5 * math.log(variance) for variance in self.noise if variance > 0.0]])

    def with_parameters(self, free: Sequence[int], values: FloatArray) -> "ProcessModel":
        """Return the model with other values of its parameters."""
        model, rest = self, values.tolist()
        for number in free:
            places = constant_places(model.programs[number])
            moved = with_constants(model.programs[number], dict(zip(places, rest, strict=False)))
            model, rest = model.with_program(number, moved), rest[len(places) :]
        noise = [math.exp(min(2.0 * rest.pop(0), 300.0)) if variance > 0.0 else 0.0 for variance in self.noise]
        return replace(model, noise=tuple(noise))


@dataclass(frozen=True, eq=False)
class WhitenedSteps:
    """Independent residuals (S, N) of steps in units of their standard deviations, and the logarithms (S, N) of these
    standard deviations."""

    residuals: FloatArray
    logarithms: FloatArray

    @property
    def misfit(self) -> float:
        """Minus the log-likelihood in nats, without the constant N S/2 ln 2 pi; it is infinite if a covariance is not
        positive definite."""
        with np.errstate(all="ignore"):
            total = float(0.5 * np.sum(self.residuals * self.residuals) + np.sum(self.logarithms))
        return total if math.isfinite(total) else math.inf


@dataclass(frozen=True, eq=False)
class _LikelihoodPoint:
    """A model during a fit, the values of its parameters (K,), and its whitened residuals."""

    model: ProcessModel
    values: FloatArray
    whitened: WhitenedSteps


@dataclass(frozen=True, eq=False)
class FittedProcess:
    """A model with fitted constants, its `misfit` in nats, and a function that computes the information matrix of its
    parameters."""

    model: ProcessModel
    misfit: float
    compute_information: Callable[[], FloatArray]

    @cached_property
    def information(self) -> FloatArray:
        """The information matrix (K, K), computed when it is first used: this takes two likelihoods for each
        parameter."""
        return self.compute_information()


class ProcessLikelihood:
    """The likelihood of the steps of one process.

    With measurement noise, steps are linearised about the states `smoothed` (S, N). Fitted constants obey the bounds in
    the `restrictions` of their equations.
    """

    def __init__(
        self, steps: Steps, smoothed: FloatArray | None = None, restrictions: Sequence[Restrictions] = ()
    ) -> None:
        self.steps, self._restrictions = steps, restrictions
        self._points = steps.points if smoothed is None else np.concatenate([smoothed, steps.points[len(smoothed) :]])

    def log_likelihood_per_step(self, misfit: float) -> float:
        """Return the mean log-likelihood of a step in nats; the likelihood is a density in the units of the states.

        Args:
            misfit: the misfit of all steps, as in `WhitenedSteps` and `fit`.
        """
        states, count = len(self.steps.increments), len(self.steps.lengths)
        return -misfit / count - 0.5 * states * math.log(2.0 * math.pi)

    def whiten(self, model: ProcessModel) -> WhitenedSteps:
        """Return the whitened residuals of all steps."""
        if any(model.noise):
            return _whiten_banded(*self._residuals_and_bands(model, model.moments(self._points, self.steps.lengths)))
        moments = model.moments(self.steps.points, self.steps.lengths)
        covariance = moments.covariance
        if model.discretisation == "Euler-Maruyama":
            covariance = self._with_least_variances(covariance)
        return _whiten_independent(self.steps.increments - moments.mean, covariance)

    def _with_least_variances(self, covariance: FloatArray) -> FloatArray:
        """Return covariances (S, S, N) in which each variance is at least the smallest variance that counts as noise.

        In the Euler-Maruyama method a state without noise of its own has variance zero, and its residuals are rounding
        errors.
        """
        for state, least in enumerate(self.steps.least_variances.tolist()):
            covariance[state, state] = np.maximum(covariance[state, state], least)
        return covariance

    def smooth_states(self, model: ProcessModel) -> FloatArray:
        """Return smoothed initial states (S, N) of the steps: measured states minus estimated measurement errors.

        The states are not changed if the covariance of the residuals is not positive definite.
        """
        from scipy import linalg

        moments = model.moments(self._points, self.steps.lengths)
        residuals, band = self._residuals_and_bands(model, moments)
        states, count = residuals.shape
        if not (np.isfinite(band).all() and np.isfinite(residuals).all()):
            return self._points[:states]
        try:
            solved = linalg.solveh_banded(band, residuals.T.ravel(), lower=True).reshape(count, states).T
        except np.linalg.LinAlgError:
            return self._points[:states]
        errors = -np.einsum("jir,jr->ir", moments.jacobian, solved)
        follows = np.flatnonzero(self.steps.follows)
        errors[:, follows] += solved[:, follows - 1]
        return np.asarray(self.steps.points[:states] - np.array(model.noise)[:, None] * errors)

    def _residuals_and_bands(self, model: ProcessModel, moments: StepMoments) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (S, N), and the lower bands (2 S, S N) of their covariance matrix."""
        states, count = moments.mean.shape
        noise, jacobian = np.array(model.noise), moments.jacobian
        away = self.steps.points[:states] - self._points[:states]
        ends = self.steps.points[:states] + self.steps.increments
        residuals = ends - self._points[:states] - moments.mean - np.einsum("ijr,jr->ir", jacobian, away)
        block = moments.covariance + np.einsum("ijr,j,kjr->ikr", jacobian, noise, jacobian)
        block[range(states), range(states)] += noise[:, None]
        off_diagonal = -noise[:, None, None] * jacobian.transpose(1, 0, 2)
        off_diagonal = np.where(self.steps.follows, off_diagonal, 0.0)
        band = np.zeros((2 * states, states * count))
        for i in range(states):
            for j in range(i + 1):
                band[i - j, j::states] = block[i, j]
            for j in range(states):
                band[states + i - j, j::states][: count - 1] = off_diagonal[j, i, 1:]
        return residuals, band

    def fit(
        self,
        model: ProcessModel,
        free: Sequence[int],
        settled: float = 0.01 * SETTINGS.selection.least_gain,
        limit: float = math.inf,
    ) -> FittedProcess:
        """Return `model` after a fit by damped Fisher scoring.

        The constants of the equations with the indices `free` and the measurement noise are fitted. The fit ends if the
        predicted or the actual gain of a step is less than `settled` nats, or if the predicted misfit after the next
        step is not below `limit`.
        """
        return minimize(_LikelihoodFit(self, model, free, settled, limit))

    def estimate_errors(self, fitted: FittedProcess, free: Sequence[int]) -> ConstantErrors:
        """Return the standard errors of the parameters of a fit. `free` are the indices of the equations with fitted
        constants."""
        values = fitted.model.parameters(free)
        freedom, ranges = len(self.steps.lengths) - len(values), self.ranges(fitted.model, free)
        return ConstantErrors.from_fit(values, fitted.information, freedom, bounds=ranges)

    def ranges(self, model: ProcessModel, free: Sequence[int]) -> FloatArray:
        """Return the smallest and largest allowed values (2, K) of the parameters."""
        restrictions = self._restrictions or [NONE] * len(model.programs)
        ranges = [restrictions[number].ranges(model.programs[number]) for number in free]
        noise = np.repeat([[-np.inf], [np.inf]], np.count_nonzero(model.noise), axis=1)
        return np.concatenate([*ranges, noise], axis=1)

    def derivatives(self, at: _LikelihoodPoint, free: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the gradient (K,) of the misfit by the parameters, and the information matrix (K, K) of the
        parameters."""
        residuals, logarithms, values = [], [], at.values
        for k, value in enumerate(values.tolist()):
            step = np.zeros(len(values))
            step[k] = _RELATIVE_DIFFERENCE * max(abs(value), _RELATIVE_DIFFERENCE)
            up, down = (self.whiten(at.model.with_parameters(free, values + sign * step)) for sign in (1.0, -1.0))
            residuals.append((up.residuals - down.residuals).ravel() / (2.0 * step[k]))
            logarithms.append((up.logarithms - down.logarithms).ravel() / (2.0 * step[k]))
        shape = (len(values), at.whitened.residuals.size)
        slopes = np.array(residuals).reshape(shape), np.array(logarithms).reshape(shape)
        with np.errstate(all="ignore"):
            gradient = slopes[0] @ at.whitened.residuals.ravel() + slopes[1].sum(axis=1)
            return gradient, slopes[0] @ slopes[0].T + slopes[1] @ slopes[1].T


class _LikelihoodFit(Fitter[_LikelihoodPoint, FloatArray, FittedProcess]):
    """The fit of one model to the steps of a process, by Fisher scoring; the cost is the misfit in nats."""

    def __init__(
        self, likelihood: ProcessLikelihood, model: ProcessModel, free: Sequence[int], settled: float, limit: float
    ) -> None:
        self._likelihood, self._free, self._settled, self._limit = likelihood, free, settled, limit
        self._start = _LikelihoodPoint(model, model.parameters(free), likelihood.whiten(model))
        self._lower, self._upper = likelihood.ranges(model, free)
        self._derivatives = cache(lambda point: likelihood.derivatives(point, free))

    def init(self) -> _LikelihoodPoint | None:
        return self._start if math.isfinite(self._start.whitened.misfit) else None

    def equations(self, point: _LikelihoodPoint) -> Solver[FloatArray]:
        gradient, information = self._derivatives(point)
        return solver(information, gradient, (self._lower - point.values, self._upper - point.values))

    def step(self, point: _LikelihoodPoint, step: FloatArray) -> tuple[_LikelihoodPoint, float]:
        model = self._start.model.with_parameters(self._free, point.values + step)
        moved = _LikelihoodPoint(model, point.values + step, self._likelihood.whiten(model))
        return moved, point.whitened.misfit - moved.whitened.misfit

    def least_gain(self, point: _LikelihoodPoint) -> float:
        return self._settled

    def done(self, point: _LikelihoodPoint, promise: float, taken: int) -> bool:
        return point.whitened.misfit - promise > self._limit

    def result(self, point: _LikelihoodPoint | None) -> FittedProcess:
        if point is None:
            count = len(self._start.values)
            return FittedProcess(self._start.model, math.inf, lambda: np.zeros((count, count)))
        return FittedProcess(point.model, point.whitened.misfit, lambda: self._derivatives(point)[1])


def _whiten_independent(residuals: FloatArray, covariance: FloatArray) -> WhitenedSteps:
    """Whiten residuals (S, N) of independent steps by the Cholesky factors of their covariances (S, S, N)."""
    factor, whitened = factors_of(covariance), np.zeros_like(residuals)
    with np.errstate(all="ignore"):
        for i in range(len(residuals)):
            whitened[i] = (residuals[i] - (factor[i, :i] * whitened[:i]).sum(axis=0)) / factor[i, i]
        return WhitenedSteps(whitened, np.log(np.einsum("iin->in", factor)))


def _whiten_banded(residuals: FloatArray, band: FloatArray) -> WhitenedSteps:
    """Whiten residuals (S, N) by the banded Cholesky factor of their covariance."""
    from scipy import linalg

    nothing = WhitenedSteps(np.full_like(residuals, np.nan), np.full_like(residuals, np.nan))
    if not (np.isfinite(band).all() and np.isfinite(residuals).all()):
        return nothing
    try:
        factor = linalg.cholesky_banded(band, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        return nothing
    white = linalg.blas.dtbsv(len(band) - 1, factor, residuals.T.ravel().copy(), lower=1)
    shape = (residuals.shape[1], residuals.shape[0])
    return WhitenedSteps(white.reshape(shape).T, np.log(factor[0]).reshape(shape).T)
