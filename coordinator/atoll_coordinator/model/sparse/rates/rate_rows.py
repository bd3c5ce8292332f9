"""The derivative sought of one state on all rows that are not held out, with its errors and all variables."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import Recording, Trajectory
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class RateRows:
    """Rows of one equation: `inputs` (V, N), derivatives, their `values` (N,) and standard `errors` (N,), above 0."""

    inputs: FloatArray
    values: FloatArray
    errors: FloatArray

    def trusted(self) -> "RateRows":
        """Return the share of the rows that are known best, and those known as well.

        Errors of interpolation are not normal: where a state changes too fast for the sampling, a few are a hundred
        times as large as the estimate says.
        """
        count = max(int(SETTINGS.rates.trusted_share * len(self.values)), 1)
        rows = self.errors <= np.sort(self.errors)[count - 1]
        return RateRows(np.ascontiguousarray(self.inputs[:, rows]), self.values[rows], self.errors[rows])


def rate_rows(recording: Recording, names: Sequence[str], variable: str) -> RateRows | None:
    """Return the rows of the equation of `variable`, a state; `names` (V,) are symbols of states, rates and inputs.

    None where derivatives were not kept, or all are alike. Errors are at least those of a solver. More rows than
    `RowSettings.most` are thinned, as those of the search are.
    """
    parts = [trajectory for trajectory in recording.trajectories if not trajectory.held_out]
    symbols = (*recording.state_symbols, *recording.velocity_symbols, *recording.input_symbols)
    places, state = [symbols.index(name) for name in names], recording.states.index(variable)
    columns, values, errors = [], [], []
    for part in parts:
        if part.rates is None or part.rate_errors is None:
            return None
        velocities = part.slopes if recording.velocity_symbols else part.slopes[:0]
        columns.append(np.concatenate([part.smoothed, velocities, part.inputs])[places])
        values.append(part.rates[state])
        errors.append(_spread(part, state))
    inputs, rates, uncertainty = np.concatenate(columns, axis=1), np.concatenate(values), np.concatenate(errors)
    known = np.isfinite(uncertainty) & np.isfinite(rates) & np.isfinite(inputs).all(axis=0)
    if not known.any():
        return None
    least = SETTINGS.shooting.exact * moments(rates[known])[1]
    if not least > 0.0:
        return None
    rows = np.flatnonzero(known)
    rows = rows[thinned_places(len(rows), SETTINGS.rows.most)]
    return RateRows(np.ascontiguousarray(inputs[:, rows]), rates[rows], np.maximum(uncertainty[rows], least))


def _spread(part: Trajectory, state: int) -> FloatArray:
    """Return for each row the largest error of it and its neighbours: one alone may be small by chance."""
    assert part.rate_errors is not None
    errors = part.rate_errors[state].copy()
    errors[1:] = np.maximum(errors[1:], part.rate_errors[state, :-1])
    errors[:-1] = np.maximum(errors[:-1], part.rate_errors[state, 1:])
    return np.asarray(errors)
