"""Which variables an equation takes: those of the products that explain most of its derivative (forward selection).

A polynomial of all variables has too many terms for its rows where there are dozens of variables. Of all products of
two, and cubes, one is added at a time, the one that explains most of what is left (orthogonal matching pursuit), as
long as that is more than the best of so many explains by chance. Terms that stood in for others which came later leave
first in a backward elimination, and variables are taken from its end.
"""

import math
from collections.abc import Sequence
from itertools import islice

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.sparse.elimination import eliminated, selected_forward
from atoll_coordinator.model.sparse.products import products, values_of_products
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows, rate_rows
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig


def with_screened_variables(preparation: Preparation, config: JobConfig) -> JobConfig:
    """Return the resolved configuration with the variables that each equation takes, where there are dozens.

    What the user allows stays as it is, and so does an equation of which nothing can be told.
    """
    dataset, recording, space = preparation.dataset, preparation.recording, config.space
    if recording is None or not _are_too_many(len(dataset.names)):
        return config
    variables_of = dict(space.variables_of)
    for name in dataset.variables:
        rows = None if name in variables_of or name in config.prior.known else rate_rows(recording, dataset.names, name)
        kept = () if rows is None else screened(rows, range(len(dataset.names)))
        if kept:
            variables_of[name] = tuple(dataset.names[place] for place in kept)
    update: dict[str, object] = {"variables_of": variables_of}
    beginning = space.model_copy(update={"terminals": None})
    if space.terminals == beginning.terminals_for(len(dataset.names)):  # the user has not said otherwise
        counts = [len(variables_of.get(name, dataset.names)) for name in dataset.variables]
        update["terminals"] = beginning.terminals_for(max(counts))
    return config.model_copy(update={"space": space.model_copy(update=update)})


def _are_too_many(variables: int) -> bool:
    """Tell whether a library of all products of two variables is too large."""
    return (variables + 1) * (variables + 2) // 2 > SETTINGS.sparse.largest_library


def screened(rows: RateRows, columns: Sequence[int]) -> tuple[int, ...]:
    """Return the variables among `columns` (indices) that the equation takes, in ascending order."""
    if not _are_too_many(len(columns)):
        return tuple(columns)
    trusted = rows.trusted()
    terms = [*products(columns, 2), *((variable,) * 3 for variable in columns)]
    values = values_of_products(terms, trusted.inputs)
    _, deviation = moments(trusted.values)
    weights = 1.0 / np.sqrt(trusted.errors * trusted.errors + (SETTINGS.common.negligible * deviation) ** 2)
    weighted, side = values * weights, trusted.values * weights
    taken: list[int] = []
    chance, before = 2.0 * log(float(len(terms))) / len(side), math.fsum((side * side).tolist())
    for place, after in islice(selected_forward(weighted, side), 3 * SETTINGS.rates.screened):
        if before - after <= chance * before:
            break
        taken.append(place)
        before = after
        if after <= len(side):
            break
    if not taken:
        return ()
    kept: list[int] = []
    for index in reversed(eliminated(weighted[taken], side).order):
        new = [variable for variable in dict.fromkeys(terms[taken[index]]) if variable not in kept]
        if len(kept) + len(new) > SETTINGS.rates.screened:
            break
        kept += new
    return tuple(sorted(kept))
