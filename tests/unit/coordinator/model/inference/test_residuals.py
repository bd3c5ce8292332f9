"""Residuals: noise passes, too much of it and patterns do not, and what was fitted is allowed for."""

import numpy as np
import pytest

from atoll_coordinator.model.inference.residuals import clip_outliers, residual_statistics
from atoll_core.data.dataset import FloatArray


def noise(seed: int, rows: int = 100, trajectories: int = 4) -> list[FloatArray]:
    draw = np.random.default_rng(seed)
    return [draw.normal(size=rows) for _ in range(trajectories)]


def coloured(seed: int, share: float) -> list[FloatArray]:
    """Noise of variance 1, of which a share is a slow oscillation."""
    slow = np.sqrt(2.0 * share) * np.sin(np.linspace(0.0, 12.0, 100))
    return [np.sqrt(1.0 - share) * series + slow for series in noise(seed)]


def without_polynomial(errors: FloatArray, parameters: int) -> FloatArray:
    base = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(errors)), parameters))[0]
    return errors - base @ (base.T @ errors)


def test_noise_is_seldom_taken_for_anything_else() -> None:
    checked = [residual_statistics(noise(seed), 1.0) for seed in range(300)]
    assert sum(series.pattern_probability < 0.05 for series in checked) in range(5, 27)
    assert sum(series.size_probability < 0.05 for series in checked) in range(5, 27)
    assert np.mean([series.standard_deviation for series in checked]) == pytest.approx(1.0, abs=0.01)
    assert np.mean([series.correlation for series in checked]) == pytest.approx(0.0, abs=0.01)


def test_what_fitting_takes_away_is_allowed_for() -> None:
    fitted = [[without_polynomial(series, 6) for series in noise(seed)] for seed in range(300)]
    checked = [residual_statistics(series, 1.0, parameters=24) for series in fitted]
    assert np.mean([series.standard_deviation for series in checked]) == pytest.approx(1.0, abs=0.01)
    assert np.mean([series.correlation for series in checked]) == pytest.approx(0.0, abs=0.015)
    assert np.mean([residual_statistics(series, 1.0).correlation for series in fitted]) < -0.04
    assert sum(series.pattern_probability < 0.05 for series in checked) in range(5, 30)


def test_a_pattern_is_found_with_its_share() -> None:
    checked = residual_statistics(coloured(0, 0.4), 1.0)
    assert checked.correlation == pytest.approx(0.4, abs=0.12)
    assert checked.pattern_probability < 1e-6
    assert 0.8 < checked.ratio < 1.2


def test_residuals_larger_than_the_noise_are_found() -> None:
    checked = residual_statistics([1.5 * series for series in noise(1)], 1.0)
    assert checked.ratio == pytest.approx(1.5, rel=0.1)
    assert checked.size_probability < 1e-6
    assert checked.pattern_probability > 0.01


def test_trajectories_are_not_joined_end_to_end() -> None:
    """A jump from one trajectory to the next is no pair of neighbours; a trajectory of one row has none at all."""
    checked = residual_statistics([np.array([1.0]), np.array([1.0]), np.array([-1.0])], 1.0)
    assert (checked.correlation, checked.pattern_probability) == (0.0, 0.5)


def test_outliers_do_not_decide_a_robust_check() -> None:
    wild = noise(2)
    wild[0][10] = wild[2][50] = 40.0
    assert residual_statistics(wild, 1.0).ratio > 2.0
    assert residual_statistics(clip_outliers(wild), 1.0).ratio == pytest.approx(1.0, abs=0.15)


def test_no_residuals_and_no_noise_are_borne() -> None:
    nothing = [np.zeros(10)]
    assert residual_statistics(nothing, 1.0).standard_deviation == 0.0
    assert residual_statistics(nothing, 0.0).size_probability == 1.0
    assert residual_statistics(noise(3), 0.0).ratio == np.inf


def drifting(white: list[FloatArray], neighbours: float) -> list[FloatArray]:
    """Return AR(1) errors of variance 1 with these innovations, in units of their deviation."""
    errors = [np.array(series) for series in white]
    for series in errors:
        for row in range(1, len(series)):
            series[row] = neighbours * series[row - 1] + np.sqrt(1.0 - neighbours**2) * series[row]
    return errors


def test_a_variance_of_errors_that_go_together_is_judged_by_their_innovations() -> None:
    made = [noise(seed, 200, 1) for seed in range(200)]
    checked = [residual_statistics(drifting(white, 0.95), 1.0, innovations=white) for white in made]
    assert sum(series.size_probability < 0.01 for series in checked) <= 7
    assert sum(residual_statistics(drifting(white, 0.95), 1.0).size_probability < 0.01 for white in made) > 20


def test_errors_that_go_together_as_a_sensor_s_are_no_pattern() -> None:
    white = noise(2, 200)
    errors = drifting(white, 0.8)
    assert residual_statistics(errors, 1.0).pattern_probability < 1e-6
    checked = residual_statistics(errors, 1.0, innovations=white)
    assert checked.pattern_probability > 0.01
    assert checked.ratio == pytest.approx(1.0, abs=0.15)
