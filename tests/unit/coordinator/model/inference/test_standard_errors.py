"""Errors of constants and of simulations, by simulation."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.constants import standard_errors
from atoll_coordinator.model.inference.final_model import estimate_errors
from atoll_coordinator.model.inference.residual_covariance import estimate_variance_inflation
from atoll_coordinator.model.inference.trajectory_simulation import (
    compute_r2,
    fit_initial_states,
    simulated_standard_errors,
)
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_core.expression.program import constant_places
from atoll_core.expression.unit_coefficients import as_written
from tests.unit.coordinator.model.shooting.made import DECAY, LOTKA, LOTKA_TEXT, Known, compare, recording

TIMES = 0.2 * np.arange(20.0)
DRAWS = 200
NOISE = 0.1
STARTS = ([2.0], [1.0], [-1.5])
TRUTH = DECAY.parsed("-0.5*x")


def describe_constants(comparison, shown, errors):
    """Return the written constants of each program, errors being those of the programs as they are written."""
    return [
        constant.written
        for constant in standard_errors.describe_constants(
            comparison.fixed, tuple(map(as_written, shown)), shown, errors
        )
    ]


def find_correlations(comparison, variables, shown, errors):
    places = standard_errors.list_fitted_places(comparison.fixed, variables, tuple(map(as_written, shown)))
    return standard_errors.find_correlations(places, errors)


def banded(comparison, rows, model):
    errors = estimate_errors(comparison, model)
    return simulated_standard_errors(rows, model.fit, errors.finite_covariance, errors.scale)


def drawn(seed, noise=NOISE):
    """Return comparison and model of x' = -a x, fitted to fresh noise."""
    comparison = compare(DECAY, measurements_of(recording(DECAY, STARTS, TIMES, noise, seed), [0]), 1e-5)
    model = comparison.fit_model([TRUTH], lengths=(None,))
    assert model is not None
    return comparison, model


@pytest.fixture(scope="module")
def draws():
    with np.errstate(under="ignore"):
        return [drawn(seed) for seed in range(DRAWS)]


def rate_of(model):
    return abs(float(model.fit.system.values[0]))


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(draws):
    """95 % of 200 is 190, with a standard deviation of 3. A correlation that 60 rows do not exclude widens them."""
    covered, errors = 0, []
    for comparison, model in draws:
        ((constant,),) = describe_constants(comparison, model.programs, estimate_errors(comparison, model))
        low, high = constant.interval
        covered += low <= -0.5 <= high or low <= 0.5 <= high
        errors.append(constant.std_error)
    assert 181 <= covered <= 199
    assert 0.9 <= np.mean(errors) / np.std([rate_of(model) for _, model in draws]) <= 1.3


def test_intervals_are_those_of_students_t():
    from scipy import stats

    comparison, model = drawn(0)
    ((constant,),) = describe_constants(comparison, model.programs, estimate_errors(comparison, model))
    assert estimate_errors(comparison, model).degrees_of_freedom == 60 - 1 - 3
    reach = stats.t.ppf(0.975, 56)
    assert constant.interval == pytest.approx(
        (constant.fitted - reach * constant.std_error, constant.fitted + reach * constant.std_error)
    )


def test_bands_are_the_spread_of_the_simulations(draws):
    spread = np.std([model.fit.simulated[0] for _, model in draws], axis=0)
    errors = [banded(comparison, comparison.estimator.measurements, model)[0] for comparison, model in draws]
    mean_errors = np.mean(errors, axis=0)
    assert np.all((mean_errors >= 0.9 * spread) & (mean_errors <= 1.4 * spread))
    scales = [estimate_errors(comparison, model).scale * 56.0 / 60.0 for comparison, model in draws]
    assert mean_errors.mean() / np.mean(np.sqrt(scales)) == pytest.approx(spread.mean(), rel=0.05)


def test_bands_of_a_coupled_system_are_those_of_its_linearisation():
    """Directly: variances of the rows by the dense covariance of all that was fitted."""
    rows = measurements_of(recording(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, 0.01), [0, 1])
    comparison = compare(LOTKA, rows, 1e-8)
    model = comparison.fit_model([LOTKA.parsed("2.9*x - 2.1*x*y - 0.9*x*x"), LOTKA.parsed("1.9*y - 0.9*x*y - 1.1*y*y")])
    fit, fitted = model.fit, len(model.fit.system.places)
    whole = np.zeros((len(TIMES) * 2, 2, fitted + 4))
    sensitivities = fit.integrated_sensitivities()
    for group, (first, end) in enumerate(fit.segments.tolist()):
        whole[first:end, :, :fitted] = sensitivities[first:end, :, :fitted]
        whole[first:end, :, fitted + 2 * group : fitted + 2 * group + 2] = sensitivities[first:end, :, fitted:]
    weighed = (whole / fit.errors.sigmas[None, :, None]).reshape(-1, fitted + 4)
    errors = estimate_errors(comparison, model)
    covariance = np.linalg.inv(weighed.T @ weighed) * errors.scale
    assert errors.scale >= 80.0 / errors.degrees_of_freedom
    expected = np.sqrt(np.einsum("nop,pq,noq->on", whole, covariance, whole))
    assert banded(comparison, rows, model) == pytest.approx(expected, rel=1e-4)


def test_bands_integrate_once_however_many_pieces_there_are(monkeypatch):
    rows = measurements_of(recording(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, 0.01), [0, 1])
    comparison = compare(LOTKA, rows, 1e-8)
    model = comparison.fit_model([LOTKA.parsed("2.9*x - 2.1*x*y - 0.9*x*x"), LOTKA.parsed("1.9*y - 0.9*x*y - 1.1*y*y")])
    integrate, times = MultipleShooting.sensitivities, []
    monkeypatch.setattr(MultipleShooting, "sensitivities", lambda self, fit: times.append(1) or integrate(self, fit))
    errors = estimate_errors(comparison, model)
    times.clear()
    simulated_standard_errors(rows, model.fit, errors.finite_covariance, errors.scale)
    assert len(times) == 1


def test_bands_of_a_system_without_constants_are_those_of_its_initial_states():
    """x' = -x along one trajectory: the error of the start decays."""
    bare = Known(("x",), lambda _, z: [-z[0]])
    rows = measurements_of(recording(bare, ([2.0],), TIMES, NOISE), [0])
    comparison = compare(bare, rows, 1e-8)
    model = comparison.fit_model([bare.parsed("-x")], lengths=(None,))
    decay = np.exp(-TIMES)
    error = model.fit.errors.sigmas[0] * np.sqrt(20.0 / 19.0) / np.sqrt(decay @ decay)
    assert banded(comparison, rows, model)[0] == pytest.approx(error * decay, rel=1e-4)
    assert describe_constants(comparison, model.programs, estimate_errors(comparison, model)) == [()]


def test_a_constant_that_the_data_do_not_determine_is_said_to_be_none():
    """x stays near 1, so that x and x^2 say nearly the same: neither is known, and they are correlated."""
    still = Known(("x",), lambda _, z: [0.5 - 0.5 * z[0]])
    rows = measurements_of(recording(still, ([1.05], [0.95], [1.02]), TIMES, 0.02), [0])
    comparison = compare(still, rows, 1e-6)
    model = comparison.fit_model([still.parsed("0.5 - 0.3*x - 0.2*x*x")])
    errors = estimate_errors(comparison, model)
    (constants,) = describe_constants(comparison, model.programs, errors)
    assert not any(constant.identifiable for constant in constants)
    correlated = find_correlations(comparison, ("x",), model.programs, errors)
    assert len(correlated) >= 1
    assert all(0.95 <= abs(described.value) <= 1.0 + 1e-6 for described in correlated)
    assert [abs(described.value) for described in correlated] == sorted(
        (abs(described.value) for described in correlated), reverse=True
    )
    assert {described.first.variable for described in correlated} == {"x"}


def test_well_determined_constants_are_not_correlated():
    comparison, model = drawn(0)
    errors = estimate_errors(comparison, model)
    assert describe_constants(comparison, model.programs, errors)[0][0].identifiable
    assert find_correlations(comparison, ("x",), model.programs, errors) == ()


def test_constants_of_a_fixed_equation_have_a_value_alone():
    rows = measurements_of(recording(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, 0.01), [0, 1])
    comparison = compare(LOTKA, rows, 1e-8, fixed=[0])
    programs = [LOTKA.parsed(LOTKA_TEXT[0]), LOTKA.parsed("1.9*y - 0.9*x*y - 1.1*y*y")]
    model = comparison.fit_model(programs)
    first, second = describe_constants(comparison, model.programs, estimate_errors(comparison, model))
    assert [described.value for described in first] == programs[0].constants[constant_places(programs[0])].tolist()
    assert all(
        described.fitted is None and described.std_error is None and described.interval is None for described in first
    )
    assert all(described.std_error > 0.0 for described in second)
    correlated = find_correlations(comparison, ("x", "y"), model.programs, estimate_errors(comparison, model))
    assert {name for described in correlated for name in (described.first.variable, described.second.variable)} <= {"y"}


def test_shown_values_stand_beside_fitted_ones():
    comparison, model = drawn(0)
    ((constant,),) = describe_constants(comparison, [TRUTH], estimate_errors(comparison, model))
    assert abs(constant.value) == 0.5
    assert constant.fitted == float(model.fit.system.values[0])


def test_held_constants_stay_and_starts_are_fitted():
    comparison, model = drawn(3)
    fit = fit_initial_states(comparison, [TRUTH])
    assert fit.system.values.size == 0
    assert fit.squares[0] >= model.fit.squares[0]
    assert fit.starts[:, 0] == pytest.approx([2.0, 1.0, -1.5], abs=4.0 * NOISE)
    near = fit_initial_states(comparison, [TRUTH], model.fit)
    assert near.squares[0] == pytest.approx(fit.squares[0], rel=1e-5)


def test_r2_is_the_share_that_is_explained_of_what_was_measured():
    whole = recording(DECAY, STARTS, TIMES, NOISE)
    whole.trajectories[0].measured[0, 3] = np.nan
    rows = measurements_of(whole, [0])
    fit = compare(DECAY, rows, 1e-6).fit_model([TRUTH]).fit
    kept = np.delete(np.arange(60), 3)
    values, left = rows.measured[0, kept], (rows.measured - fit.simulated)[0, kept]
    expected = 1.0 - float(left @ left) / float(((values - values.mean()) ** 2).sum())
    assert compute_r2(rows, fit, slice(None)) == [pytest.approx(expected)]
    assert compute_r2(rows, fit, np.array([3])) == [None]


def test_constants_are_fitted_by_weight_and_their_errors_say_so():
    """Every other row has ten times the error of its neighbours."""
    deviations = np.where(np.arange(len(TIMES)) % 2 == 0, 0.01, 0.1)
    weights = deviations**-2 / np.mean(deviations**-2)
    rates, told = [], []
    for seed in range(60):
        recorded = recording(DECAY, ([1.0],), TIMES, 1e-9)
        (bare,) = recorded.trajectories
        noise = deviations * np.random.default_rng(seed).standard_normal((1, len(TIMES)))
        weighed = replace(recorded, trajectories=(replace(bare, measured=bare.smoothed + noise, weights=weights),))
        compared = compare(DECAY, measurements_of(weighed, [0]), 1e-6)
        model = compared.fit_model([DECAY.parsed("-0.45*x")], lengths=(None,))
        errors = estimate_errors(compared, model)
        rates.append(rate_of(model))
        told.append(np.sqrt(errors.covariance[0, 0]))
    assert np.std(rates) == pytest.approx(np.mean(told), rel=0.3)
    alike = compare(
        DECAY,
        measurements_of(replace(weighed, trajectories=(replace(weighed.trajectories[0], weights=None),)), [0]),
        1e-6,
    )
    plain = alike.fit_model([DECAY.parsed("-0.45*x")], lengths=(None,))
    assert np.mean(told) < 0.5 * np.sqrt(estimate_errors(alike, plain).covariance[0, 0])


def test_what_goes_together_in_a_state_without_noise_widens_no_interval():
    """The second state leaves a small slow wave; beside it the first, which is noisy, is as sure as alone."""
    noisy = np.array([True, False])
    rows = measurements_of(recording(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, 0.01), [0, 1])
    comparison = compare(LOTKA, rows, 1e-8)
    model = comparison.fit_model([LOTKA.parsed("2.9*x - 2.1*x*y - 0.9*x*x"), LOTKA.parsed("1.9*y - 0.9*x*y - 1.1*y*y")])
    wave = np.stack([model.fit.residuals[0], 1e-4 * np.sin(np.arange(rows.rows) / 4.0)])
    fit = replace(model.fit, residuals=wave)
    assert estimate_variance_inflation(rows, fit, noisy) < 0.7 * estimate_variance_inflation(
        rows, fit, np.array([True, True])
    )
