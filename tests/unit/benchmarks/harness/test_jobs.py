"""Configurations and tables of jobs of benchmarks."""

import numpy as np

from atoll_core.config import PRESETS
from atoll_core.data.table import Table
from benchmarks.harness.jobs import configured, table_of_columns


def test_what_is_given_enters_the_configuration():
    config = configured(7, {"order": 2}, {"max_time": 33.0}, ["+", "*"], islands=3)
    assert (config.seed, config.data.order, config.budget.max_time, config.evolution.islands) == (7, 2, 33.0, 3)
    assert config.space.operators == ("+", "*")
    assert configured() == PRESETS["default"]
    assert configured(PRESETS["paper"].seed, preset="paper") == PRESETS["paper"]


def test_columns_are_a_table_with_lines_of_a_file():
    table = table_of_columns({"t": np.arange(3.0), "x": np.ones(3)}, "file.csv", (0, 2))
    again = Table.from_bytes(table.to_bytes())
    assert (again.names, again.starts, again.files, again.line_of_row.tolist()) == (
        ("t", "x"), (0, 2), ("file.csv",), [2, 3, 4]
    )  # fmt: skip
