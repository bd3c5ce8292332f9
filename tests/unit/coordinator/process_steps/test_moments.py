import numpy as np
from scipy import linalg

from atoll_coordinator.process_steps.moments import predict_step_moments
from atoll_core.expression.text.parsing import from_infix


def test_a_step_of_ornstein_and_uhlenbeck_is_their_transition_density_to_third_order() -> None:
    drift, diffusion = from_infix("-2*x", ["x"]), from_infix("0.25", ["x"])
    points = np.array([[1.0, 1.0, -3.0]])
    steps = np.array([0.01, 0.1, 0.1])
    moments = predict_step_moments([drift], {(0, 0): diffusion}, points, steps)
    mean, variance = points[0] * (np.exp(-2.0 * steps) - 1.0), 0.25 * (1.0 - np.exp(-4.0 * steps)) / 4.0
    assert np.allclose(moments.mean[0], mean, rtol=(2.0 * 0.1) ** 3 / 20.0)
    assert np.allclose(moments.covariance[0, 0], variance, rtol=(2.0 * 0.1) ** 3 / 4.0)
    assert np.allclose(moments.jacobian[0, 0], np.exp(-2.0 * steps), rtol=(2.0 * 0.1) ** 3 / 3.0)


def test_a_step_of_geometric_brownian_motion_is_right_to_second_order() -> None:
    names = ["x"]
    points, step = np.array([[0.5, 2.0]]), 0.05
    moments = predict_step_moments(
        [from_infix("0.3*x", names)], {(0, 0): from_infix("0.16*x*x", names)}, points, np.full(2, step)
    )
    x = points[0]
    assert np.allclose(moments.mean[0], x * (np.exp(0.3 * step) - 1.0), rtol=1e-5)
    variance = x * x * np.exp(0.6 * step) * (np.exp(0.16 * step) - 1.0)
    assert np.allclose(moments.covariance[0, 0], variance, rtol=3e-4)
    leading = 0.16 * x * x * step
    assert (np.abs(leading - variance) > 50.0 * np.abs(moments.covariance[0, 0] - variance)).all()


def test_noise_that_acts_on_a_velocity_alone_reaches_the_position() -> None:
    """The covariance of x' = v, dv = s dW is s^2 (h^3/3, h^2/2; h^2/2, h), which Euler's is not."""
    names = ["x", "v"]
    moments = predict_step_moments(
        [from_infix("v", names), from_infix("0*v", names)],
        {(1, 1): from_infix("4", names)},
        np.zeros((2, 1)),
        np.array([0.2]),
    )
    expected = 4.0 * np.array([[0.2**3 / 3.0, 0.2**2 / 2.0], [0.2**2 / 2.0, 0.2]])
    assert np.allclose(moments.covariance[:, :, 0], expected)


def test_noise_reaches_a_state_two_equations_away_without_a_singular_covariance() -> None:
    """Of x' = v, v' = a, da = dW it is that of Brownian motion integrated: h^5/20, h^4/8, h^3/6 in its first row."""
    names, step = ["x", "v", "a"], 0.1
    drift = [from_infix(text, names) for text in ("v", "a", "0*a")]
    moments = predict_step_moments(drift, {(2, 2): from_infix("1", names)}, np.zeros((3, 1)), np.array([step]))
    assert np.allclose(moments.covariance[0, :, 0], [step**5 / 20.0, step**4 / 8.0, step**3 / 6.0], rtol=1e-12)
    assert np.linalg.eigvalsh(moments.covariance[:, :, 0]).min() > 0.0


def test_what_other_states_leave_of_a_state_two_equations_away_is_right() -> None:
    """The variance of w given x and v is a thirty-sixth of that of w, so that errors of a step count as much more."""
    names, step = ["x", "v", "w"], 0.05
    jacobian, noise = np.array([[0.0, 1.0, 0.0], [-1.0, -0.5, 0.0], [1.0, 0.0, -1.0]]), np.diag([0.0, 0.25, 0.0])
    block = linalg.expm(step * np.block([[-jacobian, noise], [np.zeros((3, 3)), jacobian.T]]))
    exact = np.linalg.inv(block[3:, 3:].T @ block[:3, 3:])
    drift = [from_infix(text, names) for text in ("v", "-x - 0.5*v", "x - w")]
    moments = predict_step_moments(drift, {(1, 1): from_infix("0.25", names)}, np.zeros((3, 1)), np.array([step]))
    assert np.allclose(np.linalg.inv(moments.covariance[:, :, 0]), exact, rtol=0.01)


def test_what_the_drift_alone_moves_is_right_to_fourth_order() -> None:
    names, begins = ["x", "v"], np.array([[0.8], [0.3]])
    drift = [from_infix("v", names), from_infix("x - x*x*x - 0.5*v", names)]
    noise = {(1, 1): from_infix("0.25", names)}
    x, v = begins[:, 0]
    for _ in range(20_000):
        half_x, half_v = x + 0.5 * v * 5e-6, v + 0.5 * (x - x**3 - 0.5 * v) * 5e-6
        x, v = x + half_v * 5e-6, v + (half_x - half_x**3 - 0.5 * half_v) * 5e-6
    moments = predict_step_moments(drift, noise, begins, np.array([0.1]))
    assert np.allclose(moments.mean[:, 0], [x - 0.8, v - 0.3], atol=1e-7)


def test_a_negative_diffusion_is_none_though_the_covariance_of_a_step_is_positive() -> None:
    names = ["x", "v"]
    drift = [from_infix(text, names) for text in ("v", "0*v")]
    noise = {(0, 0): from_infix("-1e-6", names), (1, 1): from_infix("0.25", names)}
    moments = predict_step_moments(drift, noise, np.zeros((2, 1)), np.array([0.1]))
    assert not np.isfinite(moments.covariance).any()


def test_a_step_of_euler_and_maruyama_carries_no_noise_from_state_to_state() -> None:
    names = ["x", "v"]
    drift, noise = [from_infix(text, names) for text in ("v", "-x")], {(1, 1): from_infix("4", names)}
    moments = predict_step_moments(drift, noise, np.array([[1.0], [3.0]]), np.array([0.1]), "Euler-Maruyama")
    assert np.allclose(moments.mean[:, 0], [0.3, -0.1])
    assert np.allclose(moments.covariance[:, :, 0], [[0.0, 0.0], [0.0, 0.4]])
    assert np.allclose(moments.jacobian[:, :, 0], [[1.0, 0.1], [-0.1, 1.0]])
