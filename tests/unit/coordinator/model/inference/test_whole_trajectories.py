"""Long trajectories, fitted in pieces and tested in whole; few rows a period; and what no equation describes."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.inference import long_run
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.selection import joint_search
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig, JobConfig, SpaceConfig
from atoll_core.expression.text.infix import to_infix
from tests.unit.coordinator.model.fitting import settings
from tests.unit.coordinator.model.inference.refining import (
    ARITHMETIC,
    NO_LIBRARIES,
    NOTHING_ELSE,
    check_of,
    is_same,
    refined,
)
from tests.unit.coordinator.model.shooting.made import DECAY, DRIVEN, SWING, Known, pools, table


@pytest.fixture(autouse=True)
def _little_work(monkeypatch):
    """Few neighbours are looked at, so that a test takes a second or two."""
    monkeypatch.setattr(joint_search, "SETTINGS", settings("effort", work=6_000_000))


@pytest.mark.parametrize(("system", "start", "candidates"), [
    (SWING, [4.0, 0.0], {"x": ("y",), "y": ("-2*x - 0.3*y",)}),
    (Known(("x", "y"), lambda _, z: [z[0] - z[0] * z[1], z[0] * z[1] - z[1]]), [2.5, 1.0],
     {"x": ("x - x*y",), "y": ("x*y - y",)}),
], ids=["damped", "conservative"])  # fmt: skip
def test_a_trajectory_longer_than_what_is_simulated_at_a_stretch_is_no_chaos(monkeypatch, system, start, candidates):
    """Where errors shrink, or grow as slowly as those of a phase do, initial states are of use however long it is."""
    if system is SWING:  # known by its errors alone
        monkeypatch.setattr(long_run, "_fits_in_whole", lambda _: None)
    refinement = refined(system, [start], candidates, times=0.05 * np.arange(700.0), noise=0.05, config=NOTHING_ELSE)
    assert SETTINGS.shooting.piece < 700
    assert refinement.chaos is None


@pytest.mark.parametrize(("noise", "grades"), [(0.0, {"exact"}), (0.01, {"good"})])
def test_growth_that_was_measured_to_go_on_is_no_doubt(noise, grades):
    """Begun from the middle of what was measured it leads far beyond; that is what growth is, and no chaos."""
    growth = Known(("x",), lambda _, z: [0.3 * z[0]])
    refinement = refined(
        growth, ([1.0],), {"x": ("0.3*x",)}, noise=noise, times=0.1 * np.arange(100.0), config=NOTHING_ELSE
    )
    assert {equation.grade for equation in refinement.equations.values()} == grades
    assert refinement.chaos is None
    assert all(equation.prediction.followed == equation.prediction.starts for equation in refinement.equations.values())


def test_what_is_missing_in_the_long_run_alone_is_a_doubt():
    """Along 500 rows, five periods, the damping is less than noise; along 8,000 a fifth of the amplitude is lost."""
    slow = Known(("x", "v"), lambda _, z: [z[1], -z[0] - 0.001 * z[1]])
    times, wrong = 0.06 * np.arange(8_000.0), {"x": ("v",), "v": ("-x",)}
    refinement = refined(slow, [[1.0, 0.0]], wrong, times=times, noise=0.05, config=NOTHING_ELSE)
    assert is_same(slow, refinement, x="v", v="-x")
    assert {equation.grade for equation in refinement.equations.values()} == {"doubtful"}
    assert all("pieces of 500 rows but not whole" in equation.reason for equation in refinement.equations.values())


def test_a_model_that_describes_whole_trajectories_is_said_to_be_tested_on_them():
    pool = {"x": ("y",), "y": ("-2*x - 0.3*y",)}
    refinement = refined(SWING, [[4.0, 0.0]], pool, times=0.05 * np.arange(700.0), noise=0.05, config=NOTHING_ELSE)
    assert {equation.grade for equation in refinement.equations.values()} == {"good"}
    assert any("the model describes them, too" in warning for warning in refinement.warnings)


@pytest.mark.slow
def test_a_conservative_system_is_followed_for_hundreds_of_periods():
    """Errors of integration add up; a model without a constant to fit has nothing that could make up for them."""
    pendulum = Known(("x", "v"), lambda _, z: [z[1], -np.sin(z[0])])
    refinement = refined(pendulum, [[2.5, 0.0]], {"x": ("v",), "v": ("-sin(x)",)}, times=0.05 * np.arange(12_500.0),
                  noise=0.05, config=NOTHING_ELSE)  # fmt: skip
    assert {equation.grade for equation in refinement.equations.values()} == {"good"}
    assert refinement.chaos is None


VAN_DER_POL = Known(("x", "v"), lambda _, z: [z[1], 0.8 * (1.0 - z[0] ** 2) * z[1] - z[0]])


def test_a_model_of_the_plane_is_not_chaotic_however_fast_errors_grow():
    """Errors grow on the way from beside the unstable point to the cycle; Poincaré and Bendixson exclude chaos."""
    refinement = refined(VAN_DER_POL, [[0.1, 0.0]], {"x": ("v",), "v": ("0.8*v - 0.8*x*x*v - x",)},
                         times=0.1 * np.arange(400.0), noise=0.05, config=NOTHING_ELSE)  # fmt: skip
    assert refinement.chaos is None
    assert not any("chaotic" in equation.reason for equation in refinement.equations.values())


def test_a_model_of_the_plane_whose_errors_grow_is_tested_along_whole_trajectories(monkeypatch):
    """As in `test_what_is_missing_in_the_long_run_alone_is_a_doubt`, with errors that grow as those of chaos do."""
    monkeypatch.setattr(long_run, "growth_rate", lambda _: 10.0)
    slow = Known(("x", "v"), lambda _, z: [z[1], -z[0] - 0.001 * z[1]])
    times, wrong = 0.06 * np.arange(8_000.0), {"x": ("v",), "v": ("-x",)}
    refinement = refined(slow, [[1.0, 0.0]], wrong, times=times, noise=0.05, config=NOTHING_ELSE)
    assert refinement.chaos is None
    assert all("pieces of 500 rows but not whole" in equation.reason for equation in refinement.equations.values())


@pytest.mark.slow
def test_a_driven_model_whose_errors_grow_is_not_blamed_for_whole_trajectories_that_nobody_can_predict():
    """Where there are inputs, chaos is not looked for."""
    wave = (lambda t: 0.4 * np.cos(1.2 * t), lambda t: -0.48 * np.sin(1.2 * t))
    duffing = Known(("x", "v"), lambda t, z: [z[1], z[0] - z[0] ** 3 - 0.15 * z[1] + wave[0](t)], {"w": wave})
    refinement = refined(duffing, [[1.0, 0.0]], {"x": ("v",), "v": ("x - x*x*x - 0.15*v + w",)},
                  times=0.05 * np.arange(5000.0), noise=0.02,
                  config=JobConfig(space=NO_LIBRARIES, data=DataConfig(states=("x", "v"), inputs=("w",))))  # fmt: skip
    whole = [check_of(refinement, name, "whole trajectories") for name in ("x", "v")]
    assert all(check.outcome == "not made" for check in whole)


TURNING = Known(("x", "v"), lambda _, z: [z[1], -z[0]])


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "equations"), [(5, ("0.79*v", "-1.05*x")), (6, ("v", "-0.99998*x"))])
def test_few_rows_a_period_are_not_described_by_what_differentiation_errs_by(rows, equations):
    """Derivatives are wrong by a factor there, and what smoothing takes for noise allowed steps that need terms."""
    times = 2.0 * math.pi / rows * np.arange(120.0)
    preparation = prepare(table(TURNING, ([1.0, 0.0],), times), JobConfig(space=ARITHMETIC))
    refinement = refine_all(
        preparation, JobConfig(space=ARITHMETIC), pools(preparation, x=equations[:1], v=equations[1:])
    )
    assert [to_infix(equation.program, TURNING.names) for equation in refinement.equations.values()] == ["v", "-x"]
    assert {equation.grade for equation in refinement.equations.values()} <= {"good", "exact"}


@pytest.mark.slow
def test_an_equation_through_four_points_is_no_law():
    """Four rows a period are four measurements, again and again, and any odd function of v leads through them."""
    times = 0.5 * math.pi * np.arange(80.0)
    preparation = prepare(table(TURNING, ([1.0, 0.0],), times), JobConfig(space=ARITHMETIC))
    refinement = refine_all(preparation, JobConfig(space=ARITHMETIC), pools(preparation, x=("v",), v=("-x",)))
    assert {equation.grade for equation in refinement.equations.values()} == {"doubtful"}
    assert all("4 rows differ" in equation.reason for equation in refinement.equations.values())


@pytest.mark.slow
def test_errors_of_integration_have_no_terms_where_few_rows_are_taken_for_noisy():
    eight = table(DECAY, ([3.0],), np.arange(8.0))
    preparation = prepare(eight, JobConfig())
    refinement = refine_all(preparation, JobConfig(), pools(preparation, x=("-0.5*x", "0.001 - 0.5*x"))).equations["x"]
    assert preparation.recording.smoothing[0].relative_noise > SETTINGS.selection.least_noise
    assert (to_infix(refinement.program, ("x",)), refinement.grade) == ("-0.5*x", "good")


@pytest.mark.slow
def test_of_functions_that_are_one_at_all_measured_values_of_an_input_the_shortest_is_shown():
    """A valve of 0 and 1; how it turns between two rows was not measured, and no function of it is to say so."""
    times = 0.1 * np.arange(60.0)
    u = (times < 2.05) * 1.0
    filled = 1.0 + np.concatenate([[0.0], np.cumsum(0.2 * u[:-1])])
    whole = table(DRIVEN, ([1.0],), times)
    whole.columns[1:] = np.array([filled, u])
    config = JobConfig(space=SpaceConfig(operators=("+", "*", "/")), data=DataConfig(inputs=("u",)))
    preparation = prepare(whole, config)
    refinement = refine_all(preparation, config, pools(preparation, x=("2.0*u", "2.2*u/(0.1 + u*u)"))).equations["x"]
    (coefficient,) = refinement.constants
    assert to_infix(refinement.program, ("x", "u")).endswith("*u")
    assert coefficient.value == pytest.approx(2.0, rel=0.05)
    assert refinement.grade != "exact"
