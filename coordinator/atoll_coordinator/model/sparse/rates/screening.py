"""Which variables an equation takes: those of the products that explain most of its derivative (forward selection).

A polynomial of all variables has too many terms for its rows where there are dozens of variables. Of all products of
two, and cubes, one is added at a time, the one that explains most of what is left (orthogonal matching pursuit), as
long as that is more than the best of so many explains by chance.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.sparse.kernels.robust import select_forward
from atoll_coordinator.model.sparse.rates.rows import RateRows
from atoll_coordinator.settings import SETTINGS


def screened(rows: RateRows, columns: Sequence[int]) -> tuple[int, ...]:
    """Return the variables among `columns` (indices) that the equation takes, in ascending order."""
    count = len(columns)
    if (count + 1) * (count + 2) // 2 <= SETTINGS.sparse.largest_library:
        return tuple(columns)
    its = rows.trusted()
    terms, values = _products(its.inputs, columns)
    deviation = float(its.values.std())
    weights = 1.0 / np.sqrt(its.errors * its.errors + (SETTINGS.common.negligible * deviation) ** 2)
    weighted, side = values * weights, its.values * weights
    chosen, squares = np.full(3 * SETTINGS.rates.screened, -1, np.int64), np.zeros(3 * SETTINGS.rates.screened + 1)
    select_forward(weighted, side, chosen, squares)
    kept: list[int] = []
    chance = 2.0 * log(float(len(terms))) / len(its.values)
    for place, before, after in zip(chosen.tolist(), squares[:-1].tolist(), squares[1:].tolist(), strict=True):
        if place < 0 or before - after <= chance * before:
            break
        new = [variable for variable in terms[place] if variable not in kept]
        if len(kept) + len(new) > SETTINGS.rates.screened:
            break
        kept += new
        if after <= len(its.values):
            break
    return tuple(sorted(set(kept)))


def _products(inputs: FloatArray, columns: Sequence[int]) -> tuple[list[tuple[int, ...]], FloatArray]:
    """Return the products of up to two variables, and cubes, and their values (K, N)."""
    terms: list[tuple[int, ...]] = [(), *((each,) for each in columns)]
    terms += combinations_with_replacement(columns, 2)
    terms += [(each, each, each) for each in columns]
    values = np.ones((len(terms), inputs.shape[1]))
    for place, term in enumerate(terms):
        for variable in term:
            values[place] *= inputs[variable]
    return terms, values
