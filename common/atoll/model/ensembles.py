"""Paths of the stochastic process that a model is, and the density that they settle into.

Letters: S states, U inputs, N times.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.errors import UsageError
from atoll.expression.text.parsing import from_infix
from atoll.model.simulation import Inputs, check_times
from atoll.stochastic.densities import StationaryDensity, density_of, settled_paths
from atoll.stochastic.moments import StepMoments, step_moments
from atoll.stochastic.paths import Ensemble, Simulator, divided

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
    simulator, longest = _simulator(model, *drawn), _step(model)
    check_times(model.field, x0, times, drawn[0])
    begins, lengths, is_kept = divided(times, longest)
    if len(lengths) > MOST_STEPS:
        what = f"{len(lengths)} steps of {longest:g}, that of the measurements, are more than {MOST_STEPS}"
        raise UsageError(f"{what}; simulate less time")
    middles = (begins + 0.5 * lengths).tolist()
    held = np.zeros((0, len(middles))) if inputs is None else np.array([inputs(at) for at in middles]).T
    found = simulator.paths(np.repeat(x0[:, None], drawn[0], axis=1), held, lengths, is_kept)
    return Ensemble(model.states, times, found.transpose(2, 0, 1), model.time)


def density_of_process(
    model: "Model", x0: FloatArray, inputs: Sequence[float], drawn: tuple[int, int]
) -> StationaryDensity | None:
    """Return the density that paths from `x0` (S,) settle into, `inputs` (U,) held; None where they do not settle."""
    simulator = _simulator(model, *drawn)
    check_times(model.field, x0, np.zeros(1), drawn[0])
    paths = settled_paths(simulator, np.repeat(x0[:, None], drawn[0], axis=1), np.array(inputs), _step(model))
    return None if paths is None else density_of(model.states, paths)


def _step(model: "Model") -> float:
    """Return the median step of the measurements."""
    return float(model.result["process"]["step"])


def _simulator(model: "Model", paths: int, seed: int) -> Simulator:
    """Return what draws paths; raises UsageError where the model has no noise, or there is nothing to draw."""
    if not model.components:
        raise UsageError("the model has no noise of its own, so it has no paths; --stochastic seeks such models")
    for name, value, least in (("paths", paths, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise UsageError(f"{name} must be a whole number of at least {least}, but {value!r} was given")
    names = (*model.states, *model.inputs)
    texts = {each["variable"]: each["expression"] for each in model.result["equations"]}
    diffusion = {pair: from_infix(texts[name], names) for name, pair in model.components.items()}
    drift, discretisation = model.field.programs, model.result["process"].get("discretisation", "local linearisation")

    def moments(points: FloatArray, lengths: FloatArray) -> StepMoments:
        return step_moments(drift, diffusion, points, lengths, discretisation)

    return Simulator(moments, np.random.default_rng(seed))
