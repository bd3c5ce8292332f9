"""The error model of measured states, and its estimation from residuals. The error model weights the residuals of a
fit. Pure.

The errors of a state have one variance for rows of weight 1. A share of this variance may be correlated between
neighbouring rows (an Ornstein-Uhlenbeck process, see `atoll_coordinator.model.shooting.kernels.innovations`), as in the
errors of simulators, filters and drifting sensors. `Innovations` whitens residuals by the Kalman filter of this
process, and chooses the share and the decay with the shortest description from a grid. Doubt: correlated residuals may
also be errors of the law. So only rough residuals count as errors of a sensor. Letters: O measured states, N rows.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.kernels.innovations import innovate, innovate_smooth
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_SHARES: Final = (0.0, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0)
_RATIO: Final = 1.6
_SHORTEST: Final = 1.6
_SMOOTH_SHARES: Final = (*_SHARES[1:-1], 0.99, 0.997, 0.999, 0.9999, 0.99999)
_NOTHING: Final = np.empty(0)


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The errors of O measured states. All arrays are (O,).

    `sigmas` are standard deviations, and `shares` the correlated shares of the variances. `decays` are the correlations
    of the correlated parts of the errors between two rows whose distance is the median time step.

    A fit estimates `sigmas`, unless the errors are known (`is_known`); `shares` and `decays` are constant in a fit.
    """

    sigmas: FloatArray
    shares: FloatArray
    decays: FloatArray
    is_known: bool = False

    @classmethod
    def independent(cls, sigmas: FloatArray) -> "ErrorModel":
        """Return the model of independent errors with these standard deviations."""
        return cls(sigmas, np.zeros(len(sigmas)), np.zeros(len(sigmas)))

    @property
    def degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of the estimated variance of each state (O,), divided by the number of rows. It is 1 if
        errors are independent.

        If neighbouring errors have the correlation r, the variance of a mean is multiplied by (1 + r)/(1 - r). With n
        rows, the estimated correlation r has the variance (1 - r^2)/n. So the logarithm of this factor has the variance
        4/(n (1 - r^2)). The logarithm of the innovations' variance has the variance 2/n. The degrees of freedom follow
        from the sum of both (Satterthwaite 1946).
        """
        return np.asarray(1.0 / (1.0 + (self.shares > 0.0) * 2.0 / (1.0 - self.decays**2)))

    @property
    def lengths(self) -> FloatArray:
        """Number of rows (O,) that count as one independent row: the ratio of the variance of a mean to its variance
        for independent errors.

        It is (1 + r) / (1 - r) if all errors have the correlation r, and 1 if no errors are correlated.
        """
        return np.asarray(1.0 - self.shares + self.shares * (1.0 + self.decays) / (1.0 - self.decays))


class Innovations:
    """Whitens the residuals of one layout of rows.

    `segments` (G, 2) are row ranges; `steps` (N,) are the time steps from the previous row, divided by the median step;
    `weights` are (O, N).
    """

    def __init__(self, segments: Ints, steps: FloatArray, weights: FloatArray) -> None:
        self.segments: Final = segments
        self._steps = steps
        self._weights = weights
        self._counts = weights.sum(axis=1)
        longest = int((segments[:, 1] - segments[:, 0]).max())
        lengths = [_SHORTEST]
        while lengths[-1] * _RATIO < longest:
            lengths.append(lengths[-1] * _RATIO)
        self._decays: Final = [1.0 - 1.0 / length for length in lengths]

    def squares(self, residuals: FloatArray, model: ErrorModel) -> tuple[FloatArray, FloatArray]:
        """Return two sums for each state (O,). The first is the sum of the squared innovations of `residuals` (O, N),
        each divided by its relative variance. The second is the sum of the logarithms of these relative variances."""
        sums = np.empty((len(residuals), 2))
        for state, (share, decay) in enumerate(zip(model.shares.tolist(), model.decays.tolist(), strict=True)):
            self._innovate(state, residuals, share, decay, sums[state])
        return sums[:, 0], sums[:, 1]

    def whiten(self, residuals: FloatArray, model: ErrorModel) -> FloatArray:
        """Return the innovations (O, N) of `residuals` (O, N). They are independent, and all innovations of a state
        have the same variance."""
        whitened, sums = np.zeros_like(residuals), np.empty(2)
        for state, (share, decay) in enumerate(zip(model.shares.tolist(), model.decays.tolist(), strict=True)):
            self._innovate(state, residuals, share, decay, sums, whitened[state])
        return whitened

    def _innovate(
        self, state: int, residuals: FloatArray, share: float, decay: float, sums: FloatArray,
        whitened: FloatArray = _NOTHING,
    ) -> None:  # fmt: skip
        innovate(self.segments, self._steps, residuals[state], self._weights[state], share, decay, sums, whitened)

    def sensor_errors(self, residuals: FloatArray, sigmas: FloatArray, fitted: float, turns: FloatArray) -> ErrorModel:
        """Return the model of the errors of measurement in these residuals. The residuals may also contain errors of
        the law.

        Correlated residuals count as errors of the sensor if they are rough: then an Ornstein-Uhlenbeck process
        describes the residuals in fewer nats than independent errors, and in fewer nats than a smooth process. Errors
        of the law are smooth: they add up along the trajectory, and their derivatives vary no faster than the
        derivative of the state. If residuals are not rough in this sense, errors are treated as independent.

        Args:
            residuals: residuals (O, N).
            sigmas: their standard deviations (O,).
            fitted: number of fitted numbers per state.
            turns: for each state (O,), the lag in rows at which the autocorrelation of the derivative has fallen to
                1/e.
        """
        shares, decays = self.estimate(residuals, fitted)
        for state in np.flatnonzero(shares).tolist():
            if self._is_smooth(state, residuals, float(shares[state]), float(decays[state]), float(turns[state])):
                shares[state] = decays[state] = 0.0
        found = ErrorModel(sigmas, shares, decays)
        squares, _ = self.squares(residuals, found)
        return replace(found, sigmas=np.where(shares > 0.0, np.sqrt(squares / np.maximum(self._counts, 1.0)), sigmas))

    def _is_smooth(self, state: int, residuals: FloatArray, share: float, decay: float, turn: float) -> bool:
        """Tell whether a smooth process is more probable than a rough process. The derivative of the smooth process is
        correlated over at least `turn` rows."""
        sums, room = np.empty(2), (*np.empty((3, 3, 3)), np.empty((2, 3)))
        self._innovate(state, residuals, share, decay, sums)
        rough, length = self._length(state, sums), turn  # its correlation (1 + x - x^2) exp(-x) is 1/e at x = 1
        longest = max(length, int((self.segments[:, 1] - self.segments[:, 0]).max()))
        while length <= longest:
            for part in _SMOOTH_SHARES:
                innovate_smooth(
                    self.segments, self._steps, residuals[state], self._weights[state], part, 1.0 / length, sums, *room
                )
                if self._length(state, sums) < rough:
                    return True
            length *= _RATIO
        return False

    def _length(self, state: int, sums: FloatArray) -> float:
        """Return minus the log-likelihood of errors with these sums; their variance is fitted."""
        count = float(self._counts[state])
        return 0.5 * count * math.log(max(float(sums[0]) / count, 1e-300)) + 0.5 * float(sums[1])

    def estimate(self, residuals: FloatArray, fitted: float) -> tuple[FloatArray, FloatArray]:
        """Return the shares and decays (O,) with which these residuals (O, N) have the shortest description.

        Correlated errors need two more numbers, which cost ln n nats together (Schwarz 1978). Residuals of fitted slow
        curves are less correlated than the errors. With `fitted` numbers for each state, the estimated decay d is too
        small by (2 d + (1 + d) `fitted`)/n, and this bias is corrected (Marriott & Pope 1954, for the fit of a mean:
        `fitted` is 1).
        """
        shares, decays = np.zeros((2, len(residuals)))
        for state in np.flatnonzero(self._counts).tolist():
            share, decay = self._estimate_state(state, residuals)
            missed = (2.0 * decay + (1.0 + decay) * fitted) / float(self._counts[state]) if share else 0.0
            shares[state], decays[state] = share, min(decay + missed, max(decay, self._decays[-1]))
        return shares, decays

    def _estimate_state(self, state: int, residuals: FloatArray) -> tuple[float, float]:
        """Return the share and the decay of one state, found by a descent on a grid of both. Both are zero if errors
        are independent."""
        sums, count = np.empty(2), float(self._counts[state])
        lengths: dict[tuple[int, int], float] = {}

        def length(place: tuple[int, int]) -> float:
            if place not in lengths:
                self._innovate(state, residuals, _SHARES[place[0]], self._decays[place[1]], sums)
                lengths[place] = self._length(state, sums)
            return lengths[place]

        independent = length((0, 0))
        last, top = len(_SHARES) - 1, len(self._decays) - 1
        best = min([(4, min(3, top)), (last, min(6, top))], key=length)
        while True:
            near = [
                (part, rate)
                for part in range(max(best[0] - 1, 1), min(best[0] + 1, last) + 1)
                for rate in range(max(best[1] - 1, 0), min(best[1] + 1, top) + 1)
            ]
            following = min(near, key=length)
            if length(following) >= length(best):
                break
            best = following
        if length(best) + math.log(max(count, 2.0)) >= independent:
            return 0.0, 0.0
        return _SHARES[best[0]], self._decays[best[1]]
