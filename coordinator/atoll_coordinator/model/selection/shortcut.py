"""The model where each state has a law by sparse regression whose residuals are noise: no search around it.

Such laws were chosen from all products up to a degree, on many more rows than there are products. They are then
fitted to trajectories together, in pieces as long as errors of the initial states allow, unnecessary parts are left
out, and the few possible systems are compared. If the fit does not reach the noise, all stages run.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.joint_search import combine, compare_rivals, exchange, fit_jointly
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.piece_lengths import in_stretches
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit, growth_rate
from atoll_coordinator.model.sparse.laws import find_all_laws
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program
from atoll_core.expression.writing.shortest import shortest

_LEAST_SIZE: Final = 1e-4
"""Errors are taken to be so large, at least. They grow to the root of that, g-fold; the normal equations of constants
and initial states lose the share g^4 of their double precision, here to 1e-4."""


def with_laws(task: ModellingTask) -> ModellingTask:
    """Return the task with the laws of sparse regression of each variable that is sought, if it has none yet."""
    if task.laws:
        return task
    others = {name: task.candidates[name].programs for name in task.variables}
    preparation = Preparation(task.dataset, task.recording)
    laws_by_name = find_all_laws(preparation, task.config, others, task.among_many, task.spread)
    return replace(task, laws={name: laws for name, laws in laws_by_name.items() if name in task.variables})


def select_by_laws(task: ModellingTask) -> SelectedModel | None:
    """Return the model that the laws give, None where one of them does not stand at the noise level."""
    if task.recording.groups:
        return None  # laws of one group are candidates for all
    lists = [_programs(task, name) for name in task.variables]
    if not all(lists) or not task.laws:
        return None
    selection = fit_laws_together(task, lists)
    if selection is None:
        return None
    if all(task.laws.values()):
        return selection if selection.is_like_noise else None
    return selection if selection.comparison.score.is_exact(selection.model) else None


def laws_in_short_pieces(task: ModellingTask) -> SelectedModel | None:
    """Return the best system of laws that stand at the noise level; None unless every variable has one or is known.

    A choice with a time limit begins with it, since it takes little more than a fit. Unlike in `select_by_laws`, laws
    may come from few rows, and other programs may describe these about as well.
    """
    if task.recording.groups:
        return None
    lists = [
        [task.known[name]] if name in task.known else [shortest(law.program) for law in standing_laws(task, name)]
        for name in task.variables
    ]
    if not all(lists):
        return None
    short = replace(task, piece=min(task.piece, SETTINGS.shooting.lengths[-1]))
    begun = combine(short.comparison, lists)
    if begun is None:
        return None
    comparison, begun = short.comparison.calibrated(begun)
    best = exchange(comparison, begun, lists)
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    sought = [equation for equation in range(len(lists)) if equation not in comparison.fixed]
    for equation in sought:
        best = descent.prune(best, equation)
    for equation in sought:
        compare_rivals(comparison, best, equation, lists[equation])
    return SelectedModel(short, comparison, best, lists)


def standing_laws(task: ModellingTask, name: str) -> list[Law]:
    """Return the laws of one variable, the best first, if the residuals of the best are noise."""
    laws = [law for law in task.laws.get(name, ()) if task.may_be_shown(law.program)]
    return laws if laws and laws[0].excess <= SETTINGS.inference.excess else []


def fit_laws_together(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> SelectedModel | None:
    """Return the best system of these candidates, None where none can be simulated or the long way tells more."""
    short = replace(task, piece=min(task.piece, SETTINGS.shooting.lengths[-1]))
    begun = _begun(short, lists)
    if begun is None:
        return None
    predictable = predictable_rows(begun.model.fit, begun.comparison, growth_rate(begun.model.fit))
    rows = int(min(max(predictable, SETTINGS.shooting.lengths[1]), SETTINGS.shooting.piece))
    are_lawful = all(name in task.lawful for name, laws in task.laws.items() if laws)
    if _rows(task) <= SETTINGS.selection.compared_rows and rows >= task.longest and not are_lawful:
        return None
    task = replace(task, piece=min(task.piece, rows))
    if task.is_nearly_clean:
        task = in_stretches(task, begun.model.programs)
    selection = fit_jointly(task, lists, begun.model.programs, are_laws=True)
    if selection is None:
        return None
    comparison, best = selection.comparison, selection.model
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work + SETTINGS.effort.work)
    for equation in range(len(lists)) if not are_lawful else ():  # these have no unnecessary parts
        if equation not in comparison.fixed:
            best = descent.prune(best, equation)
    return replace(selection, model=comparison.fit_beside(best, best.programs) or best)


def predictable_rows(fit: TrajectoryFit, comparison: ModelComparison, rate: float) -> float:
    """Return over how many rows errors as large as the noise stay small: half of where they are as large as the state.

    If errors grow by a factor of e in T, an error of the relative size e is as large as the state after T ln(1/e).
    `rate` is 1/T; infinite where errors do not grow.
    """
    measurements = comparison.estimator.measurements
    size = float(np.clip(measurements.relative_noise.max(), _LEAST_SIZE, 0.1))
    return 0.5 * math.log(1.0 / size) / rate / max(measurements.step, 1e-300) if rate > 0.0 else math.inf


def _programs(task: ModellingTask, name: str) -> list[Program]:
    """Return the laws of one variable, the best first; none if no residuals are at the noise level.

    An equation that the search of a target without noise has converged to comes before them if it is shorter, and
    stands alone where there is no law. There are none where the search has found another one that describes the rows
    about as well.
    """
    if name in task.known:
        return [task.known[name]]
    converged = task.converged(name)
    laws = standing_laws(task, name)
    if not laws or not laws[0].is_tested:
        return [] if converged is None else [converged]
    programs = [law.program for law in laws]
    if converged is not None and structure_length(converged) < structure_length(programs[0]):
        return [converged, *programs]
    return programs if laws[0].lead >= SETTINGS.inference.distinct_nats else []


def _begun(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> SelectedModel | None:
    model = task.comparison.fit_model([programs[0] for programs in lists])
    return None if model is None else SelectedModel(task, task.comparison, model)


def _rows(task: ModellingTask) -> int:
    """Return how many rows were measured: a mean counts all of its rows."""
    recording = task.recording
    return sum(len(part.times) for part in recording.trajectories if not part.held_out) * recording.rows_of_mean
