"""Piece length: the number of rows of a trajectory that are simulated without a break.

Errors of an initial state grow along a trajectory; a chaotic trajectory cannot be predicted beyond some hundred rows.
If whole trajectories cannot be fitted, shorter pieces often can be fitted: each piece has its own initial state.
Shorter pieces are a weaker test of a model. So `search_in_pieces` begins with the longest pieces, and takes shorter
pieces only if the system fits these shorter pieces well. Doubt: a wrong system can also fit short pieces; a remark in
the result says that the model was tested in pieces.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.joint_search import fit_jointly, reduce_all, search_jointly
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.solver_errors import subtract_solver_errors
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program


def search_in_pieces(
    task: ModellingTask, lists: Sequence[Sequence[Program]], known: Sequence[Program] | None = None
) -> SelectedModel | None:
    """Return the best system of these candidates and their neighbourhood; None if no system can be simulated.

    `known` is a system that was found before, see `fit_jointly`.
    """
    if not all(lists):
        return None
    first = [programs[0] for programs in lists]
    if task.is_nearly_clean:
        selection = search_jointly(choose_piece_length(task, first), lists, known=known)
        if selection is None or selection.comparison.score.is_exact(selection.model):
            return selection
        return fit_without_solver_errors(task, selection) or selection
    longest, tasks = None, _tasks_by_piece_length(task)
    for index, here in enumerate(tasks):
        fits_shorter = partial(_fits_in_shorter_pieces, tasks[index + 1 :])
        selection = search_jointly(here, lists, is_hopeless=fits_shorter, known=known)
        if selection is None:
            continue
        longest = longest or selection
        if selection.is_like_noise:
            return _lengthen_pieces(task, selection, lists)
        if not fits_shorter(selection):
            break
    return longest


def fit_without_solver_errors(
    task: ModellingTask, selection: SelectedModel, lists: Sequence[Sequence[Program]] | None = None
) -> SelectedModel | None:
    """Return the system, fitted to rows without solver errors; None if no solver reproduces the rows.

    Unnecessary parts are removed. `lists` are programs that replace an equation if the description is then shorter;
    None: no other programs are tried, because the selection was compared with all of them.
    """
    exact = subtract_solver_errors(task, selection.model.fit)
    if exact is None:
        return None
    programs = selection.model.programs
    solved = fit_jointly(exact, lists or [[program] for program in programs], programs)
    if solved is None:
        return None
    return replace(solved, model=reduce_all(solved.comparison, solved.model), lists=selection.lists)


def with_longest_pieces(task: ModellingTask) -> ModellingTask:
    """Return the task with the longest pieces that are ever fitted, for nearly noise-free data; else unchanged."""
    is_whole = bool(task.recording.hidden)
    return replace(task, piece=SETTINGS.shooting.piece) if task.is_nearly_clean and not is_whole else task


def refit_on_all_rows(selection: SelectedModel) -> SelectedModel | None:
    """Return the chosen system fitted to all rows, if necessary in shorter pieces; None if this fails.

    With dozens of states, the system is fitted to fewer rows. The integration is so precise that its errors do not
    affect the constants.
    """
    task, chosen = selection.task, selection.comparison.estimator
    measurements = task.measurements(task.variables)
    measurements = measurements.thin(SETTINGS.effort.fitted_sensitivities // len(task.variables) ** 2)
    if measurements.rows == chosen.measurements.rows:
        comparison = task.make_comparison(measurements, task.variables, is_precise=True)
        if comparison.estimator.tolerance >= chosen.tolerance:
            return selection
        model = comparison.fit_from(selection.model, selection.model.programs)
        return selection if model is None else _calibrate(replace(selection, comparison=comparison, model=model))
    selections: list[SelectedModel] = []
    for here in _tasks_by_piece_length(task):
        fitted = _fit_task(here, selection.model.programs, measurements.rows, is_precise=True)
        if fitted is not None:
            selections.append(_calibrate(fitted))
            if selections[-1].is_like_noise:
                return selections[-1]
    return selections[0] if selections else None


def _calibrate(selection: SelectedModel) -> SelectedModel:
    comparison, model = selection.comparison.calibrate(selection.model)
    return replace(selection, comparison=comparison, model=model)


def piece_remarks(task: ModellingTask, *, is_tested_in_whole: bool = False) -> Iterator[str]:
    """Yield remarks for the user on subtracted solver errors, on trajectories simulated in pieces, and on states
    without an equation."""
    if task.solver is not None:
        yield f"{task.solver}, reproduces the rows from these equations; its errors were subtracted from the rows."
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
    known = (*task.variables, *task.recording.observed)
    others = [state for state in task.recording.states if state not in known]
    if others:
        yield (
            f"Simulations use the smoothed values of {', '.join(others)}, which have no equation; errors of these "
            "values add to the residuals."
        )


def _fits_in_shorter_pieces(tasks: Sequence[ModellingTask], selection: SelectedModel) -> bool:
    """Tell whether a system fits badly in its pieces, but well in shorter pieces."""
    if selection.is_like_noise:
        return False
    rows = selection.comparison.estimator.measurements.rows
    fits = (_fit_task(task, selection.model.programs, rows) for task in tasks)
    return any(fit is not None and fit.is_like_noise for fit in fits)


def _lengthen_pieces(
    task: ModellingTask, selection: SelectedModel, lists: Sequence[Sequence[Program]]
) -> SelectedModel:
    """Return the system fitted to longer pieces, if it describes these pieces; if not, return the system for short
    pieces."""
    rows = selection.comparison.estimator.measurements.rows
    for longer in _tasks_by_piece_length(task):
        if longer.piece <= selection.task.piece:
            break
        fit = _fit_task(longer, selection.model.programs, rows)
        if fit is not None and fit.is_like_noise:
            return search_jointly(longer, lists, selection.model.programs) or selection
    return selection


def _fit_task(
    task: ModellingTask, programs: Sequence[Program], rows: int, *, is_precise: bool = False
) -> SelectedModel | None:
    """Return a system fitted to at most about `rows` rows; None if it cannot be simulated."""
    measurements = task.measurements(task.variables).thin(rows)
    comparison = task.make_comparison(measurements, task.variables, is_precise=is_precise)
    model = comparison.fit_model(programs, lengths=(SETTINGS.shooting.lengths[0], None))
    return None if model is None else SelectedModel(task, comparison, model)


def _tasks_by_piece_length(task: ModellingTask) -> list[ModellingTask]:
    """Return the task with its own piece length, and with shorter piece lengths. A shorter piece has at most half of
    the rows of the longest trajectory."""
    if task.recording.hidden:
        return [task]
    most = min(task.piece, task.longest)
    return [task, *(replace(task, piece=rows) for rows in reversed(SETTINGS.shooting.lengths[1:]) if 2 * rows <= most)]


def choose_piece_length(task: ModellingTask, programs: Sequence[Program]) -> ModellingTask:
    """Return the task with a new piece length: with this length, a system describes nearly noise-free rows in the
    fewest nats.

    Errors of a solver add up along a trajectory. Each piece begins with a new initial state, without accumulated
    errors; each number of this initial state costs 1/2 ln N. In a whole trajectory, terms that are not in the law would
    describe the accumulated errors.
    """
    if task.recording.hidden:
        return task
    lengths: dict[int, float] = {}
    tasks = {task.piece: task}
    for piece in (task.piece, *reversed(SETTINGS.shooting.lengths)):
        here = tasks.setdefault(piece, replace(task, piece=piece))
        comparison = here.comparison
        model = comparison.fit_model(programs)
        if model is not None and comparison.score.is_exact(model):
            return here  # shorter pieces would only add initial states
        if model is not None:
            lengths[piece] = _description_length(comparison, model) / comparison.estimator.measurements.rows
    best = min(lengths, key=lambda piece: (lengths[piece], -piece), default=task.piece)
    return tasks[best]


def _description_length(comparison: ModelComparison, model: FittedModel) -> float:
    """Return the nats of all errors, which are treated as independent within pieces, and of all initial states."""
    counts, starts = comparison.score.counts, model.fit.starts.size
    free = np.maximum(counts - starts / len(counts), 1.0)
    variances = np.maximum(model.fit.squares * counts / free, comparison.score.least_errors**2)
    return float(0.5 * counts @ np.log(variances)) + starts * comparison.score.constant_nats
