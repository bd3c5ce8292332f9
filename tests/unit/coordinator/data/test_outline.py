"""What a job would search is said before anything is started."""

import pytest

from atoll_coordinator.data.outline import outline
from atoll_core.config import BudgetConfig, DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.errors import UsageError
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


def test_other_programs_get_the_same() -> None:
    content = outline(TABLE, JobConfig(seed=3, data=DataConfig(order=2, states=("x",), inputs=("y",)))).as_dict()
    assert [(equation["lhs"], equation["variables"]) for equation in content["equations"]] == [
        ("d2x/dt2", ["x", "x_dot", "y"])
    ]
    assert content["config"]["seed"] == 3
    assert (content["rows"], content["time"]) == (TABLE.rows, "t")


def test_a_process_has_a_drift_and_a_diffusion() -> None:
    sides = [equation.lhs for equation in outline(TABLE, JobConfig(data=DataConfig(stochastic=True))).equations]
    assert sides == ["dx/dt", "dy/dt", "d[x]/dt", "d[x,y]/dt", "d[y]/dt"]


def test_a_target_error_is_said() -> None:
    text = outline(TABLE, JobConfig(budget=BudgetConfig(target_error=1e-4, max_epochs_of={"x": 3}))).as_text()
    assert "at a normalized error of 0.0001, or when it gets no better, after 1000 epochs at most, after 3 of x" in text


def test_what_contradicts_itself_is_refused() -> None:
    with pytest.raises(UsageError, match="equations are sought for x, y"):
        outline(TABLE, JobConfig(data=DataConfig(only=("t",))))
