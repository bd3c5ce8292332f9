"""Steps are seen in the digits of what was recorded, and nothing is seen where there are none."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.quantisation import find_quantisation, is_refuted
from atoll_coordinator.data.differentiation.smoothing import Signal

TIMES = np.linspace(0.0, 20.0, 300)
CURVE = 70.0 / (1.0 + np.exp(-0.5 * (TIMES - 8.0)))
NOISE = 0.3 * np.random.default_rng(0).standard_normal(300)


@pytest.mark.parametrize(
    ("values", "kind", "step"),
    [
        (np.round(CURVE, 3), "digits", 1e-3),
        (np.round(0.01 * CURVE, 3), "decimals", 1e-3),
        (np.array([float(f"{value:.4g}") for value in CURVE]), "digits", 1e-2),
        (CURVE.astype(np.float32).astype(np.float64), "single precision", 2.0**-17),
        (np.round(CURVE / 0.0137) * 0.0137, "steps", 0.0137),
        (np.round(np.round((CURVE + NOISE) / 0.137) * 0.137, 6), "steps", 0.137),
        (3.1 + np.round(0.001 * CURVE / 7.0e-5) * 7.0e-5, "steps", 7.0e-5),
        (np.radians(np.round(CURVE, 1)), "steps", math.radians(0.1)),
        (np.round(CURVE), "decimals", 1.0),
    ],
)
def test_steps_are_found(values, kind, step):
    quantisation = find_quantisation([values[:100], np.append(values[100:], math.nan)])
    assert quantisation.step == pytest.approx(step, rel=1e-3)
    if kind in ("steps", "single precision"):
        assert quantisation.kind == kind
    assert quantisation.error <= quantisation.step / math.sqrt(12.0) * (1.0 + 1e-12)


@pytest.mark.parametrize("values", [CURVE, CURVE + NOISE, 0.0 * CURVE, np.sin(TIMES) * 1e-12])
def test_where_there_are_none_none_are(values):
    assert find_quantisation([values]) is None


@pytest.mark.parametrize("rows_a_period", range(3, 21))
def test_values_that_differ_by_rounding_alone_are_one_value(rows_a_period):
    phases = np.arange(200) * (2.0 * np.pi / rows_a_period)
    assert find_quantisation([np.cos(phases)]) is None
    assert find_quantisation([-np.sin(phases)]) is None


@pytest.mark.parametrize(("levels", "step"), [(1.0, 1.0), (0.5, 2.0)])
def test_few_values_in_many_rows_show_a_step(levels, step):
    quantisation = find_quantisation([np.round(levels * 2.0 * np.sin(TIMES)) / levels])
    assert (quantisation.kind, quantisation.step) == ("steps", step)


@pytest.mark.parametrize(("digits", "step"), [(0, 1.0), (1, 0.1)])
def test_few_rows_show_the_place_to_which_they_were_written(digits, step):
    """Seven different values and fewer: 2, 1.1, 0.5, 0.3, 0.2, 0.1, 0.1 was not measured to three digits."""
    quantisation = find_quantisation([np.round(2.0 * np.exp(-0.6 * np.arange(7.0)), digits)])
    assert (quantisation.kind, quantisation.step) == ("decimals", pytest.approx(step))


@pytest.mark.parametrize("rows", [6, 7])
def test_a_wave_in_step_with_the_rows_of_short_trajectories_shows_none(rows):
    """No trajectory has two periods, all together have many; a missing value is no other value."""
    wave = np.array([1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0])[:rows]
    parts = [wave.copy() for _ in range(5)]
    parts[2][3] = math.nan
    assert find_quantisation(parts) is None


def signal_of(values):
    return Signal(0.1 * np.arange(float(len(values))), np.asarray(values, dtype=np.float64))


@pytest.mark.parametrize(
    "values",
    [
        1.0 + 0.2 * np.arange(100),
        500.0 - 3.0 * np.arange(30),
        np.arange(60) ** 2,
        np.arange(25) * np.arange(1, 26) / 2.0,
    ],
)
def test_even_steps_of_a_smooth_curve_are_no_rounding(values):
    signals = [signal_of(values)]
    quantisation = find_quantisation([values])
    assert quantisation is not None
    assert is_refuted(quantisation, signals)
    estimate = estimate_derivatives(signals, Differentiation())
    assert estimate.target_noise == 0.0


@pytest.mark.parametrize("scale", [0.05, 0.3, 1.0, 10.0, 300.0])
def test_rounding_is_not_refuted_however_slowly_or_fast_a_state_moves(scale):
    values = np.round(scale * CURVE)
    quantisation = find_quantisation([values])
    assert quantisation is None or not is_refuted(quantisation, [signal_of(values)])


def test_no_step_is_seen_in_random_numbers():
    draw = np.random.default_rng(1)
    assert all(find_quantisation([draw.normal(size=int(draw.integers(8, 60)))]) is None for _ in range(400))


def test_the_error_is_that_of_rounding():
    draw = np.random.default_rng(2)
    exact = draw.uniform(1.0, 1000.0, 2000)
    rounded = np.array([float(f"{value:.4g}") for value in exact])
    quantisation = find_quantisation([rounded])
    assert quantisation.error == pytest.approx(float(np.sqrt(np.mean((rounded - exact) ** 2))), rel=0.1)
