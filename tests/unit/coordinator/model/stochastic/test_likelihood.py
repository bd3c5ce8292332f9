import numpy as np

from atoll_coordinator.model.stochastic.likelihood import ProcessLikelihood, ProcessModel
from atoll_coordinator.process_steps.moments import predict_step_moments
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.stochastic.processes import model_of, ornstein_uhlenbeck, steps_of

NAMES = ("x", "y")


def test_the_misfit_is_minus_the_logarithm_of_the_transition_densities() -> None:
    from scipy import stats

    states = ornstein_uhlenbeck(200, 0.02, seed=1)
    whitened = ProcessLikelihood(steps_of(states[None], 0.02)).whiten(model_of("-1*x", "0.25"))
    decay, spread = np.exp(-0.02), 0.5 * np.sqrt((1.0 - np.exp(-0.04)) / 2.0)
    exact = -stats.norm.logpdf(states[1:], decay * states[:-1], spread).sum() - 199 * 0.5 * np.log(2.0 * np.pi)
    assert abs(whitened.misfit - exact) < 1e-3


def test_with_errors_of_measurement_it_is_that_of_all_rows_together() -> None:
    from scipy import stats

    states = ornstein_uhlenbeck(40, 0.1, seed=2, noise=0.2)
    model = model_of("-1*x", "0.25", noise=0.04)
    steps = steps_of(states[None], 0.1)
    moments = predict_step_moments(model.drift, {(0, 0): model.diffusion[0]}, steps.points, steps.lengths)
    decay, variance = float(moments.jacobian[0, 0, 0]), float(moments.covariance[0, 0, 0])
    move = np.eye(39, 40, 1) - decay * np.eye(39, 40)
    covariance = variance * np.eye(39) + 0.04 * move @ move.T
    exact = -stats.multivariate_normal(np.zeros(39), covariance).logpdf(move @ states) - 39 * 0.5 * np.log(2.0 * np.pi)
    whitened = ProcessLikelihood(steps).whiten(model)
    assert abs(whitened.misfit - exact) < 0.05, "the mean of a step and its Jacobian differ in the third order"


def test_constants_and_both_noises_lie_in_their_intervals() -> None:
    states = ornstein_uhlenbeck(8000, 0.1, seed=3, noise=0.1)
    likelihood, model = ProcessLikelihood(steps_of(states[None], 0.1)), model_of("-0.3*x", "0.7", noise=0.1)
    for _ in range(3):
        fitted = likelihood.fit(model, (0, 1))
        likelihood, model = ProcessLikelihood(likelihood.steps, likelihood.smooth_states(fitted.model)), fitted.model
    truth = np.array([-1.0, 0.25, np.log(0.1)])
    away = (model.parameters((0, 1)) - truth) / likelihood.estimate_errors(fitted, (0, 1)).standard_errors
    assert (np.abs(away) < 3.0).all()


def test_smoothed_states_are_nearer_to_the_truth() -> None:
    clean = ornstein_uhlenbeck(2000, 0.02, seed=4)
    noisy = clean + 0.2 * np.random.default_rng(5).standard_normal(2000)
    smoothed = ProcessLikelihood(steps_of(noisy[None], 0.02)).smooth_states(model_of("-1*x", "0.25", noise=0.04))
    assert np.std(smoothed[0] - clean[:-1]) < 0.65 * np.std(noisy - clean)


def test_the_information_is_that_of_the_scatter_of_estimates() -> None:
    estimates, errors = [], []
    for seed in range(30):
        likelihood = ProcessLikelihood(steps_of(ornstein_uhlenbeck(1000, 0.1, seed)[None], 0.1))
        fitted = likelihood.fit(model_of("-0.7*x", "0.4"), (0, 1))
        estimates.append(fitted.model.parameters((0, 1)))
        errors.append(likelihood.estimate_errors(fitted, (0, 1)).standard_errors)
    ratio = np.std(estimates, axis=0) / np.mean(errors, axis=0)
    assert ((ratio > 0.65) & (ratio < 1.4)).all(), "30 estimates tell their deviation to 13 %"


def test_a_diffusion_that_is_not_positive_is_no_model() -> None:
    likelihood = ProcessLikelihood(steps_of(ornstein_uhlenbeck(100, 0.1, seed=1)[None], 0.1))
    model: ProcessModel = model_of("-1*x", "0.25*x")
    assert likelihood.whiten(model).misfit == np.inf
    assert likelihood.fit(model, (0, 1)).misfit == np.inf


def test_without_errors_of_measurement_steps_begin_where_they_were_measured_whatever_was_smoothed() -> None:
    steps = steps_of(ornstein_uhlenbeck(200, 0.1, seed=1)[None], 0.1)
    smoothed = ProcessLikelihood(steps).smooth_states(model_of("-1*x", "0.25", noise=0.04))
    model = model_of("-1*x", "0.25")
    assert ProcessLikelihood(steps, smoothed).whiten(model).misfit == ProcessLikelihood(steps).whiten(model).misfit


def test_a_constant_beside_which_the_likelihood_is_not_finite_is_not_determined() -> None:
    """A variance that is all but zero at the farthest state is negative there once its constant is a little less."""
    states = ornstein_uhlenbeck(200, 0.1, seed=1)
    edge = float(np.max(states[:-1] ** 2)) * (1.0 + 1e-7)
    model = model_of("-1*x", f"{edge!r} - x*x")
    likelihood = ProcessLikelihood(steps_of(states[None], 0.1))
    fitted = likelihood.fit(model, (0, 1))
    assert np.isfinite(fitted.misfit)
    assert not np.isfinite(fitted.information).all()
    drift, variance = likelihood.estimate_errors(fitted, (0, 1)).standard_errors.tolist()
    assert drift < 1.0
    assert variance == np.inf


def test_a_fit_without_a_finite_derivative_ends_where_it_began() -> None:
    states = ornstein_uhlenbeck(200, 0.1, seed=1)
    model = model_of("-1*x", f"{float(np.max(states[:-1] ** 2)) * (1.0 + 1e-7)!r} - x*x")
    likelihood = ProcessLikelihood(steps_of(states[None], 0.1))
    fitted = likelihood.fit(model, (1,))
    assert fitted.model.diffusion[0].constants.tolist() == model.diffusion[0].constants.tolist()
    assert likelihood.estimate_errors(fitted, (1,)).standard_errors.tolist() == [np.inf]


def test_by_a_covariance_that_is_not_positive_no_states_are_smoothed() -> None:
    """Of two noises with a correlation of 5, beside errors of measurement."""
    steps = steps_of(np.array([ornstein_uhlenbeck(100, 0.1, seed) for seed in (1, 2)]), 0.1)
    drift = tuple(from_infix(f"-1*{name}", NAMES) for name in NAMES)
    diffusion = tuple(from_infix(value, NAMES) for value in ("0.2", "1", "0.2"))
    model = ProcessModel(drift, diffusion, ((0, 0), (0, 1), (1, 1)), (1e-6, 1e-6))
    assert np.array_equal(ProcessLikelihood(steps).smooth_states(model), steps.points)
