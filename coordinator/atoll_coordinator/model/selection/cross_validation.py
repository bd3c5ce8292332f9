"""How well a system predicts a trajectory that its constants were not fitted to: one left out at a time.

The constants are fitted to the other trajectories, begun where the fit to all ended; along the one left out only the
initial state is fitted (cross-validation, Stone 1974).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Validated:
    """What is left of the trajectories that were left out: R2 of each measured state, and the misfit in nats.

    The misfit is infinite and R2 minus infinity where they could not be simulated.
    """

    r2: tuple[float | None, ...]
    misfit: float


class Validation:
    """Leaves out the trajectories of a comparison, one at a time."""

    def __init__(self, comparison: ModelComparison) -> None:
        self._comparison = comparison
        measurements = comparison.estimator.measurements
        owners = sorted(set(measurements.owners.tolist()))
        count = min(len(owners), SETTINGS.effort.beam)
        self._folds = [frozenset(owners[fold::count]) for fold in range(count)]
        self.is_possible: Final = count >= SETTINGS.selection.least_folds and comparison.groups is None
        """Whether there are enough trajectories, and the constants of one are those of the others."""

    def of(self, model: FittedModel) -> Validated | None:
        """Return how well the system of `model` predicts; None where time is over: fits that end early tell nothing."""
        deadline = self._comparison.estimator.deadline
        measurements = self._comparison.estimator.measurements
        squares, whitened, total = np.zeros((3, len(measurements.observed)))
        for left_out in self._folds:
            errors = None if deadline.is_over else self._squared_errors(model, left_out)
            if deadline.is_over:
                return None
            if errors is None:
                return Validated(tuple(-np.inf for _ in measurements.observed), np.inf)
            squares += errors[0]
            whitened += errors[1]
            total += _total_squares(measurements.part(left_out))
        r2 = [1.0 - left / whole if whole > 0.0 else None for left, whole in zip(squares, total, strict=True)]
        counts = self._comparison.counts
        misfit = self._comparison.misfit.total(whitened / counts)
        return Validated(tuple(r2), misfit)

    def _squared_errors(self, model: FittedModel, left_out: frozenset[int]) -> tuple[FloatArray, FloatArray] | None:
        """Return the sums of squared errors (O,) along trajectories left out, as they are and without what goes
        together in errors of measurement; None where they cannot be simulated."""
        comparison, fit = self._comparison, model.fit
        measurements = comparison.estimator.measurements
        is_out = np.isin(measurements.owners, list(left_out))
        others = self._shooter(measurements.part(set(measurements.owners.tolist()) - left_out))
        fitted = others.fit(
            comparison.system(model.programs),
            None,
            SETTINGS.effort.steps,
            fit.starts[~is_out],
            fit.errors,
        )
        if fitted is None:
            return None
        rest = self._shooter(measurements.part(left_out))
        fixed = fitted.system.with_fixed_constants()
        predicted = rest.fit(fixed, None, SETTINGS.effort.steps, fit.starts[is_out], fit.errors)
        if predicted is None:
            return None
        weights, errors = rest.measurements.weights, comparison.errors
        whitened = predicted.residuals if errors is None else rest.whitened(predicted.residuals, errors)
        return (weights * predicted.residuals**2).sum(axis=1), (weights * whitened**2).sum(axis=1)

    def _shooter(self, measurements: Measurements) -> MultipleShooting:
        whole = self._comparison.estimator
        return MultipleShooting(measurements, whole.tolerance, whole.deadline)


def _total_squares(measurements: Measurements) -> FloatArray:
    """Return the sums of squared deviations (O,) from the mean along these trajectories."""
    known = measurements.weights > 0.0
    values = np.where(known, measurements.measured, 0.0)
    means = (measurements.weights * values).sum(axis=1) / np.maximum(measurements.weights.sum(axis=1), 1.0)
    return np.asarray((measurements.weights * np.where(known, values - means[:, None], 0.0) ** 2).sum(axis=1))
