"""What a person reads before a job: how a table was read, and what would be searched."""

import numpy as np

from atoll_coordinator.data.outline import describe, outline
from atoll_core.config import BudgetConfig, DataConfig, JobConfig, PriorConfig, SpaceConfig
from tests.unit.coordinator.data.tables import oscillator, table_of

TABLE = table_of(oscillator())


def test_each_equation_is_said_with_what_it_may_be_made_of() -> None:
    config = JobConfig(
        space=SpaceConfig(operators=("+", "*"), variables_of={"x": ("x",)}),
        prior=PriorConfig(known={"dy": "-x"}, guesses={"x": ("2*x",)}),
        budget=BudgetConfig(max_epochs=7, max_time=60.0),
    )
    assert outline(TABLE, config).as_text().split("\n") == [
        "1 equation would be searched:",
        "  dx/dt = f(x) of + *, beginning from 2*x",
        "  dy/dt = -x (known, not searched)",
        "preset default, seed 0, 8 islands for each equation",
        "the search ends when it has converged or gets no better, after 7 epochs at most, after 60 s",
        "dry run: nothing was started",
    ]


def described(columns, starts=(0,), **options):
    return describe(table_of(columns, starts), JobConfig(data=DataConfig(**options))).split("\n")


def test_trajectories_rows_time_and_columns_are_said():
    columns = {name: np.tile(values, 2) for name, values in oscillator(30, 0.02).items()}
    assert described(columns, (0, 30), inputs=("y",)) == [
        "a.csv: 2 trajectories, 60 rows",
        "time t: 0 to 0.58, step 0.02",
        "states: x",
        "inputs: y",
    ]


def test_units_that_are_given_go_before_those_of_the_header():
    assert described(oscillator(), units={"t": "h", "y": "m"})[1:] == [
        "time t [h]: 0 to 5.9, step 0.1",
        "states: x, y [m]",
    ]


def test_what_is_known_of_a_diffusion_is_said():
    config = JobConfig(
        data=DataConfig(stochastic=True), prior=PriorConfig(known={"[x]": "0.25"}, bounds={"[y]": ("c > 0.1",)})
    )
    lines = describe(table_of(oscillator(120)), config).split("\n")
    assert lines[-2:] == ["known: d[x]/dt = 0.25", "bounds: d[y]/dt: c > 0.1"]
