"""What rows say for an equation against a constant and a random walk."""

import math

import numpy as np
import pytest
from scipy import special

from atoll_coordinator.model.inference.null_models import log_bayes_factor, squared_steps, structure_price
from atoll_core.expression.text.parsing import from_infix


@pytest.mark.parametrize(("rows", "constants", "left"), [(8, 1, 0.01), (12, 4, 0.3), (30, 2, 0.9), (60, 5, 0.5)])
def test_the_integral_is_the_hypergeometric_function(rows: int, constants: int, left: float) -> None:
    """Liang et al. (2008), equation 17, with a = 3."""
    closed = special.hyp2f1(0.5 * (rows - 1), 1.0, 0.5 * (constants + 3), 1.0 - left) / (constants + 1)
    assert log_bayes_factor(rows, constants, left) == pytest.approx(math.log(closed), abs=1e-4)


@pytest.mark.parametrize("constants", [6, 7, 12])
def test_as_many_numbers_as_rows_gain_nothing(constants: int) -> None:
    assert log_bayes_factor(7, constants, 1e-30) == 0.0


def test_fewer_numbers_gain_more_of_the_same_rows() -> None:
    gains = [log_bayes_factor(8, constants, 1e-4) for constants in range(8)]
    assert gains == sorted(gains, reverse=True)
    assert gains[0] == pytest.approx(3.5 * math.log(1e4))


def test_noise_is_described_better_than_by_a_constant_as_rarely_as_promised() -> None:
    """By Markov's inequality, t nats come about by chance with a probability of at most exp(-t)."""
    draw = np.random.default_rng(0)
    columns = np.vander(np.linspace(-1.0, 1.0, 8), 4)
    gains = []
    for _ in range(2_000):
        values = draw.normal(size=8)
        coefficients, *_ = np.linalg.lstsq(columns, values, rcond=None)
        left = float(((values - columns @ coefficients) ** 2).sum() / ((values - values.mean()) ** 2).sum())
        gains.append(log_bayes_factor(8, 3, left))
    assert np.mean(np.array(gains) >= 3.0) <= math.exp(-3.0)


def test_a_walk_is_described_by_its_steps_and_noise_by_its_mean() -> None:
    steps = np.random.default_rng(1).normal(size=(2, 400))
    walk = np.cumsum(steps[0])
    assert squared_steps([walk]) < 0.1 * float(((walk - walk.mean()) ** 2).sum())
    assert squared_steps([steps[1]]) == pytest.approx(2.0 * 400.0, rel=0.2)
    assert squared_steps([np.full(9, 2.0), np.ones(1)]) == 0.0


def test_the_choice_among_many_columns_has_a_price() -> None:
    names = tuple(f"x{number}" for number in range(40))
    program = from_infix("x1 + x2*x3", names)
    few, many = structure_price(program, 4), structure_price(program, 40)
    assert many - few == pytest.approx(3.0 * math.log(10.0))
    assert structure_price(program, 3) == few


def test_a_walk_with_a_drift_has_the_line_taken_out_over_uneven_times():
    times = [np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 2.0])]
    lines = [5.0 + 2.5 * moments for moments in times]
    assert squared_steps(lines, times) == pytest.approx(0.0, abs=1e-20)
    assert squared_steps(lines) == pytest.approx(2.5**2 * (1.0 + 4.0 + 1.0 + 4.0))
