"""Slow, obvious versions of what predictors and trainers are judged by."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_island_worker.evolution.front import from_tape, to_program
from atoll_island_worker.evolution.kernels.tape import compile_tape
from atoll_island_worker.evolution.structures import Fit, Lists, Rows, empty_tape
from tests.oracles.tapes import node_values


def losses(lists: Lists, p: int, rows: Rows, options: Fit) -> FloatArray:
    """Return the loss of individual `p`, taken as one term with its scaling (`options.terms` 0), at every row."""
    tape = empty_tape(lists.code.shape[1])
    count = compile_tape(lists, p, tape)
    values = node_values(to_program(from_tape(tape, count)), rows.inputs[:, : rows.length])
    differences = np.abs(lists.scale[p, 0] + lists.scale[p, 1] * values[-1] - rows.target[0, : rows.length])
    return differences if options.loss == 0 else differences**2


def predicted(losses_by_row: FloatArray, chosen: Iterable[int]) -> float:
    """Return the loss that the rows `chosen` predict."""
    return float(np.mean([losses_by_row[row] for row in chosen]))


def quality(losses_of_trainers: Sequence[FloatArray], chosen: Sequence[int], relative: bool = False) -> float:
    """Return the mean absolute difference of predicted and exact loss over trainers whose exact loss is finite.

    If `relative`, each difference is a share of the exact loss; without an exact loss there is none to predict.
    """
    differences = []
    for trainer in losses_of_trainers:
        exact = float(np.mean(trainer))
        if math.isfinite(exact):
            difference = abs(predicted(trainer, chosen) - exact)
            differences.append(difference / exact if relative and exact > 0.0 else difference)
    return float(np.mean(differences)) if differences else math.inf


def disagreement(losses_by_row: FloatArray, predictors: Sequence[Sequence[int]], relative: bool = False) -> float:
    """Return the variance of what the predictors predict for one individual, over the mean's square if `relative`."""
    predictions = [predicted(losses_by_row, chosen) for chosen in predictors]
    return float(np.var(predictions) / (np.mean(predictions) ** 2 if relative else 1.0))
