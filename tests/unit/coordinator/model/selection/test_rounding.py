"""Constants made simple where the trajectories cannot tell the difference."""

import math

import numpy as np
import pytest

from atoll.expression.program import constant_places, structure
from atoll_coordinator.model.selection.rounding import rounded
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.shooting.covariance import covariance
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, Known, contest, measurements

TIMES = 0.25 * np.arange(60.0)


def decayed(rate, noise, text="-0.3*x", seed=0):
    """Return the contest of x' = -rate x with a little noise, and the standing of `text` in it."""
    known = Known(("x",), lambda _, z: [-rate * z[0]])
    its = contest(known, measurements(known, [[2.0], [-1.0]], TIMES, noise=noise, seed=seed), 1e-8)
    standing = its.stand([known.parsed(text)], lengths=(10, None))
    assert standing is not None
    return known, its, standing


def shown(rate, noise, **options):
    known, its, standing = decayed(rate, noise, **options)
    (program,) = rounded(its, standing)
    return known.text(program), standing


@pytest.mark.parametrize(
    ("rate", "simple"), [(0.05, "-0.05*x"), (0.25, "-0.25*x"), (0.3, "-0.3*x"), (0.5, "-0.5*x"), (1.0, "-x")]
)
def test_a_simple_number_within_the_error_is_taken(rate, simple):
    text, standing = shown(rate, 0.02)
    (value,), (error,) = np.abs(standing.shot.system.values), np.sqrt(np.diag(covariance(standing.shot)))
    assert value != rate
    assert abs(value - rate) < 4.0 * error
    assert text == simple


def test_the_shorter_number_is_taken_the_less_is_known():
    """0.0496 with an error of about 0.0001 stays; with one of about 0.002 it is 0.05."""
    assert shown(0.0496, 1e-4)[0] == "-0.0496*x"
    text, standing = shown(0.0496, 0.03)
    assert 5e-4 < math.sqrt(covariance(standing.shot)[0, 0]) < 4e-3
    assert text == "-0.05*x"


def test_a_number_that_is_not_simple_keeps_the_digits_that_are_known():
    text, _ = shown(0.31415926, 1e-5)
    assert float(text.removeprefix("-").removesuffix("*x")) == pytest.approx(0.31415926, abs=1e-5)
    assert text != "-0.3*x"


def test_a_third_is_a_simple_number():
    text, _ = shown(1.0 / 3.0, 1e-4)
    assert eval(text.replace("x", "1.0")) == -1.0 / 3.0


@pytest.mark.parametrize("seed", [0, 1])
def test_all_constants_of_a_system_are_decided_together(seed):
    its = contest(LOTKA, measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES[:40], noise=0.01, seed=seed), 1e-8)
    standing = its.stand([LOTKA.parsed(text) for text in ("2.9*x - 2.1*x*y - 0.9*x*x", "1.9*y - 0.9*x*y - 1.1*y*y")])
    programs = rounded(its, standing)
    values = [sorted(np.abs(each.constants[constant_places(each)]).tolist()) for each in programs]
    assert [value[-1] for value in values] == [3.0, 2.0]
    assert set().union(*values) <= {1.0, 2.0, 3.0}


def test_what_is_shown_misses_the_measurements_by_little_more():
    _, its, standing = decayed(0.0496, 0.03)
    (program,) = rounded(its, standing)
    held = its.system([program], [range(len(program))])
    simple = its.shooter.fit(held, None, 30)
    assert standing.misfit <= its.measured([program], simple).misfit < standing.misfit + 3.0


def test_a_fixed_equation_is_shown_as_it_is():
    rows = measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES[:40], noise=0.01)
    its = contest(LOTKA, rows, 1e-8, fixed=[1])
    known = LOTKA.parsed("2.0013*y - x*y - y**2")
    standing = its.stand([LOTKA.parsed("2.9*x - 2.1*x*y - 0.9*x*x"), known])
    programs = rounded(its, standing)
    assert programs[1] == known
    assert 3.0 in np.abs(programs[0].constants).tolist()


def test_with_nothing_to_decide_programs_stay():
    its = contest(LOTKA, measurements(LOTKA, ([1.0, 3.0],), TIMES[:40], noise=0.01), 1e-8, fixed=[0, 1])
    standing = its.stand([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert rounded(its, standing) == standing.programs


def test_too_many_constants_are_left_as_fitted():
    known, its, _ = decayed(0.3, 0.01)
    text = " - ".join(
        f"{0.2 + 0.001 * index}*x**{index}" for index in range(1, SETTINGS.selection.most_rounded_constants + 2)
    )
    system = its.system([known.parsed(text)])
    shot = its.shooter.fit(system, 5, 0)
    standing = its.measured([known.parsed(text)], shot)
    assert len(constant_places(standing.programs[0])) > SETTINGS.selection.most_rounded_constants
    assert rounded(its, standing) == standing.programs


def test_a_constant_that_becomes_neutral_goes():
    known, its, standing = decayed(1.0, 0.02)
    (program,) = rounded(its, standing)
    assert constant_places(program) == []
    assert structure(program) == structure(known.parsed("-x"))
