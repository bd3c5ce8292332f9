"""Equations of many variables: which of these an equation takes, unless the user says so."""

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.sparse.laws import screen_columns, screen_variables
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.config import PRESETS
from atoll_core.data.table import Table
from tests.unit.coordinator.model.sparse.test_many_variables import rows_of

STATES = tuple(f"x{place}" for place in range(16))


def prepared(config):
    """Return a table of waves, each state driven by the one before."""
    times = 0.05 * np.arange(300)
    values = np.array([np.sin((1.0 + 0.1 * place) * times + place) for place in range(16)])
    zero = np.zeros(300, np.int64)
    table = Table(
        ("t", *STATES), ("",) * 17, np.ascontiguousarray(np.vstack([times, values])), (0,), ("made",), zero, zero + 1
    )
    return prepare(table, config)


def test_of_many_variables_those_that_matter_are_taken():
    names = tuple(f"x{place}" for place in range(40))
    rows, _ = rows_of("8 - x5 + x6*x4 - x3*x4", names, 700)
    kept = screen_columns(rows, range(40))
    assert {3, 4, 5, 6} <= set(kept)
    assert len(kept) <= 8
    assert screen_columns(rows, (1, 7, 9)) == (1, 7, 9)


def test_what_the_user_allows_stays():
    config = PRESETS["default"]
    preparation = prepared(config)
    space = config.space.model_copy(update={"variables_of": {"x3": ("x3", "x15")}})
    resolved = resolve(config.model_copy(update={"space": space}), preparation.dataset)
    search_space = screen_variables(preparation, resolved).space
    assert search_space.variables_of["x3"] == ("x3", "x15")
    assert set(search_space.variables_of) == set(STATES)
    assert all(1 <= len(names) <= 8 for names in search_space.variables_of.values())
    assert search_space.terminals == 13


def test_a_few_variables_are_all_taken():
    config = PRESETS["default"]
    preparation = prepared(config.model_copy(update={"data": config.data.model_copy(update={"states": STATES[:5]})}))
    resolved = resolve(config, preparation.dataset)
    assert screen_variables(preparation, resolved) is resolved
