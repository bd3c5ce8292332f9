"""Draws of the constants of a fitted system from their distribution given the data.

The first draws are normal, with the covariance of the fit and a prior standard error of 100 % (`EquationSetFit.root`).
Where the data determine a constant badly, such draws may
contradict them: a denominator changes its sign, or two changes that cancel to first order no longer cancel. So each
draw is simulated along short pieces of the fitted trajectories. There the deviance of a right approximation is the
quadratic function that follows from the sensitivities. A larger deviance is added to the deviance of the draw. Draws
are repeated by their weights; if few draws carry the weight, all draws take random steps that the deviance accepts or
rejects (resample-move, Gilks & Berzuini 2001, J. R. Stat. Soc. B 63:127).

Short pieces are used since the likelihood of a chaotic trajectory has no useful shape: with slightly other constants,
no initial state gives the same trajectory. Doubtful: a curved valley of the deviance is cut to its straight part.

Letters: P constants, M draws, D states, K offsets, G pieces, N rows.
"""

import math
from typing import Final

import numpy as np

from atoll.experiments.fits import EquationSetFit
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_FEWEST: Final = 100
"""Fewest normal draws: from fewer, a few repeated draws may remain."""
_ROUNDS: Final = 20
"""Random steps of each draw."""
_EFFECTIVE: Final = 0.5
"""Effective share of the draws (Kish 1965) below which they take steps."""
_ACCEPTED: Final = (0.2, 0.4)
"""Accepted share of the steps below and above which steps become shorter and longer. The best share is 0.23 for many
constants and 0.44 for one (Gelman et al. 1996)."""
_FACTOR: Final = 1.5


def draw_constants(fitted: EquationSetFit, count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return constants (M, P) of `count` draws, and the factors (M,) of the variance of the errors.

    The size of the errors is estimated from the same data, so that the variance has an inverse chi-squared
    distribution, and constants have Student's t distribution.
    """
    values, freedom = fitted.values, fitted.degrees_of_freedom
    size = max(count, _FEWEST)
    variances = freedom / random.chisquare(freedom, size)
    if not len(values):
        return np.zeros((count, 0)), variances[:count]
    excess, root = _Excess(fitted), fitted.root

    def at(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return constants (M, P) and deviances (M,) of points (M, P) in units of the normal distribution."""
        constants = np.array([excess.within_bounds(values + root @ point) for point in points])
        return constants, (points**2).sum(axis=1) + [excess(row) for row in constants]

    points = np.sqrt(variances)[:, None] * random.standard_normal((size, len(values)))
    points[0] = 0.0  # the fit itself
    constants, deviances = at(points)
    weights = np.exp(0.5 * ((points**2).sum(axis=1) - deviances) / variances)
    weights /= weights.sum()
    places = _resampled(weights, count, random)
    points, constants, deviances, variances = points[places], constants[places], deviances[places], variances[places]
    if 1.0 / (weights**2).sum() >= _EFFECTIVE * size:
        return constants, variances
    step = 2.4 / math.sqrt(len(values))
    for _ in range(_ROUNDS):
        proposed = points + step * np.sqrt(variances)[:, None] * random.standard_normal(points.shape)
        there, new_deviances = at(proposed)
        is_accepted = np.log(random.random(count)) < 0.5 * (deviances - new_deviances) / variances
        points[is_accepted], constants[is_accepted] = proposed[is_accepted], there[is_accepted]
        deviances[is_accepted] = new_deviances[is_accepted]
        share = float(is_accepted.mean())
        step *= _FACTOR if share > _ACCEPTED[1] else 1.0 / _FACTOR if share < _ACCEPTED[0] else 1.0
    return constants, variances


def _resampled(weights: FloatArray, count: int, random: np.random.Generator) -> FloatArray:
    """Return `count` indices, each as often as its weight requires, up to less than one (systematic resampling)."""
    places = (random.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)


class _Excess:
    """The deviance of constants (P,) along short pieces, beyond the deviance of the quadratic approximation.

    It is infinite if the system cannot be simulated with these constants.
    """

    def __init__(self, fitted: EquationSetFit) -> None:
        self._fitted, self._fit, fit = fitted, fitted.fit, fitted.fit
        estimator, states = fit.estimator, len(fit.system.outputs)
        self._method = estimator.integrator.methods[fit.is_stiff]
        self._segments = estimator.layout(SETTINGS.shooting.lengths[1]).segments
        firsts = self._segments[:, 0]
        offsets = fit.starts[np.searchsorted(fit.segments[:, 0], firsts, side="right") - 1, states:]
        self._starts = np.ascontiguousarray(np.concatenate([fit.simulated[:, firsts].T, offsets], axis=1))
        course = estimator.integrator.integrate(self._method, fit.system, self._segments, self._starts)
        residuals = estimator.residuals(course.states, self._starts, self._segments)
        blocks = estimator.blocks(self._segments, course.sensitivities, residuals, fit.errors, fit.system.count)
        self._normal, self._gradient = blocks.normal, blocks.gradient
        self._least = fitted.deviance_of(residuals)

    def within_bounds(self, constants: FloatArray) -> FloatArray:
        """Return the constants (P,) within their bounds."""
        return self._fit.system.with_values(constants).values

    def __call__(self, constants: FloatArray) -> float:
        system, estimator = self._fit.system.with_values(constants), self._fit.estimator
        course = estimator.integrator.integrate(
            self._method, system, self._segments, self._starts, has_sensitivities=False
        )
        if course.done < len(self._segments):
            return math.inf
        residuals = estimator.residuals(course.states, self._starts, self._segments)
        move = constants - self._fit.system.values
        expected = float(move @ (self._normal @ move - 2.0 * self._gradient))
        return max(self._fitted.deviance_of(residuals) - self._least - expected, 0.0)
