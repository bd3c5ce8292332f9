"""Cross-validation: how well a system predicts trajectories to which its constants were not fitted.

Each fold leaves out one trajectory (Stone 1974), or several if there are many trajectories. The constants are fitted to
the other trajectories, starting from the fit to all trajectories. Along the trajectories that were left out, only the
initial state is fitted. Doubt: all trajectories were used to choose the equations. So only the constants are validated,
and not the structure.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction
from atoll_coordinator.model.selection.comparison import ComparisonParts, ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program

R2 = tuple[float | None, ...]
"""R2 of each measured state along trajectories that were left out. It is minus infinity if these trajectories could not
be simulated, and None if the state is constant along them."""

_LEAST_FOLDS: Final = 3
"""Fewest trajectories for cross-validation: with fewer, too few rows remain for fitting constants."""


@dataclass(frozen=True, eq=False)
class Fold:
    """The `programs`, `starts` and `errors` of a fit to all trajectories, and the trajectories to leave out; with a
    template, also the values of its parameters."""

    programs: tuple[Program, ...]
    starts: FloatArray
    errors: ErrorModel
    left_out: frozenset[int]
    parameters: FloatArray | None = None


class Validation:
    """Leaves out the trajectories of a comparison, one at a time."""

    def __init__(self, comparison: ModelComparison) -> None:
        self._comparison = comparison
        measurements = comparison.estimator.measurements
        owners = sorted(set(measurements.owners.tolist()))
        count = min(len(owners), SETTINGS.effort.beam)
        self._folds = [frozenset(owners[fold::count]) for fold in range(count)]
        self.is_possible: Final = count >= _LEAST_FOLDS and comparison.groups is None
        """Whether cross-validation is possible: there are enough trajectories, and they all have the same constants."""

    def of(self, model: FittedModel) -> R2 | None:
        """Return the R2 of the system of `model`. None if the time is over, since a fit that ends early cannot be
        used."""
        comparison, fit = self._comparison, model.fit
        measurements = comparison.estimator.measurements
        squares, total = np.zeros((2, len(measurements.observed)))
        parameters = fit.system.parameter_values
        folds = [Fold(model.programs, fit.starts, fit.errors, left_out, parameters) for left_out in self._folds]
        found = comparison.spread.map(FOLDS, lambda: comparison, folds, parts=lambda: comparison.parts)
        for left_out, errors in zip(self._folds, found, strict=True):
            if comparison.estimator.deadline.is_over or errors is None:
                return None
            squares += errors
            total += _total_squares(measurements.part(left_out))
        return tuple(1.0 - left / whole if whole > 0.0 else None for left, whole in zip(squares, total, strict=True))


def squared_errors(comparison: ModelComparison, fold: Fold) -> FloatArray:
    """Return the sums of squared errors (O,) along trajectories left out; they are infinite if these trajectories
    cannot be simulated."""
    whole, steps = comparison.estimator, SETTINGS.effort.steps
    measurements, left_out = whole.measurements, fold.left_out
    is_out = np.isin(measurements.owners, list(left_out))
    unknown = np.full(len(measurements.observed), np.inf)
    if whole.deadline.is_over:
        return unknown
    others = _make_estimator(whole, measurements.part(set(measurements.owners.tolist()) - left_out))
    fitted = others.fit(
        comparison.system(fold.programs, parameters=fold.parameters), None, steps, fold.starts[~is_out], fold.errors
    )
    if fitted is None:
        return unknown
    rest = _make_estimator(whole, measurements.part(left_out))
    predicted = rest.fit(fitted.system.with_fixed_constants(), None, steps, fold.starts[is_out], fold.errors)
    return unknown if predicted is None else (rest.measurements.weights * predicted.residuals**2).sum(axis=1)


def _make_estimator(whole: MultipleShooting, measurements: TrajectoryMeasurements) -> MultipleShooting:
    return MultipleShooting(measurements, whole.tolerance, whole.deadline, spread=whole.integrator.spread)


FOLDS: Final[BatchFunction[ModelComparison, Fold, FloatArray]] = BatchFunction(
    "folds", ComparisonParts, Fold, FloatArray, squared_errors, ModelComparison.from_parts
)
"""The batch function for folds: systems are fitted without some trajectories, and their squared errors on these
trajectories are summed."""


def _total_squares(measurements: TrajectoryMeasurements) -> FloatArray:
    """Return the sums of squared deviations (O,) from the mean along these trajectories."""
    known = measurements.weights > 0.0
    values = np.where(known, measurements.measured, 0.0)
    means = (measurements.weights * values).sum(axis=1) / np.maximum(measurements.weights.sum(axis=1), 1.0)
    return np.asarray((measurements.weights * np.where(known, values - means[:, None], 0.0) ** 2).sum(axis=1))
