"""The errors of measured states, by which a fit weighs its residuals, and their estimate from residuals. Pure.

The errors of a state have one variance, in a row of weight 1. A share of it may be correlated between neighbouring
rows (see `atoll_coordinator.model.shooting.kernels.innovations`), as in errors of simulators, filters and drifting
sensors.
Letters: O measured states, N rows.
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
    """Errors of O states: `sigmas` are their standard deviations, `shares` the correlated shares of the variances,
    `decays` the correlation of these shares between rows one median step apart. All are (O,).

    A fit estimates `sigmas`, unless these errors are `is_known`; `shares` and `decays` stay as they are.
    """

    sigmas: FloatArray
    shares: FloatArray
    decays: FloatArray
    is_known: bool = False

    @classmethod
    def independent(cls, sigmas: FloatArray) -> "ErrorModel":
        """Return independent errors of these standard deviations."""
        return cls(sigmas, np.zeros(len(sigmas)), np.zeros(len(sigmas)))

    @property
    def degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of a variance of each state (O,) over its rows: 1 where errors are independent.

        An estimated correlation r, of variance (1 - r^2)/n, makes the logarithm of (1 + r)/(1 - r), which the variance
        of a mean is multiplied by, uncertain by 4/(n (1 - r^2)); the innovations' variance by 2/n (Satterthwaite 1946).
        """
        return np.asarray(1.0 / (1.0 + (self.shares > 0.0) * 2.0 / (1.0 - self.decays**2)))

    @property
    def lengths(self) -> FloatArray:
        """Rows that count as one independent row each (O,): the ratio of variances of a mean.

        (1 + r) / (1 - r) if all errors are correlated, 1 if none are.
        """
        return np.asarray(1.0 - self.shares + self.shares * (1.0 + self.decays) / (1.0 - self.decays))


class Innovations:
    """Whitens the residuals of one layout of rows.

    `segments` (G, 2) are row ranges, `steps` (N,) from the row before over their median, `weights` (O, N).
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
        """Return for each state the sum of squared innovations of `residuals` (O, N) over their relative variance, and
        the sum of these variances' logarithms."""
        sums = np.empty((len(residuals), 2))
        for state, (share, decay) in enumerate(zip(model.shares.tolist(), model.decays.tolist(), strict=True)):
            self._innovate(state, residuals, share, decay, sums[state])
        return sums[:, 0], sums[:, 1]

    def whitened(self, residuals: FloatArray, model: ErrorModel) -> FloatArray:
        """Return the innovations (O, N) of `residuals` (O, N), as independent as errors of one size."""
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
        """Return the errors of measurement in these residuals, which may hold errors of the law as well.

        Correlated residuals of neighbouring rows are errors of the sensor if they are rough: an
        Ornstein-Uhlenbeck process describes them in fewer nats than independent errors, and than a smooth process.
        Errors of the law are smooth, since they add up along the trajectory, and their derivatives vary no faster than
        the derivative of the state. If residuals are not rough in this sense, errors are treated as independent.

        Args:
            residuals: (O, N).
            sigmas: their standard deviations (O,).
            fitted: how many numbers were fitted for each state.
            turns: rows (O,) after which the correlation of the derivative has fallen to 1/e.
        """
        shares, decays = self.estimate(residuals, fitted)
        for state in np.flatnonzero(shares).tolist():
            if self._is_smooth(state, residuals, float(shares[state]), float(decays[state]), float(turns[state])):
                shares[state] = decays[state] = 0.0
        found = ErrorModel(sigmas, shares, decays)
        squares, _ = self.squares(residuals, found)
        return replace(found, sigmas=np.where(shares > 0.0, np.sqrt(squares / np.maximum(self._counts, 1.0)), sigmas))

    def _is_smooth(self, state: int, residuals: FloatArray, share: float, decay: float, turn: float) -> bool:
        """Tell whether a smooth process whose derivative turns in `turn` rows or more is likelier than a rough one."""
        sums, room = np.empty(2), (*np.empty((3, 3, 3)), np.empty((2, 3)))
        self._innovate(state, residuals, share, decay, sums)
        rough, length = self._length(state, sums), turn  # (1 + x - x^2) exp(-x), of the derivative, is 1/e at x = 1
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
        """Return minus the logarithm of the likelihood of errors with these sums, their variance fitted."""
        count = float(self._counts[state])
        return 0.5 * count * math.log(max(float(sums[0]) / count, 1e-300)) + 0.5 * float(sums[1])

    def estimate(self, residuals: FloatArray, fitted: float) -> tuple[FloatArray, FloatArray]:
        """Return the shares and decays (O,) of least description length for these residuals (O, N).

        A correlation is described by two numbers more, which take ln n nats (Schwarz 1978). Residuals of fitted slow
        curves are less correlated than the errors: with `fitted` numbers for each state, the decay d is too small by
        (2 d + (1 + d) `fitted`)/n, which is added (for a mean, `fitted` 1, Marriott & Pope 1954).
        """
        shares, decays = np.zeros((2, len(residuals)))
        for state in np.flatnonzero(self._counts).tolist():
            share, decay = self._estimated(state, residuals)
            missed = (2.0 * decay + (1.0 + decay) * fitted) / float(self._counts[state]) if share else 0.0
            shares[state], decays[state] = share, min(decay + missed, max(decay, self._decays[-1]))
        return shares, decays

    def _estimated(self, state: int, residuals: FloatArray) -> tuple[float, float]:
        """Return the share and the decay of one state by a descent on the grid of both."""
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
