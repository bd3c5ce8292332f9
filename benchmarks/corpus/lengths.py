"""Could the data decide? The description length with the truth against that with what was shown, by one criterion."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from atoll.config import JobConfig
from atoll.data.table import Table
from atoll.errors import AtollError
from atoll.expression.text.parsing import from_infix
from atoll.expression.writing.shortest import shortest
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection.joint_search import ModellingTask


def excess_of_truth(
    table: Table, config: JobConfig, truths: Mapping[str, str], shown: Sequence[str | None]
) -> float | None:
    """Return how many nats longer the description is with the truth than with what was shown, constants fitted.

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
        task = ModellingTask(preparation.dataset, preparation.recording, config, {})
        comparison = task.compare(task.measurements([*truths]), [*truths])
        names = preparation.dataset.names
        with np.errstate(all="ignore"):
            models = [
                comparison.fit_model([shortest(from_infix(text, names)) for text in each], 40)
                for each in (truths.values(), texts)
            ]
    except AtollError:
        return None
    right, found = models
    if right is None:
        return None
    return -math.inf if found is None else right.nats - found.nats
