"""Scores by simulation: whole trajectories or pieces, each from an initial state of its own.

`by_pieces` is the score in use (`criteria.system_length`): independent errors and systematic ones of a known number;
`by_pieces_and_evidence` prices constants by evidence.
`by_innovations` takes the same fits once more, with errors of neighbouring rows that go together as the leader's do.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from atoll_coordinator.model.criteria import system_length
from atoll_coordinator.model.inference.standard_errors import Errors, estimate_errors
from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.selection.piece_lengths import in_stretches
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.error_model import ErrorModel, Innovations
from atoll_coordinator.model.shooting.multiple_shooting import row_steps
from atoll_coordinator.settings import SETTINGS
from benchmarks.scores.evidence import occam
from benchmarks.scores.pools import Pool, Scored, nothing

Compared = tuple[ModelComparison, list[FittedModel | None]]


def by_pieces(pool: Pool) -> Scored:
    """Return the lengths of the systems in the longest pieces that the shortest of them fits."""
    compared = _compared(pool)
    if compared is None:
        return nothing(pool)
    comparison, models = compared
    law = models[0]
    errors = None if law is None else estimate_errors(comparison, law)
    nats = [math.inf if model is None else model.nats for model in models]
    return _scored(nats, [math.inf if model is None else model.misfit for model in models], errors)


def by_pieces_and_evidence(pool: Pool) -> Scored:
    """Return the same with the evidence of the constants (`evidence.occam`) in the place of 1/2 ln N for each."""
    compared = _compared(pool)
    if compared is None:
        return nothing(pool)
    comparison, models = compared
    inputs = pool.task.dataset.inputs
    nats = [
        math.inf
        if model is None
        else system_length(model.misfit, model.programs, 0, 0.0)
        + occam(model.fit.reduced / comparison.inflation(model), model.fit.system, inputs)
        for model in models
    ]
    return _scored(nats, [math.inf if model is None else model.misfit for model in models], None)


def by_innovations(pool: Pool) -> Scored:
    """Return the lengths by innovations: errors that are the leader's, as its residuals have them, for all systems."""
    compared = _compared(pool)
    if compared is None:
        return nothing(pool)
    comparison, models = compared
    leader = min((model for model in models if model is not None), key=lambda model: model.nats).fit
    estimator = comparison.estimator
    rows, fitted = estimator.measurements, (leader.system.count + leader.starts.size) / len(leader.residuals)
    layout = Innovations(leader.segments, row_steps(rows), rows.weights)
    sought = ErrorModel(np.sqrt(leader.squares), *layout.estimate(leader.residuals, fitted))
    own = estimator.fit(leader.system, None, SETTINGS.effort.steps, leader.starts, sought, is_stiff=leader.is_stiff)
    errors = replace((own or leader).errors, is_known=True)
    nats: list[float] = []
    misfits: list[float] = []
    law: Errors | None = None
    for place, model in enumerate(models):
        fit = None
        if model is not None:
            near, steps = model.fit, SETTINGS.effort.steps
            fit = estimator.fit(near.system, None, steps, near.starts, errors, is_stiff=near.is_stiff)
        if model is None or fit is None:
            nats.append(math.inf)
            misfits.append(math.inf)
            continue
        misfits.append(0.5 * estimator.cost(fit))
        nats.append(system_length(misfits[-1], model.programs, fit.system.count, comparison.constant_nats))
        if place == 0:
            law = estimate_errors(comparison, replace(model, fit=fit))
    return _scored(nats, misfits, law, f"shares {errors.shares}, decays {errors.decays}")


def _scored(nats: list[float], misfits: list[float], law: Errors | None, note: str = "") -> Scored:
    if law is None:
        return Scored(tuple(nats), tuple(misfits), note=note)
    spread = np.sqrt(np.maximum(np.diag(law.covariance), 0.0))
    return Scored(tuple(nats), tuple(misfits), tuple(law.values.tolist()), tuple(spread.tolist()), note)


@lru_cache(maxsize=1)
def _compared(pool: Pool) -> Compared | None:
    """Return the systems fitted in the longest pieces in which the best leaves noise alone; None where none can be."""
    done: Compared | None = None
    for task in _tasks(pool):
        comparison = task.compare(task.compared_measurements, task.variables)
        models = [comparison.fit_model(system) for system in pool.systems]
        fitted = [model for model in models if model is not None]
        if not fitted:
            continue
        best = comparison.calibrate(min(fitted, key=lambda model: model.nats))
        done = comparison, [None if model is None else comparison.measure(model.fit) for model in models]
        if comparison.excess(best) <= SETTINGS.inference.excess:
            break
    return done


def _tasks(pool: Pool) -> Iterator[ModellingTask]:
    """Yield the task with pieces that get ever shorter, as `piece_lengths` does.

    Of nearly clean tables the length of pieces is that of the law, where a job has its leading candidate.
    """
    task = pool.task
    if task.is_nearly_clean:
        yield in_stretches(task, pool.systems[0])
        return
    yield task
    most = min(task.piece, task.longest)
    yield from (replace(task, piece=rows) for rows in reversed(SETTINGS.shooting.lengths[1:]) if 2 * rows <= most)
