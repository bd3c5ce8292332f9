"""Pieces of nearly clean trajectories: so short that a solver's errors do not add up to what a term would describe."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.selection.joint_search import ModellingTask
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program


def in_stretches(task: ModellingTask, programs: Sequence[Program]) -> ModellingTask:
    """Return the task with pieces so long that a system describes nearly clean trajectories in the fewest nats.

    Errors of a solver add up along a trajectory; an initial state for each piece, which takes 1/2 ln N for each number,
    ends that. Of a whole trajectory, terms that do not belong to the law would describe the sum of such errors.
    """
    lengths: dict[int, float] = {}
    for piece in (task.piece, *reversed(SETTINGS.shooting.lengths)):
        here = replace(task, piece=piece)
        comparison = here.compare(here.compared_measurements(), task.variables)
        model = comparison.fit_model(programs)
        if model is not None:
            lengths[piece] = _stretch_length(comparison, model) / comparison.estimator.measurements.rows
    best = min(lengths, key=lambda piece: (lengths[piece], -piece), default=task.piece)
    return replace(task, piece=best)


def _stretch_length(comparison: ModelComparison, model: FittedModel) -> float:
    """Return the nats of all errors, independent within pieces, and of all initial states."""
    counts, starts = comparison.counts, model.fit.starts.size
    free = np.maximum(counts - starts / len(counts), 1.0)
    variances = np.maximum(model.fit.squares * counts / free, comparison.least_errors**2)
    return float(0.5 * counts @ np.log(variances)) + starts * comparison.constant_nats
