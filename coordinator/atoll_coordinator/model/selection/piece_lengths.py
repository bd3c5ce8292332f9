"""The rows of a trajectory that are simulated without a break: all, or if that cannot be fitted, shorter pieces.

Errors of an initial state grow along a trajectory; in a chaotic system, its prediction is lost after some
hundred rows. Shorter pieces, each from its own initial state, can still be fitted. They test a model less, hence the
longest pieces that can be fitted are used.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.joint_search import fit_jointly, reduce_all, search_jointly
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.solver_errors import without_solver_errors
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program


def search_in_pieces(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> SelectedModel | None:
    """Return the best system of these candidates and their neighbourhood, None where none can be simulated."""
    if not all(lists):
        return None
    first = [programs[0] for programs in lists]
    if task.is_nearly_clean:
        selection = search_jointly(in_stretches(task, first), lists)
        if selection is None or selection.comparison.score.is_exact(selection.model):
            return selection
        return _without_solver_errors(task, selection) or selection
    longest, tasks = None, _tasks(task)
    for index, here in enumerate(tasks):
        fits_shorter = partial(_fits_in, tasks[index + 1 :])
        selection = search_jointly(here, lists, is_hopeless=fits_shorter)
        if selection is None:
            continue
        longest = longest or selection
        if selection.is_like_noise:
            return _lengthened(task, selection, lists)
        if not fits_shorter(selection):
            break
    return longest


def _without_solver_errors(task: ModellingTask, selection: SelectedModel) -> SelectedModel | None:
    """Return the system from which a solver computed the rows, without unnecessary parts; None without such a solver.

    Nothing else is tried: a solver gives the rows from the law only.
    """
    exact = without_solver_errors(task, selection.model.fit)
    if exact is None:
        return None
    programs = selection.model.programs
    solved = fit_jointly(exact, [[program] for program in programs], programs)
    if solved is None:
        return None
    return replace(solved, model=reduce_all(solved.comparison, solved.model), lists=selection.lists)


def in_whole(task: ModellingTask) -> ModellingTask:
    """Return the task with trajectories simulated in whole, or in the longest pieces that are ever fitted."""
    return replace(task, piece=SETTINGS.shooting.piece) if task.is_nearly_clean else task


def on_all_rows(selection: SelectedModel) -> SelectedModel | None:
    """Return the chosen system fitted to all rows, in shorter pieces if it must be; None when it cannot be.

    Of dozens of states it is fitted to fewer. It is integrated so precisely that its constants do not show it.
    """
    task, chosen = selection.task, selection.comparison.estimator
    measurements = task.measurements(task.variables)
    measurements = measurements.thinned(SETTINGS.effort.fitted_sensitivities // len(task.variables) ** 2)
    if measurements.rows == chosen.measurements.rows:
        comparison = task.compare(measurements, task.variables, is_precise=True)
        if comparison.estimator.tolerance >= chosen.tolerance:
            return selection
        model = comparison.fit_beside(selection.model, selection.model.programs)
        return selection if model is None else _calibrated(replace(selection, comparison=comparison, model=model))
    selections: list[SelectedModel] = []
    for here in _tasks(task):
        fitted = _fitted(here, selection.model.programs, measurements.rows, is_precise=True)
        if fitted is not None:
            selections.append(_calibrated(fitted))
            if selections[-1].is_like_noise:
                return selections[-1]
    return selections[0] if selections else None


def _calibrated(selection: SelectedModel) -> SelectedModel:
    comparison, model = selection.comparison.calibrated(selection.model)
    return replace(selection, comparison=comparison, model=model)


def remarks(task: ModellingTask, *, is_tested_in_whole: bool = False) -> Iterator[str]:
    """Yield sentences for the user: trajectories were not simulated in whole, states are without an equation."""
    if task.solver is not None:
        yield f"{task.solver}, reproduces the rows from these equations; its errors were subtracted from them."
    whole = task.longest
    if whole > task.piece:
        tested = (
            "with constants fitted to whole trajectories, the model describes them, too"
            if is_tested_in_whole
            else "beyond a piece the model has not been tested"
        )
        yield (
            f"Trajectories were simulated in pieces of {task.piece} rows or less, each from its own initial state, "
            f"not in whole (up to {whole} rows); {tested}."
        )
    others = [state for state in task.recording.states if state not in task.variables]
    if others:
        yield (
            f"Simulations take {', '.join(others)}, without an equation, as smoothed; errors of smoothed values add to "
            "the residuals."
        )


def _fits_in(tasks: Sequence[ModellingTask], selection: SelectedModel) -> bool:
    """Tell whether a system that does not fit well fits well in shorter pieces."""
    if selection.is_like_noise:
        return False
    rows = selection.comparison.estimator.measurements.rows
    fits = (_fitted(task, selection.model.programs, rows) for task in tasks)
    return any(fit is not None and fit.is_like_noise for fit in fits)


def _lengthened(task: ModellingTask, selection: SelectedModel, lists: Sequence[Sequence[Program]]) -> SelectedModel:
    """Return a system for short pieces fitted to longer pieces if it describes these, else the system itself."""
    rows = selection.comparison.estimator.measurements.rows
    for longer in _tasks(task):
        if longer.piece <= selection.task.piece:
            break
        fit = _fitted(longer, selection.model.programs, rows)
        if fit is not None and fit.is_like_noise:
            return search_jointly(longer, lists, selection.model.programs) or selection
    return selection


def _fitted(
    task: ModellingTask, programs: Sequence[Program], rows: int, *, is_precise: bool = False
) -> SelectedModel | None:
    """Return a system fitted to at most about this many rows, None when it cannot be simulated."""
    measurements = task.measurements(task.variables).thinned(rows)
    comparison = task.compare(measurements, task.variables, is_precise=is_precise)
    model = comparison.fit_model(programs, lengths=(SETTINGS.shooting.lengths[0], None))
    return None if model is None else SelectedModel(task, comparison, model)


def _tasks(task: ModellingTask) -> list[ModellingTask]:
    """Return the task with its own pieces, and with shorter ones that are at most half of the longest trajectory."""
    most = min(task.piece, task.longest)
    return [task, *(replace(task, piece=rows) for rows in reversed(SETTINGS.shooting.lengths[1:]) if 2 * rows <= most)]


def in_stretches(task: ModellingTask, programs: Sequence[Program]) -> ModellingTask:
    """Return the task with pieces so long that a system describes nearly clean trajectories in the fewest nats.

    Errors of a solver add up along a trajectory; an initial state for each piece, which costs 1/2 ln N for each number,
    ends the sum. In a whole trajectory, terms outside of the law would describe the sum of such errors.
    """
    lengths: dict[int, float] = {}
    tasks = {task.piece: task}
    for piece in (task.piece, *reversed(SETTINGS.shooting.lengths)):
        here = tasks.setdefault(piece, replace(task, piece=piece))
        comparison = here.comparison
        model = comparison.fit_model(programs)
        if model is not None:
            lengths[piece] = _stretch_length(comparison, model) / comparison.estimator.measurements.rows
    best = min(lengths, key=lambda piece: (lengths[piece], -piece), default=task.piece)
    return tasks[best]


def _stretch_length(comparison: ModelComparison, model: FittedModel) -> float:
    """Return the nats of all errors, independent within pieces, and of all initial states."""
    counts, starts = comparison.score.counts, model.fit.starts.size
    free = np.maximum(counts - starts / len(counts), 1.0)
    variances = np.maximum(model.fit.squares * counts / free, comparison.score.least_errors**2)
    return float(0.5 * counts @ np.log(variances)) + starts * comparison.score.constant_nats
