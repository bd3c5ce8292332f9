"""What a model costs: the nats it takes to say the data with it, and to say the model (Rissanen 1978).

    misfit + size ln 8 + 1 for each further use of a node + length of each constant

The misfit is minus the log-likelihood of independent Gaussian errors, up to a constant: their variance is fitted, but
never taken below the square of the target's uncertainty. With v = max(MSE, floor^2): n/2 (ln v + MSE/v - 1).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray, Target
from atoll.expression.operators import ARITY
from atoll.expression.program import Program, constant_places
from atoll_coordinator.model.regression.fit import Fitted
from atoll_coordinator.model.regression.simple_numbers import fitted_length
from atoll_coordinator.model.selection.front import SMALLEST_FLOOR

NODE_NATS: Final = math.log(8.0)
USE_NATS: Final = 1.0
_TINY: Final = 1e-290
_RIDGE: Final = 1e-14
_FLAT: Final = 1e-100


def program_length(program: Program) -> float:
    """Return the nats of a program without the values of its constants."""
    codes: list[int] = program.operators.tolist()
    uses = sum(ARITY[code] for code in codes)
    return NODE_NATS * len(program) + USE_NATS * (uses + 1 - len(program))


@dataclass(frozen=True)
class Criterion:
    """Measures models of one target with n `rows`; `limit` is the least variance of an error."""

    rows: int
    limit: float

    @classmethod
    def of(cls, target: Target) -> "Criterion":
        """Return the criterion for the models of `target`."""
        floor = max(target.uncertainty, SMALLEST_FLOOR) * target.standard_deviation
        return cls(len(target.values), max(floor * floor, _TINY))

    def variance(self, mse: float) -> float:
        """Return the variance of an error on one row."""
        return max(mse, self.limit)

    def misfit(self, mse: float) -> float:
        """Return the nats of the errors."""
        if not math.isfinite(mse):
            return math.inf
        variance = self.variance(mse)
        return 0.5 * self.rows * (math.log(variance) + mse / variance - 1.0)

    def mse_of(self, misfit: float) -> float:
        """Return the mean squared error of a misfit, the inverse of `misfit`; not below twice the limit."""
        return max(math.exp(min(2.0 * misfit / self.rows, 700.0)), 2.0 * self.limit)

    def covariance(self, fitted: Fitted) -> FloatArray:
        """Return the covariance (K, K) of the constants that were fitted, from the normal equations."""
        scale = np.sqrt(np.diag(fitted.normal))
        scale[scale < _FLAT] = _FLAT
        unit = fitted.normal / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        inverse = np.linalg.pinv(unit, hermitian=True)
        return np.asarray(self.variance(fitted.mse) * inverse / np.outer(scale, scale))

    def errors(self, fitted: Fitted) -> list[float]:
        """Return the standard errors of the constants that were fitted, all of the program's in node order."""
        variances: list[float] = np.diag(self.covariance(fitted)).tolist()
        return [math.sqrt(max(variance, 0.0)) for variance in variances]

    def length(self, fitted: Fitted) -> float:
        """Return the nats of a model all of whose constants were fitted."""
        misfit = self.misfit(fitted.mse)
        if not math.isfinite(misfit):
            return math.inf
        values = fitted.program.constants[constant_places(fitted.program)].tolist()
        numbers = sum(map(fitted_length, values, self.errors(fitted)))
        return misfit + program_length(fitted.program) + numbers
