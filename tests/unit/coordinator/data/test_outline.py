"""What a person reads before a job: how a table was read, and what would be searched."""

import numpy as np

from atoll_coordinator.data.outline import describe, outline
from atoll_core.config import BudgetConfig, DataConfig, JobConfig, ParameterConfig, PriorConfig, SpaceConfig
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


GIVEN = JobConfig(
    prior=PriorConfig(
        equations={"dx": "-k*x + ?(y)", "dy": "c/2 - a*y"},
        parameters={
            "k": ParameterConfig(lower=0.1, upper=10.0),
            "a": ParameterConfig(start=3.0),
            "c": ParameterConfig(lower=2.0),
        },
    ),
    space=SpaceConfig(operators=("+", "*")),
)


def test_of_a_given_equation_its_unknown_part_is_searched_and_its_parameters_are_listed():
    assert outline(TABLE, GIVEN).as_text().split("\n")[:7] == [
        "1 equation would be searched:",
        "  dx/dt = -k*x + ?(y)",
        "    searched: ? of dx/dt, from y, of + *",
        "  dy/dt = c/2 - a*y (given)",
        "  parameter k: 0.1 to 10, beginning at 1",
        "  parameter c: at least 2, beginning at 2",
        "  parameter a: beginning at 3",
    ]
    assert describe(TABLE, GIVEN).split("\n")[-2:] == ["given: dx/dt = -k*x + ?(y)", "given: dy/dt = c/2 - a*y"]


def test_parameters_of_an_observed_column_may_have_bounds_without_given_equations():
    prior = PriorConfig(parameters={"a": ParameterConfig(lower=2.0)})
    assert outline(TABLE, JobConfig(prior=prior, data=DataConfig(observe={"y": "a*x"}))).parameters == (
        "a: at least 2, beginning at 2",
    )


def test_hidden_states_and_observed_columns_are_described():
    data = DataConfig(hidden=("h",), observe={"y": "a*h"})
    prior = PriorConfig(equations={"dx": "h - x", "dh": "-h"})
    lines = describe(TABLE, JobConfig(prior=prior, data=data)).split("\n")
    assert lines[-5:] == [
        "states: x",
        "hidden states: h",
        "given: dx/dt = h - x",
        "given: dh/dt = -h",
        "observed: y = a*h",
    ]


def test_parameters_by_run_are_described_as_parameters():
    parameters = {"k": ParameterConfig(lower=0.1, upper=10.0, by="run")}
    config = JobConfig(prior=PriorConfig(equations={"dx": "-k*x", "dy": "?"}, parameters=parameters))
    lines = describe(TABLE, config).split("\n")
    assert lines[-4:] == ["states: x, y", "parameters by run: k", "given: dx/dt = -k*x", "given: dy/dt = ?"]
    text = outline(TABLE, config).as_text()
    assert "  parameter k, by run: 0.1 to 10, beginning at 1\n" in text
    assert "dk/dt" not in text
    assert "from x, y, of" in text  # not from k, which ? does not name


def test_demanded_shapes_are_described():
    prior = GIVEN.prior.model_copy(update={"positive": ("?",), "monotone": {"x": ("increasing in y",)}})
    described = describe(TABLE, GIVEN.model_copy(update={"prior": prior})).split("\n")
    assert described[-1] == "shape: dx/dt: positive; increasing in y"


def test_an_outline_for_programs_has_given_equations_as_mathml_and_nothing_new_without_them():
    made = outline(TABLE, GIVEN).as_dict()
    first, second = made["equations"]
    assert (first["given"], first["unknown"], first["variables"]) == ("-k*x + ?(y)", "?", ["y"])
    assert (second["given"], second["unknown"]) == ("c/2 - a*y", "")
    assert first["mathml"].startswith("<math ")
    assert '<mi class="unknown">?</mi>' in first["mathml"]
    assert made["parameters"] == ["k: 0.1 to 10, beginning at 1", "c: at least 2, beginning at 2", "a: beginning at 3"]
    plain = outline(TABLE, JobConfig()).as_dict()
    assert "parameters" not in plain
    assert set(plain["equations"][0]) == {"lhs", "variables", "operators", "known", "guesses"}


def with_units(**units):
    config = GIVEN.model_copy(update={"data": DataConfig(units=units)})
    return outline(TABLE, config)


def test_units_of_unknown_parts_and_parameters_follow_from_the_units_of_the_columns():
    plan = with_units(x="m", y="m", t="s")
    assert "searched: ? [m/s] of dx/dt" in plan.as_text()
    assert plan.as_dict()["parameters"] == [
        "k [1/s]: 0.1 to 10, beginning at 1",
        "c: at least 2, beginning at 2",  # c/2: the number may have a unit as well
        "a [1/s]: beginning at 3",
    ]
    assert plan.as_dict()["equations"][0]["unit"] == "m/s"
    assert plan.warnings == ()


def test_an_observed_column_has_its_own_unit_and_no_unit_of_a_rate():
    def planned(side):
        data = DataConfig(units={"x": "m", "y": "V", "t": "s"}, observe={"y": side})
        return outline(TABLE, JobConfig(prior=PriorConfig(equations={"dx": "-k*x"}), data=data))

    assert planned("a*x + b").parameters[1:] == ("a [V/m]: beginning at 1", "b [V]: beginning at 1")
    assert planned("a*x + b").warnings == ()
    (warning,) = planned("x + b").warnings
    assert "the term x has the unit m instead of the unit V" in warning


def test_given_terms_with_impossible_units_are_a_warning():
    prior = PriorConfig(equations={"dx": "-k*x + exp(y)"})
    config = JobConfig(prior=prior, data=DataConfig(units={"x": "m", "y": "m", "t": "s"}))
    (warning,) = outline(TABLE, config).warnings
    assert "given equation of 'x'" in warning
    assert "argument y of a function has the unit m" in warning


def test_units_of_second_derivatives_and_velocities():
    prior = PriorConfig(equations={"d2x": "-k*x - c*x_dot + ?"})
    config = JobConfig(prior=prior, data=DataConfig(order=2, states=("x",), units={"x": "m", "t": "s"}))
    plan = outline(TABLE, config)
    assert plan.parameters == ("k [1/s^2]: beginning at 1", "c [1/s]: beginning at 1")
    assert "searched: ? [m/s^2] of d2x/dt2" in plan.as_text()
