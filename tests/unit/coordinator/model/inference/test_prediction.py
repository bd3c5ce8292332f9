"""What a model and its rivals foretell from other initial states inside the measured box."""

import numpy as np
import pytest

from atoll_coordinator.model.inference.prediction import Rival, draws, foretell
from atoll_coordinator.model.shooting.system import system_of
from tests.unit.coordinator.model.shooting.made import DECAY, DRIVEN, LOTKA, LOTKA_TEXT, SWING, measurements

TIMES = 0.1 * np.arange(40.0)
STARTS = ([1.0, 3.0], [4.0, 1.0], [8.0, 2.0])


def system(known, *texts):
    return system_of([known.parsed(text) for text in texts], known.names, known.names)


@pytest.fixture(scope="module")
def lotka():
    return measurements(LOTKA, STARTS, TIMES, noise=0.05)


@pytest.fixture(scope="module")
def truth():
    return system(LOTKA, *LOTKA_TEXT)


def test_a_model_without_rivals_is_relied_upon(lotka, truth):
    for its in foretell(lotka, truth, [], 1e-6):
        assert (its.starts, its.followed, its.probability, its.is_disputed) == (12, 12, 1.0, False)
        assert {*its.measure_from} == {"x", "y"}
        assert 0.0 <= its.novelty < 0.5


def test_a_rival_that_foretells_the_same_does_not_count(lotka, truth):
    near = system(LOTKA, "3.01*x - 2*x*y - x**2", LOTKA_TEXT[1])
    assert [its.probability for its in foretell(lotka, truth, [Rival(near, 0, 1.0)], 1e-6)] == [1.0, 1.0]


def test_a_rival_that_foretells_otherwise_takes_its_share_of_the_odds(lotka, truth):
    other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1])
    x, y = foretell(lotka, truth, [Rival(other, 0, 0.25)], 1e-6)
    assert x.probability == pytest.approx(0.8)
    assert x.is_disputed
    for name, low, high in (("x", 0.0, 8.0), ("y", 0.0, 3.1)):
        assert low <= x.measure_from[name] <= high
    assert y.probability <= 1.0


def test_rivals_of_two_equations_are_independent(lotka, truth):
    one, other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1]), system(LOTKA, LOTKA_TEXT[0], "-0.5*y")
    x, _ = foretell(lotka, truth, [Rival(one, 0, 1.0), Rival(other, 1, 1.0)], 1e-6)
    assert x.probability == pytest.approx(0.25)


def test_rivals_of_one_equation_exclude_one_another(lotka, truth):
    one, other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1]), system(LOTKA, "-0.6*x", LOTKA_TEXT[1])
    x, _ = foretell(lotka, truth, [Rival(one, 0, 1.0), Rival(other, 0, 1.0)], 1e-6)
    assert x.probability == pytest.approx(1.0 / 3.0)


def test_a_rival_that_runs_away_foretells_otherwise(lotka, truth):
    other = system(LOTKA, "3*x*x", LOTKA_TEXT[1])
    assert foretell(lotka, truth, [Rival(other, 0, 1.0)], 1e-6)[0].probability == pytest.approx(0.5)


def test_a_model_that_runs_away_is_followed_nowhere(lotka):
    for its in foretell(lotka, system(LOTKA, "30*x*x", "30*y*y"), [], 1e-6):
        assert (its.followed, its.probability) == (0, 0.0)


def test_what_was_not_measured_is_far():
    """One slow trajectory leaves most of its box unseen; many of them do not."""
    one = measurements(LOTKA, [[8.0, 2.0]], TIMES)
    many = measurements(LOTKA, [[x, y] for x in (1.0, 4.0, 8.0) for y in (0.5, 2.0, 3.0)], TIMES)
    truth = system(LOTKA, *LOTKA_TEXT)
    assert foretell(many, truth, [], 1e-6)[0].novelty < foretell(one, truth, [], 1e-6)[0].novelty


def test_what_goes_beyond_the_measured_range_is_said():
    """A swing measured for a quarter of its period never has x below zero."""
    quarter = measurements(SWING, [[1.0, 0.0]], 0.02 * np.arange(50.0))
    x, _ = foretell(quarter, system(SWING, "y", "-2*x - 0.3*y"), [], 1e-6)
    assert x.reached is not None
    assert x.reached < 0.0
    whole = measurements(SWING, [[1.0, 0.0], [-1.0, 0.5]], TIMES)
    assert foretell(whole, system(SWING, "-0.1*x", "-0.1*y"), [], 1e-6)[0].reached is None


def test_inputs_are_not_known_elsewhere():
    driven = measurements(DRIVEN, [[1.0]], TIMES)
    assert foretell(driven, system_of([DRIVEN.parsed("-0.8*x + 1.5*u")], DRIVEN.names, DRIVEN.names), [], 1e-6) is None


def test_draws_spread_as_the_covariance_says():
    its = system(DECAY, "-0.5*x")
    drawn = np.array([each.system.values for each in draws(its, np.array([[0.01]]), 3)])
    assert drawn.shape == (12, 1)
    assert 0.03 < drawn.std() < 0.3
    assert {each.group for each in draws(its, np.array([[0.01]]), 3)} == {3}


def test_a_system_without_constants_has_no_draws():
    assert not [*draws(system(DECAY, "x"), np.zeros((0, 0)), 0)]
