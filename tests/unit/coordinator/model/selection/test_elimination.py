"""How the least significant terms of a library leave a sum one after another."""

import numpy as np
import pytest

from atoll_coordinator.model.selection.elimination import eliminated
from atoll_coordinator.model.structure.term_libraries import fractions, libraries, product_of
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.operators import ADD, DIVIDE, MULTIPLY, VARIABLE
from atoll_core.expression.program import constant_places
from tests.unit.coordinator.model.shooting.made import SWING, Known, compare, measurements_of, recording

PLAIN = (ADD, MULTIPLY)
X, Y = (VARIABLE, 0), (VARIABLE, 1)
SQUARES = [1.0, X, Y, *map(product_of, ((X, X), (X, Y), (Y, Y)))]
TIMES = 0.1 * np.arange(40.0)
DUFFING = Known(("x", "y"), lambda _, z: [z[1], -1.5 * z[0] - 0.7 * z[0] ** 3 - 0.2 * z[1]])


def duffing(noise):
    """Return the comparison of y alone, and its problem as a smoother would make it."""
    whole = recording(DUFFING, ([1.0, 1.0], [-1.5, 0.5], [0.4, -2.0]), TIMES, noise=noise)
    rows = measurements_of(whole, [1])
    alone = compare(DUFFING, rows, 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[1] for part in whole.trajectories])
    labels = slopes + noise * np.random.default_rng(3).standard_normal(len(slopes))
    return alone, Problem(DUFFING.names, inputs, Target("y", "dy/dt", labels, 0.01, float(labels.std()), noise))


def test_elimination_goes_past_the_truth():
    alone, problem = duffing(0.02)
    (terms,) = (library for library in libraries([0, 1], PLAIN) if len(library) == 10)
    models = eliminated(alone, problem, terms)
    assert [len(constant_places(model.programs[0])) for model in models] == list(range(10, 0, -1))
    best = min(models, key=lambda model: model.nats)
    assert sorted(best.fit.system.values.tolist()) == pytest.approx([-1.5, -0.7, -0.2], abs=0.06)
    text = DUFFING.text(best.programs[0])
    assert (text.count("x"), text.count("y")) == (2, 1) or (text.count("x"), text.count("y")) == (4, 1)


def test_columns_that_repeat_each_other_are_no_trouble():
    """With y = 0 the products of y have no part in the fit, and their coefficients none in the program."""
    alone, problem = duffing(0.02)
    inputs = problem.inputs.copy()
    inputs[1] = 0.0
    flat = Problem(problem.names, inputs, problem.target)
    assert eliminated(alone, flat, [1.0, X, Y, (MULTIPLY, X, Y)])


def test_a_linear_system_is_found_alone():
    whole = recording(SWING, ([1.0, 1.0], [-1.5, 0.5]), TIMES, noise=0.01)
    alone = compare(SWING, measurements_of(whole, [1]), 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[1] for part in whole.trajectories])
    problem = Problem(SWING.names, inputs, Target("y", "dy/dt", slopes, 0.01, float(slopes.std()), 0.01))
    models = eliminated(alone, problem, SQUARES)
    best = min(models, key=lambda model: model.nats)
    assert sorted(best.fit.system.values.tolist()) == pytest.approx([-2.0, -0.3], abs=0.03)


PREY = Known(("x", "y"), lambda _, z: [4.0 * z[0] - z[0] ** 2 - z[0] * z[1] / (1.0 + z[0]), 0.5 * z[1]])


def test_elimination_goes_past_a_law_that_saturates():
    """Its half-saturation is found from elsewhere, and goes on from where the fit before has left it."""
    whole = recording(PREY, ([5.0, 1.0], [0.5, 2.0], [2.0, 3.0]), TIMES, noise=0.01)
    alone = compare(PREY, measurements_of(whole, [0]), 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[0] for part in whole.trajectories])
    problem = Problem(PREY.names, inputs, Target("x", "dx/dt", slopes, 0.01, float(slopes.std()), 0.01))
    models = eliminated(alone, problem, next(fractions([0, 1], (*PLAIN, DIVIDE), [3.0, 3.0])))
    best = min(models, key=lambda model: model.nats)
    assert sorted(best.fit.system.values.tolist()) == pytest.approx([-1.0, -1.0, 1.0, 4.0], abs=0.15)


def test_what_has_no_value_is_left_out():
    alone, problem = duffing(0.02)
    inputs = problem.inputs.copy()
    inputs[1, 0] = 0.0
    flat = Problem(problem.names, inputs, problem.target)
    assert eliminated(alone, flat, [1.0, (DIVIDE, X, Y)]) == []
