"""Shorter descriptions near a system."""

import numpy as np
import pytest

from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.structure.moves.extensions import extensions
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places, structure
from tests.unit.coordinator.model.shooting.made import SWING, Known, compare, measurements

TIMES = 0.1 * np.arange(40.0)
ARITHMETIC = frozenset(BY_NAME[name].code for name in ("+", "-", "*"))
PLENTY = 10**12


def around(_, program):
    return extensions(program, [1.0, 1.0], ARITHMETIC)


@pytest.fixture
def swinging():
    return compare(SWING, measurements(SWING, ([1.0, 2.0], [0.5, -1.0]), TIMES, noise=0.02, seed=110), 1e-5)


def begun(comparison, *texts):
    model = comparison.fit_model([SWING.parsed(text) for text in texts])
    assert model is not None
    return model


def forms(model):
    return {structure(program) for program in model.programs}


TRUE_FORMS = [
    {structure(SWING.parsed(text)) for text in ("y", other)}
    for other in (
        "-2.1*x - 0.3*y",
        "-0.3*y - 2.1*x",
        "-(2.1*x + 0.3*y)",
        "-(0.3*y + 2.1*x)",
        "2.1*x + 0.3*y",
        "0.3*y + 2.1*x",
        "0.3*y - 2.1*x",
        "2.1*x - 0.3*y",
    )
]


@pytest.mark.parametrize(
    "texts",
    [
        ("y", "-2.1*x - 0.3*y + 0.1*x*y"),
        ("y + 0.05*x", "-2.1*x - 0.3*y"),
        ("1.1*y", "-2.1*x - 0.3*y + 0.02"),
        ("y", "-2.1*x - 0.3*y - 0.1*x*x + 0.05*y*y"),
    ],
)
def test_whatever_is_not_needed_goes(swinging, texts):
    start = begun(swinging, *texts)
    end = LocalSearch(swinging, lambda *_: iter(()), PLENTY).improve(start, [0, 1])
    assert forms(end) in TRUE_FORMS
    assert end.nats < start.nats


def test_a_number_that_is_one_within_a_factor_goes_by_multiplying_out():
    """v' = b (v - x**2 v) - x has one number; with b v (c - x**2) - x, which is as short otherwise, it has two."""
    known = Known(("x", "v"), lambda _, z: [z[1], 0.5 * z[1] * (1.0 - z[0] ** 2) - z[0]])
    comparison = compare(known, measurements(known, ([1.0, 2.0],), 0.1 * np.arange(100.0), noise=0.05, seed=112), 1e-6)
    start = comparison.fit_model([known.parsed("v"), known.parsed("0.45*v*(1.1 - x*x) - x")])
    end = LocalSearch(comparison, lambda *_: iter(()), PLENTY).prune(start, 1)
    assert len(constant_places(end.programs[1])) == 1
    assert end.nats < start.nats - 2.0


@pytest.mark.parametrize("rate", [1.0, 1.01, 1.02, 1.03, 1.05, 1.1])
def test_a_constant_goes_only_if_that_shortens_the_description(rate):
    """x' = -r x, where r is 1 as far as the data can tell, or nearly, or not at all."""
    known = Known(("x",), lambda _, z: [-rate * z[0]])
    comparison = compare(known, measurements(known, ([1.0], [-2.0]), TIMES, noise=0.02, seed=111), 1e-6)
    start = comparison.fit_model([known.parsed("-1.2*x")])
    end = LocalSearch(comparison, lambda *_: iter(()), PLENTY).improve(start, [0])
    assert end.nats <= start.nats
    bare = comparison.fit_model([known.parsed("-x")])
    assert (structure(end.programs[0]) == structure(bare.programs[0])) == (
        bare.nats < start.nats - SETTINGS.selection.least_gain
    )
    if rate in (1.0, 1.1):
        assert (len(end.programs[0]) == 2) == (rate == 1.0)


def test_what_is_missing_is_found(swinging):
    end = LocalSearch(swinging, around, PLENTY).improve(begun(swinging, "y", "-1.5*x"), [0, 1])
    assert forms(end) in TRUE_FORMS


def test_the_shortest_stays_itself(swinging):
    start = begun(swinging, "y", "-2.1*x - 0.3*y")
    end = LocalSearch(swinging, around, PLENTY).improve(start, [0, 1])
    assert end.nats >= start.nats - SETTINGS.selection.least_gain
    assert forms(end) == forms(start)


def test_only_the_equations_named_are_changed(swinging):
    start = begun(swinging, "y + 0.05*x", "-2.1*x - 0.3*y + 0.1*x*y")
    end = LocalSearch(swinging, around, PLENTY).improve(start, [1])
    assert structure(end.programs[0]) == structure(start.programs[0])
    assert structure(end.programs[1]) != structure(start.programs[1])


@pytest.mark.parametrize("budget", [1, 200_000])
def test_the_budget_ends_it(swinging, budget):
    start = begun(swinging, "y", "-1.5*x")
    most = swinging.estimator.work + budget
    descent = LocalSearch(swinging, around, most)
    end = descent.improve(start, [0, 1])
    assert descent.is_exhausted
    largest_round = 100 * 2 * (2 * 80) * 6 * (20 + 2 * (1 + 6 + 2))  # two steps of six evaluations for each row
    assert swinging.estimator.work <= most + largest_round
    assert end.nats <= start.nats


def test_an_exhausted_descent_changes_nothing(swinging):
    start = begun(swinging, "y", "-1.5*x")
    descent = LocalSearch(swinging, around, 0)
    assert descent.is_exhausted
    assert descent.improve(start, [0, 1]) is start
    assert descent.reduce(start, 1) is start


def test_a_descent_that_comes_to_a_system_that_was_tried_ends_there(swinging):
    tried = []

    def near(equation, program):
        tried.append(equation)
        return around(equation, program)

    descent = LocalSearch(swinging, near, PLENTY)
    end = descent.improve(begun(swinging, "y", "-2.1*x - 0.3*y"), [0, 1])
    first = len(tried)
    again = descent.improve(begun(swinging, "y + 0.05*x", "-2.1*x - 0.3*y"), [0, 1])
    assert forms(again) == forms(end)
    assert first > 0
    assert len(tried) == first
