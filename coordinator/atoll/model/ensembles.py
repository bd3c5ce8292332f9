"""Paths of the stochastic process that a model is, and the density that they settle into.

Letters: S states, U inputs, N times.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll.model.simulation import MOST_NUMBERS, Inputs, check_times
from atoll_coordinator.result.findings import Process
from atoll_coordinator.stochastic.densities import STEPS, StationaryDensity, density_of, settled_paths
from atoll_coordinator.stochastic.moments import StepMoments, step_moments
from atoll_coordinator.stochastic.paths import Ensemble, Simulator, divided, step_counts
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.text.parsing import from_infix

if TYPE_CHECKING:
    from atoll.model.model import Model

MOST_STEPS: Final = 200_000
"""Steps of an ensemble: some minutes."""


def ensemble_of(
    model: "Model", x0: FloatArray, times: FloatArray, inputs: Inputs | None, drawn: tuple[int, int]
) -> Ensemble:
    """Return paths from `x0` (S,) at the first of the `times` (N,), which ascend.

    Between two times steps are no longer than those of the measurements; `inputs` are held in each at their value in
    its middle. `drawn` are the number of paths and their seed. Raises UsageError.
    """
    simulator, longest = _simulator(model, *drawn), process_of(model).step
    check_times(model.field, x0, times, drawn[0])
    count = float(step_counts(times, longest).sum())
    if count > MOST_STEPS:
        what = f"{count:.15g} steps of {longest:g}, that of the measurements, are more than {MOST_STEPS}"
        raise UsageError(f"{what}; simulate less time")
    begins, lengths, is_kept = divided(times, longest)
    middles = (begins + 0.5 * lengths).tolist()
    held = np.zeros((0, len(middles))) if inputs is None else np.array([inputs(at) for at in middles]).T
    paths = simulator.paths(np.repeat(x0[:, None], drawn[0], axis=1), held, lengths, is_kept)
    return Ensemble(model.states, times, paths.transpose(2, 0, 1), model.time)


def density_of_process(
    model: "Model", x0: FloatArray, inputs: Sequence[float], drawn: tuple[int, int]
) -> StationaryDensity | None:
    """Return the density that paths from `x0` (S,) settle into, `inputs` (U,) held; None where they do not settle."""
    simulator = _simulator(model, *drawn, least=2)  # one path tells no error of its means
    check_times(model.field, x0, np.zeros(1))
    most = MOST_NUMBERS // ((STEPS + 1) * len(x0))
    if drawn[0] > most:
        raise UsageError(f"{drawn[0]} paths are more than {most}, those of which a density is taken; draw fewer")
    starts = np.repeat(x0[:, None], drawn[0], axis=1)
    paths = settled_paths(simulator, starts, np.array(inputs), process_of(model).step)
    return None if paths is None else density_of(model.states, paths)


def process_of(model: "Model") -> Process:
    """Return the process; raises UsageError where the model has no noise, or its result does not say its steps."""
    process = model.result.process
    if not model.components:
        raise UsageError("the model has no noise of its own, so it has no paths; --stochastic seeks such models")
    if process is None:
        raise UsageError("this result has equations of noise but nothing as 'process'; give it as it was written")
    return process


def _simulator(model: "Model", paths: int, seed: int, *, least: int = 1) -> Simulator:
    """Return what draws paths; raises UsageError where there is nothing to draw."""
    for name, value, lower in (("paths", paths, least), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < lower:
            raise UsageError(f"{name} must be a whole number of at least {lower}, but {value!r} was given")
    names = (*model.states, *model.inputs)
    texts = {equation.variable: equation.exact for equation in model.equations}
    diffusion = {pair: from_infix(texts[name], names) for name, pair in model.components.items()}
    drift, discretisation = model.field.programs, process_of(model).discretisation

    def moments(points: FloatArray, lengths: FloatArray) -> StepMoments:
        return step_moments(drift, diffusion, points, lengths, discretisation)

    return Simulator(moments, np.random.default_rng(seed))
