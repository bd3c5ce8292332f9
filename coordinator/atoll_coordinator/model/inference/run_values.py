"""The values of a parameter that differs by run: one for each trajectory, with its error. Pure.

Such a parameter is a hidden state with the rate 0, so its value is the initial state of a trajectory. The errors are
those of the simulation at the first row, which contain the errors of the constants. A value that has no effect on its
trajectory is not determined: the normal matrix of the initial state tells this.
"""

import numpy as np

from atoll_coordinator.model.constants.standard_errors import ConstantErrors, estimate_covariance, student_quantile_95
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.result.equations import Constant, RunValue
from atoll_core.data.dataset import FloatArray


def values_by_run(
    name: str, fit: TrajectoryFit | None, errors: FloatArray | None, freedom: float, *, held_out: bool = False
) -> tuple[RunValue, ...]:
    """Return the values of the parameter `name` in the trajectories of a fit; empty without a fit.

    `errors` are the standard errors of simulated columns, then of hidden states, by row (None: not known). `freedom`
    are the degrees of freedom of Student's t.
    """
    if fit is None:
        return ()
    measurements, blocks = fit.estimator.measurements, fit.blocks
    state = measurements.variables.index(name)
    firsts, values = fit.segments[:, 0], fit.starts[:, state]
    if errors is None:
        deviations = np.full(len(values), np.inf)
    else:
        deviations = errors[len(measurements.observed) + measurements.hidden.index(state), firsts]
    ranges = measurements.start_ranges(measurements.bounds)
    lower, upper = (np.full(len(values), end) for end in (-np.inf, np.inf))
    if ranges is not None:
        lower, upper = (ends[:, state] for ends in ranges)
    on_bound = (values <= lower) | (values >= upper)
    free = np.zeros(blocks.own.shape[1], np.bool_)
    undetermined = [
        bool(estimate_covariance(own, starts, free)[1][state])
        for own, starts in zip(blocks.own, fit.starts, strict=True)
    ]
    reach = student_quantile_95(freedom) * deviations
    known = ConstantErrors(
        values, np.diag(deviations**2), np.array(undetermined), freedom, 1.0, lower, upper,
        {run: float(reach[run]) for run in np.flatnonzero(on_bound).tolist()},
    )  # fmt: skip
    names = [measurements.names[owner] for owner in measurements.owners.tolist()]
    described = [known.describe(number, float(value)) for number, value in enumerate(values)]
    return tuple(
        RunValue(run=run, held_out=held_out, **dict(one.replaced(identifiable=_is_determined(one))))
        for run, one in zip(names, described, strict=True)
    )


def _is_determined(one: Constant) -> bool:
    """Tell whether an interval does not contain 0, and is shorter than the range between the bounds."""
    return bool(one.identifiable) and (one.interval is None or one.interval != one.bounds)
