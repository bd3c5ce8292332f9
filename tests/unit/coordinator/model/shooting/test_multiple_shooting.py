"""Constants and initial states fitted by shooting."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.smoothing import Signal, fit_robustly
from atoll_coordinator.model.batches import Spread, spreading
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import TrajectoryMisfit
from atoll_coordinator.model.shooting import integration, multiple_shooting
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_coordinator.model.shooting.integration import Integrator
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MisfitLimit, MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.system import system_of, variable_program
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import (
    DECAY,
    DRIVEN,
    LOTKA,
    SWING,
    Known,
    measurements,
    recording,
)

TIMES = 0.1 * np.arange(50.0)
LOTKA_STARTS = ([1.0, 3.0], [4.0, 1.0], [3.0, 3.0])
FAR = ("1.5*x - 1.2*x*y - 0.6*x*x", "1.1*y - 0.4*x*y - 0.45*y*y")


def lotka(**options):
    return measurements(LOTKA, LOTKA_STARTS, TIMES, **options)


def system(known, *texts):
    return system_of([known.parsed(text) for text in texts], known.names, known.names)


def fitted_lotka(rows, precision=1e-8):
    return fit_in_stages(MultipleShooting(rows, precision), system(LOTKA, *FAR), (8, 25, None), 40)


def sizes(fit):
    return sorted(np.abs(fit.system.values).tolist())


def robust(seed, outliers):
    """Return a decay with errors of deviation 0.1, some of them 30 times as large, weighed as smoothing does it."""
    recorded = recording(DECAY, [[2.0]] * 4, 0.05 * np.arange(100.0), noise=0.1, seed=seed)
    for trajectory in recorded.trajectories:
        trajectory.measured[0, 7 :: 100 // outliers if outliers else 100] += 3.0 if outliers else 0.0
    signals = [Signal(trajectory.times, trajectory.measured[0]) for trajectory in recorded.trajectories]
    weights = [signal.robustness_weights for signal in fit_robustly(signals, (3, 4)).signals]
    weighed = zip(recorded.trajectories, weights, strict=True)
    return replace(
        recorded, trajectories=tuple(replace(trajectory, robustness_weights=part[None]) for trajectory, part in weighed)
    )


@pytest.mark.parametrize("outliers", [0, 2])
def test_robustness_weights_do_not_bias_the_variance_of_the_errors(outliers):
    """20 recordings of 400 rows; the standard error of the mean is 0.02, without a factor it is 0.77."""
    right = system(DECAY, "-0.5*x")
    squares = []
    for seed in range(20):
        estimator = MultipleShooting(measurements_of(robust(seed, outliers), [0]), 1e-6)
        squares.append(estimator.fit(right, None, 0).squares[0] / 0.01)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.07)


@pytest.mark.parametrize("precision", [1e-8, 1e-5, 1e-3], ids=["precise", "quick", "rough"])
def test_constants_are_found_from_bad_starts(precision):
    fit = fitted_lotka(lotka(), precision)
    assert sizes(fit) == pytest.approx([1.0, 1.0, 1.0, 2.0, 2.0, 3.0], rel=max(30.0 * precision, 1e-5))
    assert fit.segments.tolist() == [[0, 50], [50, 100], [100, 150]]
    assert fit.starts == pytest.approx(np.array(LOTKA_STARTS), rel=max(30.0 * precision, 1e-5))


def test_noise_costs_accuracy_in_proportion():
    errors = []
    for noise in (1e-4, 1e-2):
        fit = fitted_lotka(lotka(noise=noise))
        errors.append(np.abs(np.array(sizes(fit)) - [1.0, 1.0, 1.0, 2.0, 2.0, 3.0]).max())
        assert np.sqrt(fit.squares) == pytest.approx([noise, noise], rel=0.15)
    assert 30.0 * errors[0] < errors[1] < 0.2


def test_a_measured_input_takes_part():
    rows = measurements(DRIVEN, [[2.0], [-1.0]], TIMES)
    fit = MultipleShooting(rows, 1e-8).fit(system(DRIVEN, "-0.3*x + 0.5*u"), 10, 30)
    assert sizes(fit) == pytest.approx([0.8, 1.5], rel=1e-3)


def test_errors_of_every_state_are_weighted_by_their_own_size():
    """Of two states that share a constant, the one with a thousandth of the noise decides."""
    both = Known(("x", "y"), lambda _, z: [-0.5 * z[0], -0.5 * z[0] - 0.2 * z[1]])
    rows = measurements(both, [[3.0, 1.0], [2.0, -1.0]], TIMES, noise=(0.3, 3e-4), seed=1)
    start = system(both, "-0.8*x", "-0.5*x - 0.2*y")
    equal = np.array([0.1, 0.1])
    fit = MultipleShooting(rows, 1e-6).fit(start, None, 40, errors=ErrorModel.independent(equal))
    assert fit.errors.sigmas == pytest.approx([0.3, 3e-4], rel=0.2)
    assert fit.errors.sigmas == pytest.approx(np.sqrt(fit.squares), rel=2e-3)
    assert sizes(fit) == pytest.approx([0.2, 0.5, 0.5], rel=5e-3)


def test_missing_values_and_outliers_without_weight_do_not_count():
    complete = recording(LOTKA, LOTKA_STARTS, TIMES, noise=1e-3)
    holed = recording(LOTKA, LOTKA_STARTS, TIMES, noise=1e-3)
    holed.trajectories[0].measured[0, 5:15] = np.nan
    fit = fitted_lotka(measurements_of(holed, [0, 1]))
    assert sizes(fit) == pytest.approx(sizes(fitted_lotka(measurements_of(complete, [0, 1]))), rel=0.01)
    assert np.isfinite(fit.squares).all()


def test_the_fit_is_the_one_of_least_squares():
    """At the end the gradient vanishes, and moving any constant or start costs."""
    rows = measurements(DECAY, [[3.0], [2.0]], TIMES, noise=0.05)
    estimator = MultipleShooting(rows, 1e-9)
    fit = estimator.fit(system(DECAY, "-0.3*x"), None, 50)
    for shift in (-1e-3, 1e-3):
        moved = estimator.fit(fit.system.with_values(fit.system.values + shift), None, 0, fit.starts, fit.errors)
        assert moved.squares[0] > fit.squares[0]
        moved = estimator.fit(fit.system, None, 0, fit.starts + np.array([[shift], [0.0]]), fit.errors)
        assert moved.squares[0] > fit.squares[0]


def test_without_steps_a_system_is_simulated_as_it_is():
    fit = MultipleShooting(lotka(), 1e-8).fit(system(LOTKA, "3*x - 2*x*y - x**2", "2*y - x*y - y**2"), None, 0)
    assert np.abs(fit.residuals).max() < 1e-6
    assert fit.residuals == pytest.approx(lotka().measured - fit.simulated)


def test_a_simulation_is_that_of_a_fit_without_steps():
    rows, right = lotka(), system(LOTKA, "3*x - 2*x*y - x**2", "2*y - x*y - y**2")
    one = rows.part([1])
    fit = MultipleShooting(one, 1e-8).fit(right, None, 0)
    simulated = MultipleShooting(one, 1e-8).simulate(right, fit.starts[0])
    assert simulated.tolist() == fit.simulated.tolist()


def test_a_stiff_system_is_simulated_without_sensitivities():
    rows = measurements(DECAY, [[3.0]], TIMES)
    simulated = MultipleShooting(rows, 1e-4).simulate(system(DECAY, "-1e6*x + 1e6"), np.array([3.0]))
    assert simulated[0, 1:] == pytest.approx(np.ones(49), abs=1e-3)
    assert MultipleShooting(rows, 1e-4).simulate(system(DECAY, "x*x*x"), np.array([3.0])) == "ran away"


def test_running_out_of_steps_is_not_running_away():
    """Some 3,000 turns between two rows take more steps than are allowed, and fewer than so many measured rows have."""
    rows, fast = measurements(SWING, [[1.0, 0.0]], TIMES), system(SWING, "6000*y", "-6000*x")
    assert MultipleShooting(rows, 1e-4).simulate(fast, np.array([0.5, 0.0])) == "out of steps"
    longer = MultipleShooting(rows, 1e-4, measured_rows=100_000).simulate(fast, np.array([0.5, 0.0]))
    assert np.abs(longer).max() < 1.0


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_steps_that_are_tried_by_states_alone_are_the_same(monkeypatch, noise):
    estimates = []
    for rejected in (0.0, 1.0):
        monkeypatch.setattr(multiple_shooting, "_REJECTED", rejected)
        estimator = MultipleShooting(lotka(noise=noise), 1e-8)
        fit = fit_in_stages(estimator, system(LOTKA, *FAR), (8, 25, None), 40)
        estimates.append((fit.system.values.tolist(), fit.starts.tolist(), fit.blocks.normal.tolist()))
    assert estimates[0] == estimates[1]


def counted_integrations(estimator, monkeypatch):
    """Return a list to which each later integration of an estimator adds whether it has sensitivities."""
    kinds, integrate = [], estimator.integrator.integrate

    def counted(*arguments, has_sensitivities=True):
        kinds.append(has_sensitivities)
        return integrate(*arguments, has_sensitivities=has_sensitivities)

    monkeypatch.setattr(estimator.integrator, "integrate", counted)
    return kinds


def bits(fit):
    numbers = (fit.system.constants, fit.starts, fit.simulated, fit.residuals, fit.squares, fit.errors.sigmas)
    return [number.tobytes() for number in (*numbers, *fit.blocks)]


@pytest.mark.parametrize("steps", [1, 6, 40])
def test_an_equal_fit_is_restored_by_one_integration_and_counts_the_same_work(monkeypatch, steps):
    estimator = MultipleShooting(lotka(noise=0.02), 1e-8)
    first = estimator.fit(system(LOTKA, *FAR), 25, steps)
    work, kinds = estimator.work, counted_integrations(estimator, monkeypatch)
    again = estimator.fit(system(LOTKA, *FAR), 25, steps)
    assert kinds == [False]
    assert estimator.work == 2 * work
    assert bits(again) == bits(first)


def test_a_fit_that_differs_in_any_argument_is_not_restored(monkeypatch):
    estimator, near = MultipleShooting(lotka(noise=0.02), 1e-8), system(LOTKA, *FAR)
    fit = estimator.fit(near, 25, 6)
    starts, errors = fit.starts + 0.01, replace(fit.errors, sigmas=2.0 * fit.errors.sigmas)
    held = system_of([LOTKA.parsed(text) for text in FAR], LOTKA.names, LOTKA.names, [[0], []])
    kinds = counted_integrations(estimator, monkeypatch)
    one, far = np.ones(2), np.full(2, 0.1)
    misfit = TrajectoryMisfit(far, one, far, 50.0 * one, 10.0 * one, 10.0 * one, 150.0 * one)
    limit = MisfitLimit(1e9, misfit, None)
    for other in (
        lambda: estimator.fit(near, 25, 6, limit=limit),
        lambda: estimator.fit(near, 25, 6, limit=replace(limit, nats=2e9)),
        lambda: estimator.fit(near, 25, 6, limit=replace(limit, misfit=replace(misfit, high=2.0 * one))),
        lambda: estimator.fit(near, 8, 6),
        lambda: estimator.fit(near, 25, 7),
        lambda: estimator.fit(near, 25, 6, starts),
        lambda: estimator.fit(near, 25, 6, fit.starts, errors),
        lambda: estimator.fit(near.with_values(1.01 * near.values), 25, 6),
        lambda: estimator.fit(held, 25, 6),
    ):
        kinds.clear()
        other()
        assert kinds[0]


def test_a_fit_that_the_deadline_ended_is_not_restored():
    now = 2.0
    deadline = Deadline(1.0, lambda: now)
    now = 5.0
    estimator, near = MultipleShooting(lotka(noise=0.02), 1e-8, deadline), system(LOTKA, *FAR)
    cut = estimator.fit(near, 25, 40)
    now = 2.0
    whole = estimator.fit(near, 25, 40)
    assert whole.squares.sum() < 0.5 * cut.squares.sum()


def test_the_last_point_of_a_fit_has_the_normal_equations_of_its_sensitivities(monkeypatch):
    estimator, near = MultipleShooting(lotka(noise=0.02), 1e-8), system(LOTKA, *FAR)
    kinds = counted_integrations(estimator, monkeypatch)
    fit = estimator.fit(near, 25, 1)
    assert kinds == [True, False]
    blocks = estimator.blocks(fit.segments, fit.integrated_sensitivities(), fit.residuals, fit.errors, fit.system.count)
    assert [one.tobytes() for one in fit.blocks] == [one.tobytes() for one in blocks]


def test_constants_that_are_held_stay_and_initial_states_are_fitted():
    rows = lotka(noise=0.01)
    programs = [LOTKA.parsed("3*x - 2*x*y - x**2"), LOTKA.parsed("2*y - x*y - y**2")]
    held = system_of(programs, LOTKA.names, LOTKA.names, [range(20), range(20)])
    off = np.array(LOTKA_STARTS) + 0.2
    fit = MultipleShooting(rows, 1e-8).fit(held, None, 30, off)
    assert fit.system.values.size == 0
    assert fit.starts == pytest.approx(np.array(LOTKA_STARTS), abs=0.03)
    assert fit.reduced.shape == (0, 0)


@pytest.mark.parametrize("text", ["x*x*x", "log(x - 100.0)", "1e6*x - 1e6", "1/(x - x)"])
def test_what_cannot_be_integrated_is_none(text):
    """It blows up, or has no value."""
    rows = measurements(DECAY, [[3.0], [2.0]], TIMES)
    assert MultipleShooting(rows, 1e-6).fit(system(DECAY, text), None, 10) is None
    assert fit_in_stages(MultipleShooting(rows, 1e-6), system(DECAY, text), (8, None), 10) is None


def test_a_stiff_system_is_simulated():
    """Within a microsecond the state is what the equation says."""
    rows = measurements(DECAY, [[3.0], [2.0]], TIMES)
    fit = MultipleShooting(rows, 1e-4).fit(system(DECAY, "-1e6*x + 1e6"), None, 0, is_stiff=True)
    assert fit is not None
    assert fit.is_stiff
    assert fit.simulated[0, 1:50] == pytest.approx(np.ones(49), abs=1e-3)


@pytest.mark.parametrize(
    ("steps", "is_fitted"), [(SETTINGS.effort.brief_steps, False), (SETTINGS.effort.brief_steps + 1, True)]
)
def test_what_seems_stiff_gets_implicit_steps_in_a_long_fit_alone(steps, is_fitted):
    """Most candidates that seem so are bad ones."""
    rows = measurements(DECAY, [[3.0], [2.0]], TIMES)
    fit = MultipleShooting(rows, 1e-4).fit(system(DECAY, "-1e6*x + 1e6"), None, steps)
    assert (fit is not None) is is_fitted


def test_short_segments_hold_where_whole_trajectories_blow_up():
    """x' = 0.2 x^2 from 3 has a pole at 1.7, segments of five rows do not reach it."""
    rows = measurements(DECAY, [[3.0], [2.0]], TIMES)
    start = system(DECAY, "0.2*x*x - 0.1*x")
    assert MultipleShooting(rows, 1e-6).fit(start, None, 10) is None
    fit = fit_in_stages(MultipleShooting(rows, 1e-6), start, (5, None), 30)
    assert fit is not None
    assert np.sqrt(fit.squares[0]) < 0.02


def test_the_block_inverse_gives_the_covariance_of_the_dense_fit():
    rows = lotka(noise=0.01)
    fit = fitted_lotka(rows)
    fitted = len(fit.system.places)
    columns = []
    for group, (first, end) in enumerate(fit.segments.tolist()):
        part = np.zeros((2 * (end - first), fitted + 6))
        gradients = fit.integrated_sensitivities()[first:end] / fit.errors.sigmas[None, :, None]
        part[:, :fitted] = gradients[:, :, :fitted].reshape(-1, fitted)
        part[:, fitted + 2 * group : fitted + 2 * group + 2] = gradients[:, :, fitted:].reshape(-1, 2)
        columns.append(part)
    jacobian = np.concatenate(columns)
    expected = np.linalg.inv(jacobian.T @ jacobian)[:fitted, :fitted]
    assert np.linalg.inv(fit.reduced) == pytest.approx(expected, rel=1e-6)


def test_two_fits_are_the_same_to_the_bit():
    rows = lotka(noise=0.05)
    first, second = fitted_lotka(rows), fitted_lotka(rows)
    assert first.system.values.tobytes() == second.system.values.tobytes()
    assert first.simulated.tobytes() == second.simulated.tobytes()
    assert first.integrated_sensitivities().tobytes() == second.integrated_sensitivities().tobytes()


@pytest.mark.parametrize(("constants", "sides"), [(2, ("3*x", "2*y")), (6, FAR)])
def test_work_counts_evaluations_of_the_rates_and_integrated_numbers(constants, sides, monkeypatch):
    taken, original = [], Integrator.integrate

    def integrate(self, *arguments, **options):
        course = original(self, *arguments, **options)
        taken.append(course.steps)
        return course

    monkeypatch.setattr(Integrator, "integrate", integrate)
    estimator = MultipleShooting(lotka(), 1e-6)
    estimator.fit(system(LOTKA, *sides), 10, 0)
    (steps,) = taken
    assert estimator.work == max(150, steps) * 6 * (20 + 2 * (1 + constants + 2))


def test_a_finer_integration_is_more_work():
    """Equal rows, more steps: a limit of work is a limit of time."""
    works = []
    for tolerance in (1e-6, 1e-11):  # both by the precise method
        estimator = MultipleShooting(lotka(), tolerance)
        estimator.fit(system(LOTKA, *FAR), 10, 0)
        works.append(estimator.work)
    assert works[1] > 1.5 * works[0]


@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.01, 0.1)])
def test_a_fit_begun_at_its_end_integrates_once_or_twice(noise):
    """A step that promises nothing is not tried, however many could be."""
    rows = lotka(noise=noise)
    fit = fitted_lotka(rows)
    again = MultipleShooting(rows, 1e-8)
    again.fit(fit.system, None, 0, fit.starts, fit.errors)
    once = again.work
    again.fit(fit.system, None, 40, fit.starts, fit.errors)
    assert again.work - once <= 2 * once


def test_correlated_errors_are_found_and_widen_what_they_should():
    """AR(1) errors: the share, the correlation and honest standard errors of a constant, 60 times."""
    times, draw, scores, estimates = np.linspace(0.0, 12.0, 200), np.random.default_rng(3), [], []
    exact = measurements(DECAY, [[2.0]], times, noise=0.0)
    for _ in range(60):
        errors = 0.05 * draw.standard_normal(200)
        for row in range(1, 200):
            errors[row] = 0.8 * errors[row - 1] + 0.6 * errors[row]
        disturbed = replace(exact, measured=exact.measured + errors, noise=np.array([0.05]))
        estimator = MultipleShooting(disturbed, 1e-8)
        first = estimator.fit(system(DECAY, "-0.5*x"), None, 20)
        found = estimator.sensor_errors(first, np.array([40.0]))
        fit = estimator.fit(first.system, None, 20, first.starts, found)
        scores.append((fit.system.values[0] + 0.5) / np.sqrt(covariance(fit)[0, 0]))
        estimates.append((fit.errors.shares[0], fit.errors.decays[0]))
    shares, decays = np.median(estimates, axis=0)
    assert shares >= 0.9
    assert decays == pytest.approx(0.8, abs=0.1)
    assert 0.8 < np.std(scores) < 1.3


def test_an_unmeasured_velocity_is_fitted_from_positions():
    """Order 2: x'' = -2 x - 0.3 x', only x measured."""
    whole = recording(SWING, [[1.0, 2.0], [0.5, -1.0]], TIMES, noise=1e-3)
    parts = tuple(
        replace(
            trajectory, measured=trajectory.measured[:1], smoothed=trajectory.smoothed[:1], slopes=trajectory.slopes[:1]
        )
        for trajectory in whole.trajectories
    )
    second = replace(
        whole, states=("x",), state_symbols=("x",), velocity_symbols=("y",), order=2, smoothing=whole.smoothing[:1],
        trajectories=parts,
    )  # fmt: skip
    rows = measurements_of(second, [0])
    made = system_of([variable_program(1), SWING.parsed("-1.2*x - 0.1*y")], SWING.names, rows.variables)
    fit = fit_in_stages(MultipleShooting(rows, 1e-6), made, (10, None), 30)
    assert sizes(fit) == pytest.approx([0.3, 2.0], rel=0.01)
    assert fit.starts == pytest.approx(np.array([[1.0, 2.0], [0.5, -1.0]]), abs=0.01)


@pytest.mark.parametrize(("x_unit", "y_unit"), [(1e-30, 1e30), (1e30, 1e-30), (1e-40, 1e-40)])
def test_states_of_any_units_have_the_same_fit(x_unit, y_unit):
    """A constant of 1e-60 has a sensitivity of 1e90, and nothing is steep about that."""
    recorded = recording(SWING, ([1.0, 2.0],), TIMES)
    units = np.array([[x_unit], [y_unit]])
    (one,) = recorded.trajectories
    moved = replace(one, measured=units * one.measured, smoothed=units * one.smoothed, slopes=units * one.slopes)
    smoothing = tuple(
        replace(trajectory, noise=trajectory.noise * unit)
        for trajectory, unit in zip(recorded.smoothing, units[:, 0], strict=True)
    )
    there = measurements_of(replace(recorded, trajectories=(moved,), smoothing=smoothing), range(2))
    texts = (f"{0.9 * x_unit / y_unit!r}*y", f"{-2.2 * y_unit / x_unit!r}*x - 0.3*y")
    fit = MultipleShooting(there, 1e-8).fit(system(SWING, *texts), None, 20)
    values = fit.system.values * np.array([y_unit / x_unit, x_unit / y_unit, 1.0])
    assert np.abs(values) == pytest.approx([1.0, 2.0, 0.3], rel=1e-6)


class ClosedForm(Known):
    """The system of `TURN`, whose solutions are known but for their rounding."""

    def values(self, start, times):
        grown = np.exp(-0.01 * times)
        x = start[0] * grown * np.cos(times)
        return np.array([x, -0.01 * x - start[0] * grown * np.sin(times)])


TURN = ClosedForm(("x", "y"), lambda _, z: [z[1], -1.0001 * z[0] - 0.02 * z[1]])


@pytest.mark.parametrize("rows", [200, 500, 1000, 2000])
def test_nothing_is_fitted_to_the_rounding_of_a_solution_in_closed_form(rows):
    """Each stage integrates where it begins, takes a step, and perhaps some more; some twenty would follow rounding."""
    measured = measurements(TURN, [[1.0, -0.01]], 0.02 * np.arange(rows))
    estimator = MultipleShooting(measured, 1e-12)
    fit = fit_in_stages(estimator, system(TURN, "y", "-1.0001*x - 0.02*y"), (30, 150, None), 40)
    assert sizes(fit) == pytest.approx([0.02, 1.0001], rel=1e-9)
    once = MultipleShooting(measured, 1e-12)
    once.fit(fit.system, None, 0, fit.starts, fit.errors)
    assert estimator.work <= 3 * 4 * once.work


LORENZ = Known(("x", "y", "z"), lambda _, s: (10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 2.5 * s[2]))


@pytest.mark.parametrize("seed", [1, 3])
def test_pieces_of_noisy_chaos_are_fitted_to_the_noise_from_short_segments(seed):
    """A trajectory of 1,200 rows, 20 to a Lyapunov time, with errors of an eighth of a deviation.

    Where it passes the saddle, errors of an initial state grow a thousandfold along a piece of 60 rows.
    """
    recorded = recording(LORENZ, [[3.0, 5.0, 25.0]], 0.05 * np.arange(1200.0), noise=1.0, seed=seed)
    rows = measurements_of(recorded, [0, 1, 2], piece=60)
    law = system(LORENZ, "9*(y - x)", "26*x - x*z - y", "x*y - 2.4*z")
    fit = fit_in_stages(MultipleShooting(rows, 1e-3), law, (10, 30, None), 40)
    worst = max(float(np.mean(fit.residuals[:, first:end] ** 2)) for first, end in fit.segments)
    assert worst < 1.5
    assert sizes(fit) == pytest.approx([2.5, 10.0, 28.0], rel=0.03)


def test_segments_of_groups_are_joined_with_the_constants_of_each():
    """Constants of each group, fitted to segments of a few rows, leave gaps that a step of all constants closes."""
    rows = measurements(DECAY, [[2.0], [3.0]], 0.1 * np.arange(24.0), noise=0.05)
    rows = replace(rows, groups=np.array([0, 1], np.int64))
    one = system(DECAY, "-0.4*x")
    grouped = one.sharing_numbers(np.tile(one.constants, (2, 1)), ())
    estimator = MultipleShooting(rows, 1e-8)
    fit = estimator.fit(grouped, 4, 20)
    joined = estimator.join(fit, 4, None)
    assert joined is not None
    its_system, starts = joined
    whole = estimator.fit(its_system, None, 0, starts)
    short = estimator.fit(its_system, 4, 0, np.ascontiguousarray(whole.simulated[:, fit.segments[:, 0]].T))
    assert short.simulated == pytest.approx(whole.simulated, abs=1e-6)
    best = estimator.fit(its_system, None, 20, starts)
    assert estimator.cost(whole) < 1.02 * estimator.cost(replace(best, errors=whole.errors))


GROWTH = Known(("x",), lambda _, z: [0.8 * z[0] - 0.1 * z[0] ** 2])
BELOW = {0: -0.35, 1: -0.05}
"""Values of the first rows as noise may leave them; the law runs away from there."""


@pytest.mark.parametrize("length", [5, None])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("is_given", [False, True])
def test_a_fit_that_blows_up_from_noise_below_zero_begins_where_the_state_has_its_lasting_sign(length, sign, is_given):
    data = measurements(GROWTH, ([0.2],), np.arange(0.0, 13.0), noise=0.1)
    smoothed, measured = data.smoothed.copy(), data.measured.copy()
    for row, value in BELOW.items():
        smoothed[0, row] = measured[0, row] = value
    data = replace(data, smoothed=sign * smoothed, measured=sign * measured)
    estimator = MultipleShooting(data, 1e-6)
    starts = np.ascontiguousarray(data.smoothed[:, data.segments(length)[:, 0]].T) if is_given else None
    law = from_infix("0.5*x - 0.05*x*x" if sign > 0.0 else "0.5*x + 0.05*x*x", GROWTH.names)
    fit = estimator.fit(system_of([law], ("x",), ("x",)), length, 40, starts)
    assert fit is not None
    assert sign * fit.starts[0, 0] > 0.0
    assert fit.system.values == pytest.approx([0.8, 0.1], rel=0.5)


def test_a_state_that_may_be_of_either_sign_begins_where_it_was_measured():
    data = measurements(SWING, ([-0.3, 1.0],), np.linspace(0.0, 6.0, 40), noise=0.01)
    fit = MultipleShooting(data, 1e-6).fit(
        system_of([SWING.parsed(text) for text in ("y", "-2.0*x - 0.3*y")], SWING.names, SWING.states), None, 40
    )
    assert fit.starts[0] == pytest.approx([-0.3, 1.0], abs=0.05)


def test_sensitivities_are_those_of_finite_differences():
    estimator = MultipleShooting(measurements(DECAY, [[3.0], [2.0]], TIMES, noise=0.05), 1e-9)
    fit = estimator.fit(system(DECAY, "-0.4*x"), None, 10)
    little = 1e-5

    def moved(by: float) -> np.ndarray:
        near = fit.system.with_values(fit.system.values + by)
        return estimator.fit(near, None, 0, fit.starts, fit.errors).simulated[0]

    expected = (moved(little) - moved(-little)) / (2.0 * little)
    assert np.abs(fit.integrated_sensitivities()[:, 0, 0] - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_integrate_parts_of_a_fit_equal_to_the_bit(threads, monkeypatch):
    monkeypatch.setattr(integration, "_NUMBERS_OF_A_PART", 1)
    rows = lotka(noise=0.02)
    alone = MultipleShooting(rows, 1e-6)
    expected = fit_in_stages(alone, system(LOTKA, *FAR), (8, 25, None), 40)
    with spreading(None, threads, Deadline()) as spread:
        shared = MultipleShooting(rows, 1e-6, spread=spread)
        fit = fit_in_stages(shared, system(LOTKA, *FAR), (8, 25, None), 40)
    assert shared.work == alone.work
    for name in ("starts", "simulated", "residuals", "squares"):
        assert np.array_equal(getattr(fit, name), getattr(expected, name))
    assert all(np.array_equal(*pair) for pair in zip(fit.blocks, expected.blocks, strict=True))


class RecordedDivisions(Spread):
    """Computes parts in this thread as for some threads, and counts the divisions."""

    def __init__(self, threads):
        super().__init__(threads=threads)
        self.parts = []

    def divide(self, function, parts):
        self.parts.append(len(parts))
        return super().divide(function, parts)


@pytest.mark.parametrize(
    ("text", "starts"),
    [("0.1*x", [1.0, 2.0, 3.0]), ("x*x", [0.01, 3.0, 0.01, 5.0]), ("-1e5*x + 1e5", [3.0, 3.0, 1.0])],
    ids=["integrated", "blows up in the second segment", "out of steps"],
)
@pytest.mark.parametrize("has_sensitivities", [True, False])
def test_a_divided_integration_ends_as_an_undivided_one(text, starts, has_sensitivities, monkeypatch):
    monkeypatch.setattr(integration, "_NUMBERS_OF_A_PART", 1)
    rows = measurements(DECAY, [[start] for start in starts], TIMES)
    spread, begin = RecordedDivisions(2), np.array(starts)[:, None]
    courses = [
        one.integrate(one.methods[0], system(DECAY, text), rows.bounds, begin, has_sensitivities=has_sensitivities)
        for one in (integration.Integrator(rows, 1e-4), integration.Integrator(rows, 1e-4, spread=spread))
    ]
    assert max(spread.parts) > 1
    expected, found = courses
    assert (found.done, found.steps) == (expected.done, expected.steps)
    assert np.array_equal(found.states, expected.states, equal_nan=True)
    assert np.array_equal(found.sensitivities, expected.sensitivities)


def test_a_short_integration_is_not_divided():
    rows, spread = lotka(), RecordedDivisions(8)
    MultipleShooting(rows, 1e-4, spread=spread).fit(system(LOTKA, *FAR), None, 3)
    assert spread.parts == []
