"""Constants as they are shown: simple where the trajectories single a number out, else estimates in few digits."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.inference.final_model import attach_estimates
from atoll_coordinator.model.inference.trajectory_simulation import fit_initial_states
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import constant_places, structure
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, Known, compare, measurements

TIMES = 0.25 * np.arange(60.0)


def decayed(rate, noise, text="-0.3*x", seed=0):
    """Return the comparison of x' = -rate x with a little noise, and the model of `text` in it."""
    known = Known(("x",), lambda _, z: [-rate * z[0]])
    comparison = compare(known, measurements(known, [[2.0], [-1.0]], TIMES, noise=noise, seed=seed), 1e-8)
    model = comparison.fit_model([known.parsed(text)], lengths=(10, None))
    assert model is not None
    return known, comparison, model


def round_system(comparison, model):
    def growth(programs):
        return comparison.score_fit(fit_initial_states(comparison, programs, model.fit)).misfit - model.misfit

    return attach_estimates(comparison, model).accept_simple_numbers(growth)


def shown(rate, noise, **options):
    known, rounded, model = decayed(rate, noise, **options)
    (program,) = round_system(rounded, model)
    return known.text(program), model


@pytest.mark.parametrize(
    ("rate", "simple"), [(0.05, "-0.05*x"), (0.25, "-0.25*x"), (0.3, "-0.3*x"), (0.5, "-0.5*x"), (1.0, "-x")]
)
def test_a_simple_number_that_is_singled_out_is_taken(rate, simple):
    text, model = shown(rate, 0.001)
    (value,), (error,) = np.abs(model.fit.system.values), np.sqrt(np.diag(covariance(model.fit)))
    assert value != rate
    assert abs(value - rate) < 4.0 * error
    assert text == simple


def test_a_simple_number_that_is_merely_within_the_error_is_not_taken():
    """0.05 lies within the errors of 0.0496, known to about 0.002, and so do many numbers."""
    _, decay, model = decayed(0.0496, 0.03)
    error = math.sqrt(covariance(model.fit)[0, 0])
    assert 5e-4 < error < 4e-3
    assert round_system(decay, model) == model.programs
    rounded = attach_estimates(decay, model).round_equations(2)
    (value,) = np.abs(rounded.programs[0].constants[constant_places(rounded.programs[0])])
    ((simple,),) = rounded.simple
    assert value != 0.05
    assert len(str(value)) <= 7
    assert abs(value - abs(model.fit.system.values[0])) < 0.05 * error
    assert simple.odds < 20.0
    assert simple.standard_errors < 4.0


def test_a_number_that_is_not_simple_keeps_the_digits_that_are_known():
    text, _ = shown(0.31415926, 1e-5)
    assert float(text.removeprefix("-").removesuffix("*x")) == pytest.approx(0.31415926, abs=1e-5)
    assert text != "-0.3*x"


def test_a_third_is_a_simple_number():
    text, _ = shown(1.0 / 3.0, 1e-4)
    assert eval(text.replace("x", "1.0")) == -1.0 / 3.0


@pytest.mark.parametrize("seed", [0, 1])
def test_all_constants_of_a_system_are_decided_together(seed):
    comparison = compare(LOTKA, measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES[:40], noise=0.001, seed=seed), 1e-8)
    model = comparison.fit_model(
        [LOTKA.parsed(text) for text in ("2.9*x - 2.1*x*y - 0.9*x*x", "1.9*y - 0.9*x*y - 1.1*y*y")]
    )
    programs = round_system(comparison, model)
    values = [sorted(np.abs(program.constants[constant_places(program)]).tolist()) for program in programs]
    assert [value[-1] for value in values] == [3.0, 2.0]
    assert set().union(*values) <= {1.0, 2.0, 3.0}


def test_what_is_shown_misses_the_measurements_by_little_more():
    for rate, noise in ((0.0496, 0.03), (0.05, 0.001)):
        _, decay, model = decayed(rate, noise)
        rounded = attach_estimates(decay, model).round_equations(2)
        held = decay.system(rounded.programs, [range(len(rounded.programs[0]))])
        fixed = decay.estimator.fit(held, None, 30)
        assert abs(decay.score_fit(fixed).misfit - model.misfit) < 2.0


def test_a_fixed_equation_is_shown_as_it_is():
    rows = measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES[:40], noise=0.001)
    comparison = compare(LOTKA, rows, 1e-8, fixed=[1])
    known = LOTKA.parsed("2.0013*y - x*y - y**2")
    model = comparison.fit_model([LOTKA.parsed("2.9*x - 2.1*x*y - 0.9*x*x"), known])
    programs = round_system(comparison, model)
    assert programs[1] == known
    assert 3.0 in np.abs(programs[0].constants).tolist()
    assert [len(simple) for simple in attach_estimates(comparison, model).round_equations(2).simple] == [
        len(constant_places(model.programs[0])),
        0,
    ]


def test_with_nothing_to_decide_programs_stay():
    comparison = compare(LOTKA, measurements(LOTKA, ([1.0, 3.0],), TIMES[:40], noise=0.01), 1e-8, fixed=[0, 1])
    model = comparison.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert round_system(comparison, model) == model.programs


def test_too_many_constants_are_left_as_fitted():
    known, rounded, _ = decayed(0.3, 0.01)
    text = " - ".join(f"{0.2 + 0.001 * index}*x**{index}" for index in range(1, SETTINGS.effort.beam + 2))
    system = rounded.system([known.parsed(text)])
    fit = rounded.estimator.fit(system, 5, 0)
    model = rounded.score_fit(fit)
    assert len(constant_places(model.programs[0])) > SETTINGS.effort.beam
    assert round_system(rounded, model) == model.programs


def test_a_constant_that_becomes_neutral_goes():
    known, rounded, model = decayed(1.0, 0.001)
    (program,) = round_system(rounded, model)
    assert constant_places(program) == []
    assert structure(program) == structure(known.parsed("-x"))
