"""Could the data decide? The description length with the truth against that with what was shown, by one criterion."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.piece_lengths import choose_piece_length
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest


def excess_of_truth(
    table: Table, config: JobConfig, truths: Mapping[str, str], shown: Sequence[str | None]
) -> float | None:
    """Return how many nats longer the description is with the truth than with what was shown, constants fitted.

    Pieces and errors are those by which equations were chosen.

    Negative: the search or the selection missed it, infinitely so where what was shown cannot be simulated; positive:
    the criterion prefers what was shown. None where the truth cannot be fitted, or something is missing.
    """
    texts = [text for text in shown if text]
    if len(texts) < len(truths):
        return None
    try:
        preparation = prepare(table, config)
        if preparation.recording is None:
            return None
        names, variables = preparation.dataset.names, [*truths]
        task = ModellingTask(preparation.dataset, preparation.recording, config, dict.fromkeys(truths, CandidateSet()))
        systems = [[shortest(from_infix(text, names)) for text in side] for side in (truths.values(), texts)]
        with np.errstate(all="ignore"):
            if task.is_nearly_clean:
                task = choose_piece_length(task, systems[1])
            comparison = task.make_comparison(task.measurements(variables), variables)
            models = [comparison.fit_model(system, 40) for system in systems]
            fitted = [model for model in models if model is not None]
            if fitted:
                comparison, _ = comparison.calibrate(min(fitted, key=lambda model: model.nats))
                models = [None if model is None else comparison.score_fit(model.fit) for model in models]
    except AtollError:
        return None
    right, other = models
    if right is None:
        return None
    return -math.inf if other is None else right.nats - other.nats
