"""Shortcut: if sparse regression found a law at the noise level for each state, these laws are the model.

How it works. These laws were chosen from all products up to a degree, with many more rows than products. The laws of
all states are fitted together to the trajectories, in pieces as long as errors of the initial states allow. Unnecessary
parts are removed, and the few possible systems are compared. If the residuals are larger than the noise, the other
stages run.

Doubt. A sum of products can approximate a law of another form so well that its residuals look like noise. So the laws
are only used if the other programs of the search give clearly longer descriptions (`Law.lead`).
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
from atoll_coordinator.model.selection.joint_search import (
    compare_alternatives,
    exchange_programs,
    find_starting_system,
    fit_jointly,
)
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.piece_lengths import choose_piece_length
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, growth_rate
from atoll_coordinator.model.sparse.laws import find_all_laws
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program
from atoll_core.expression.writing.shortest import shortest

_LEAST_SIZE: Final = 1e-4
"""Errors of an initial state are assumed to have at least this relative size s. A piece ends where they have grown to
the square root of s, that is by a factor g of 100. The normal equations of constants and initial states then have a
relative precision of g^4 times double precision, about 1e-8."""


def add_laws(task: ModellingTask) -> ModellingTask:
    """Return the task with the laws of sparse regression for each of its variables, if it has none yet."""
    if task.laws:
        return task
    others = {name: task.candidates[name].programs for name in task.variables}
    preparation = Preparation(task.dataset, task.recording)
    laws_by_name = find_all_laws(preparation, task.config, others, task.among_many, task.spread)
    return replace(task, laws={name: laws for name, laws in laws_by_name.items() if name in task.variables})


def select_laws(task: ModellingTask) -> SelectedModel | None:
    """Return the model made of laws; None if a law is missing, or if the residuals are larger than the noise."""
    if task.recording.groups:
        return None  # laws come from single groups, and are only candidates
    lists = [_law_programs(task, name) for name in task.variables]
    if not all(lists) or not task.laws:
        return None
    selection = fit_laws_together(task, lists)
    if selection is None:
        return None
    if all(task.laws.values()):
        return selection if selection.is_like_noise else None
    return selection if selection.comparison.score.is_exact(selection.model) else None


def fit_laws_in_short_pieces(task: ModellingTask) -> SelectedModel | None:
    """Return the best system of laws at the noise level, in short pieces; None if a variable has no such law.

    A choice with a time limit begins with this system, since it takes little more than one fit. `select_laws` has
    stricter conditions: here the laws may come from few rows, and other programs may fit these rows about as well.
    """
    if task.recording.groups:
        return None
    lists = [
        [task.known[name]] if name in task.known else [shortest(law.program) for law in laws_at_noise_level(task, name)]
        for name in task.variables
    ]
    if not all(lists):
        return None
    short = task.in_pieces(SETTINGS.shooting.lengths[-1])
    start = find_starting_system(short.comparison, lists)
    if start is None:
        return None
    comparison, start = short.comparison.calibrate(start)
    best = exchange_programs(comparison, start, lists)
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    searched = [equation for equation in range(len(lists)) if equation not in comparison.fixed]
    for equation in searched:
        best = descent.prune(best, equation)
    for equation in searched:
        compare_alternatives(comparison, best, equation, lists[equation])
    return SelectedModel(short, comparison, best, lists)


def laws_at_noise_level(task: ModellingTask, name: str) -> list[Law]:
    """Return the laws of one variable, the best first. The result is empty if the residuals of the best law are larger
    than the noise."""
    laws = [law for law in task.laws.get(name, ()) if task.may_be_shown(law.program)]
    return laws if laws and laws[0].excess <= SETTINGS.inference.excess else []


def fit_laws_together(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> SelectedModel | None:
    """Return the best system of these candidates; None if no system can be simulated.

    If there are so few rows that all stages can run on whole trajectories, a system is returned only if its residuals
    are integration errors; only rows without noise can have such a system.
    """
    short = task.in_pieces(SETTINGS.shooting.lengths[-1])
    start = _fit_first(short, lists)
    if start is None:
        return None
    predictable = predictable_rows(start.model.fit, start.comparison, growth_rate(start.model.fit))
    rows = int(min(max(predictable, SETTINGS.shooting.lengths[1]), SETTINGS.shooting.piece))
    are_lawful = all(name in task.rate_law_variables for name, laws in task.laws.items() if laws)
    is_small = _count_rows(task) <= SETTINGS.selection.compared_rows and rows >= task.longest and not are_lawful
    if is_small and not task.is_nearly_clean:
        return None
    task = task.in_pieces(rows)
    if task.is_nearly_clean:
        task = choose_piece_length(task, start.model.programs)
    selection = fit_jointly(task, lists, start.model.programs, are_laws=True)
    if selection is None or (is_small and not selection.comparison.score.is_exact(selection.model)):
        return None
    comparison, best = selection.comparison, selection.model
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work + SETTINGS.effort.work)
    for equation in range(len(lists)) if not are_lawful else ():  # such laws have no unnecessary parts
        if equation not in comparison.fixed:
            best = descent.prune(best, equation)
    return replace(selection, model=comparison.fit_from(best, best.programs) or best)


def predictable_rows(fit: TrajectoryFit, comparison: ModelComparison, rate: float) -> float:
    """Return the number of rows over which errors that begin as large as the noise remain small; infinite if errors do
    not grow.

    It is half of the number of rows after which the errors are as large as the state. If errors grow by a factor of e
    in the time T, an error of the relative size s is as large as the state after the time T ln(1/s). `rate` is 1/T.
    """
    measurements = comparison.estimator.measurements
    size = float(np.clip(measurements.relative_noise.max(), _LEAST_SIZE, 0.1))
    return 0.5 * math.log(1.0 / size) / rate / max(measurements.step, 1e-300) if rate > 0.0 else math.inf


def _law_programs(task: ModellingTask, name: str) -> list[Program]:
    """Return the laws of one variable, the best first. The result is empty if the residuals are larger than the noise.

    A search of a noise-free target may have converged to an equation. If this equation is shorter than the best law, it
    comes first; if there is no law, it is the only program. The result is also empty if the search has found another
    equation that fits the rows about as well as the best law.
    """
    if name in task.known:
        return [task.known[name]]
    converged = task.converged_equation(name)
    laws = laws_at_noise_level(task, name)
    if not laws or not laws[0].is_tested:
        return [] if converged is None else [converged]
    programs = [law.program for law in laws]
    if converged is not None and structure_length(converged) < structure_length(programs[0]):
        return [converged, *programs]
    return programs if laws[0].lead >= SETTINGS.inference.distinct_nats else []


def _fit_first(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> SelectedModel | None:
    model = task.comparison.fit_model([programs[0] for programs in lists])
    return None if model is None else SelectedModel(task, task.comparison, model)


def _count_rows(task: ModellingTask) -> int:
    """Return the number of measured rows. If rows are means of several measured rows, all these measured rows are
    counted."""
    recording = task.recording
    return sum(len(part.times) for part in recording.trajectories if not part.held_out) * recording.rows_of_mean
