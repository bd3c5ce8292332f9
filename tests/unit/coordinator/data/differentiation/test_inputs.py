"""Inputs between rows: as smooth as they look, and no smoother."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from atoll_coordinator.data.differentiation.inputs import (
    InputCurve,
    choose_input_kind,
    estimate_input_slopes,
    relative_curve_error,
    unknown_variance,
)


def steps(rows, seed=0):
    return np.cumsum(np.random.default_rng(seed).uniform(0.05, 0.15, rows))


def slopes_of(times, values):
    return estimate_input_slopes(times, values, choose_input_kind(times, values))


@pytest.mark.parametrize("scale", [1.0, 1e-300, 1e300])
def test_a_linear_input_is_exact(scale):
    times = steps(30)
    (slopes,) = slopes_of([times], [scale * (3.0 - 0.7 * times)])
    assert slopes / scale == pytest.approx(np.full(30, -0.7), rel=1e-12)


def test_a_smooth_input_is_interpolated_to_the_fourth_order():
    times = steps(100)
    (slopes,) = slopes_of([times], [np.sin(times)])
    between = np.linspace(times[3], times[-4], 999)
    curve = CubicHermiteSpline(times, np.sin(times), slopes)
    assert np.abs(curve(between) - np.sin(between)).max() < 3e-6


def test_a_switched_input_does_not_overshoot():
    times = [steps(60), steps(40, 1)]
    values = [np.where(part_times % 2.0 < 1.0, 0.0, 5.0) for part_times in times]
    for part_times, part, slopes in zip(times, values, slopes_of(times, values), strict=True):
        curve = CubicHermiteSpline(part_times, part, slopes)(np.linspace(part_times[0], part_times[-1], 2000))
        assert -1e-12 < curve.min() <= curve.max() < 5.0 + 1e-12


def test_all_trajectories_of_an_input_are_taken_alike():
    """A short smooth piece of an input that is switched elsewhere is shape-preserving too."""
    switched, smooth = steps(60), steps(8, 1)
    alone = slopes_of([smooth], [np.sin(smooth)])[0]
    both = slopes_of([switched, smooth], [np.where(switched % 2.0 < 1.0, 0.0, 5.0), np.sin(smooth)])[1]
    assert not np.allclose(alone, both)


def test_a_curve_is_the_cubic_with_its_slopes_and_constant_beyond():
    times = steps(40)
    curve = InputCurve.through(times, np.sin(times), "smooth")
    cubic = CubicHermiteSpline(times, np.sin(times), curve.slopes)
    for t in np.linspace(times[0], times[-1], 333):
        assert curve(t) == pytest.approx(float(cubic(t)), abs=1e-13)
    assert curve(times[0] - 1.0) == np.sin(times[0])
    assert curve(times[-1] + 1.0) == np.sin(times[-1])
    assert not len(curve.jumps)


def test_a_held_input_keeps_the_value_of_a_row_until_the_next():
    curve = InputCurve.through(np.array([0.0, 1.0, 3.0]), np.array([2.0, 2.0, 5.0]), "held")
    assert [curve(t) for t in (-1.0, 0.0, 0.99, 2.99, 3.0, 9.0)] == [2.0, 2.0, 2.0, 2.0, 5.0, 5.0]
    assert curve.jumps.tolist() == [3.0]


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
def test_few_rows_make_a_curve(rows):
    times = np.arange(float(rows))
    curve = InputCurve.through(times, 2.0 * times)
    assert curve(0.5 * (rows - 1)) == pytest.approx(float(rows - 1))


@pytest.mark.parametrize("rows", [7, 12, 25])
def test_the_error_of_a_smooth_curve_is_that_between_its_rows(rows):
    """Of `rows` in a period of a sine; the estimate is above the error, by less than ten times."""
    times = np.arange(0.0, 60.0, 2.0 * np.pi / rows)
    between = np.linspace(times[2], times[-3], 2000)
    curve = InputCurve.through(times, np.sin(times), "smooth")
    error = np.sqrt(np.mean([(curve(t) - np.sin(t)) ** 2 for t in between.tolist()])) / np.std(np.sin(times))
    assert error < relative_curve_error([times], [np.sin(times)], "smooth") < 10.0 * error


def test_a_random_walk_is_unknown_between_its_rows_by_a_quarter_of_the_variance_of_a_step():
    """A Brownian bridge: s (1 - s) of it at the share s of the way."""
    walk = np.cumsum(np.random.default_rng(4).standard_normal(4000))
    variance = unknown_variance([np.arange(4000.0)], [walk], "shape-preserving")
    assert variance == pytest.approx(0.25, rel=0.15)
    scaled = unknown_variance([np.arange(4000.0)], [1e6 * walk], "shape-preserving")
    assert scaled == pytest.approx(1e12 * variance, rel=1e-9)


def test_what_is_drawn_anew_in_each_row_is_unknown_and_a_smooth_or_held_input_is_not():
    times, draw = np.arange(200.0), np.random.default_rng(5)
    anew = draw.uniform(size=200)
    assert unknown_variance([times], [anew], "shape-preserving") > 0.5 * anew.var()
    assert unknown_variance([times], [anew], None) > 0.25 * anew.var()
    assert unknown_variance([times], [anew], "held") == 0.0
    assert unknown_variance([times], [np.sin(0.3 * times)], "smooth") < 1e-6
    assert unknown_variance([times], [np.full(200, 7.0)], "smooth") == 0.0


def test_of_four_rows_nothing_tells_how_an_input_goes_between_them():
    assert unknown_variance([np.arange(4.0)], [np.arange(4.0)], "shape-preserving") is None


def test_an_input_that_is_switched_now_and_then_is_known_between_its_rows():
    times = np.arange(300.0)
    switched = (times % 60.0 < 25.0) * 1.0
    assert unknown_variance([times], [switched], "shape-preserving") < 0.1 * switched.var()
