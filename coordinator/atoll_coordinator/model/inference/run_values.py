"""The values of a parameter that differs by run: one for each trajectory, with its error. Pure.

Such a parameter is a hidden state with the rate 0, so its value is the initial state of a trajectory. The errors are
those of the simulation at the first row, which contain the errors of the constants. A value that has no effect on its
trajectory is not determined: the normal matrix of the initial state tells this.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from atoll_coordinator.model.constants.standard_errors import ConstantErrors, estimate_covariance, student_quantile_95
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.result.equations import Constant, RunValue
from atoll_core.data.dataset import FloatArray

Simulation = tuple[TrajectoryFit | None, FloatArray | None]
"""A fit of initial states (None: it failed), and the standard errors of its columns, then hidden states, by row (None:
not known)."""


def values_by_run(
    names: Sequence[str], simulations: Sequence[Simulation], freedom: float
) -> dict[str, tuple[RunValue, ...]]:
    """Return the values of parameters by name: in the trajectories to which equations were fitted, then in the held-out
    trajectories. `freedom` are the degrees of freedom of Student's t."""
    return {
        name: tuple(
            value.replaced(held_out=bool(place))
            for place, (fit, errors) in enumerate(simulations)
            for value in (() if fit is None else _values_in(name, fit, errors, freedom))
        )
        for name in names
    }


def _values_in(name: str, fit: TrajectoryFit, errors: FloatArray | None, freedom: float) -> Iterator[RunValue]:
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
    for run, one in zip(names, described, strict=True):
        yield RunValue(run=run, **dict(one.replaced(identifiable=_is_determined(one))))


def _is_determined(one: Constant) -> bool:
    """Tell whether an interval does not contain 0, and is shorter than the range between the bounds."""
    return bool(one.identifiable) and (one.interval is None or one.interval != one.bounds)
