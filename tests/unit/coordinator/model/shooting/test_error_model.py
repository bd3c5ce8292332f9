"""Errors that go together, estimated from what a fit leaves."""

import numpy as np
import pytest

from atoll_coordinator.model.shooting.error_model import ErrorModel, Innovations

ROWS, DECAY, CURVES, DRAWS = 200, 0.9, 4, 60


def innovations():
    return Innovations(np.array([[0, ROWS]]), np.ones(ROWS), np.ones((1, ROWS)))


def rough(rng, rows, decay):
    """Return AR(1) errors of variance one."""
    errors = rng.standard_normal(rows)
    for row in range(1, rows):
        errors[row] = decay * errors[row - 1] + np.sqrt(1.0 - decay**2) * errors[row]
    return errors


def residuals(rng):
    """Return what is left of AR(1) errors where polynomials were fitted to them."""
    errors = rough(rng, ROWS, DECAY)
    curves = np.linalg.qr(np.linspace(-1.0, 1.0, ROWS)[:, None] ** np.arange(CURVES))[0]
    return (errors - curves @ (curves.T @ errors))[None, :]


def test_a_correlation_is_that_of_the_errors_not_of_what_a_fit_leaves_of_them():
    rng = np.random.default_rng(3)
    rows = innovations()
    lengths = []
    for _ in range(DRAWS):
        shares, decays = rows.estimate(residuals(rng), CURVES)
        lengths.append(ErrorModel(np.ones(1), shares, decays).lengths[0])
    assert np.median(lengths) == pytest.approx((1.0 + DECAY) / (1.0 - DECAY), rel=0.15)


def test_a_variance_of_correlated_errors_has_few_degrees_of_freedom():
    model = ErrorModel(np.ones(2), np.array([0.0, 1.0]), np.array([0.0, DECAY]))
    assert model.degrees_of_freedom.tolist() == [1.0, pytest.approx(1.0 / (1.0 + 2.0 / (1.0 - DECAY**2)))]


TURN = 10.0
"""Rows after which the derivative of a state has turned."""


@pytest.mark.parametrize("decay", [0.5, 0.7, 0.9, 0.95])
def test_what_is_rough_and_goes_together_is_an_error_of_the_sensor(decay):
    found = [
        innovations().sensor_errors(
            rough(np.random.default_rng(seed), ROWS, decay)[None], np.ones(1), 0.0, np.full(1, TURN)
        )
        for seed in range(20)
    ]
    assert sum(errors.shares[0] > 0.0 for errors in found) >= 18
    lengths = [errors.lengths[0] for errors in found if errors.shares[0] > 0.0]
    assert np.median(lengths) == pytest.approx((1.0 + decay) / (1.0 - decay), rel=0.4)


@pytest.mark.parametrize("size", [1.0, 2.0, 5.0])
def test_what_is_smooth_and_turns_as_a_state_does_is_none(size):
    """Cosines whose derivative turns in about ten rows, with independent errors of size one."""
    rng, count = np.random.default_rng(5), 0
    for _ in range(20):
        waves = sum(
            rng.standard_normal() * np.cos(2.0 * np.pi * np.arange(ROWS) / period + rng.uniform(0.0, 2.0 * np.pi))
            for period in (60.0, 90.0, 150.0)
        )
        left = size * waves / np.std(waves) + rng.standard_normal(ROWS)
        count += innovations().sensor_errors(left[None], np.ones(1), 0.0, np.full(1, TURN)).shares[0] > 0.0
    assert count <= 2


def test_independent_errors_are_seldom_taken_for_a_sensor_s():
    rng = np.random.default_rng(6)
    found = [
        innovations().sensor_errors(rng.standard_normal((1, ROWS)), np.ones(1), 0.0, np.full(1, TURN))
        for _ in range(60)
    ]
    assert sum(errors.shares[0] > 0.0 for errors in found) <= 2


def test_whitened_residuals_do_not_go_together():
    errors = rough(np.random.default_rng(7), 2000, DECAY)[None]
    weights = np.where(np.arange(2000) % 7 == 0, 0.0, 4.0)[None]
    rows = Innovations(np.array([[0, 2000]]), np.ones(2000), weights)
    model = ErrorModel(np.ones(1), np.ones(1), np.full(1, DECAY))
    white = rows.whiten(errors, model)
    squares, _ = rows.squares(errors, model)
    assert (white[weights == 0.0] == 0.0).all()
    assert float((weights * white**2).sum()) == pytest.approx(squares[0])
    kept = white[weights > 0.0]
    assert abs(float(kept[1:] @ kept[:-1]) / float(kept @ kept)) < 0.05
