"""What constants cost by the evidence of functions."""

import numpy as np
import pytest
from scipy.integrate import quad

from atoll_coordinator.model.shooting.system import System, system_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from benchmarks.scores.evidence import effects_of, occam

NAMES = ("x", "y")


def system(text: str) -> System:
    return system_of([from_infix(text, NAMES), from_infix("x", NAMES)], NAMES, NAMES)


@pytest.fixture
def inputs() -> FloatArray:
    return np.random.default_rng(2).uniform(0.5, 1.5, (2, 300))


def test_two_writings_with_as_many_constants_cost_about_the_same(inputs: FloatArray) -> None:
    systems = [system(text) for text in ("x/(0.25*(2 + y))", "x/(0.5 + 0.25*y)")]
    lengths = [occam(1e8 * effects_of(one, inputs), one, inputs) for one in systems]
    assert lengths == pytest.approx([0.5 * 2 * np.log(1e8)] * 2, abs=4.0)
    assert abs(lengths[0] - lengths[1]) < 3.0


def test_a_far_origin_costs_more_though_the_function_is_the_same(inputs: FloatArray) -> None:
    lengths = []
    for origin in (0.0, 100.0):
        one, there = system(f"{0.3 - 0.7 * origin!r} + 0.7*x"), inputs + origin
        lengths.append(occam(1e6 * effects_of(one, there), one, there))
    assert lengths[1] - lengths[0] == pytest.approx(19.0, abs=1.0)  # ADR 0068 says so


def test_a_term_of_next_to_no_effect_costs_more_than_one_that_is_seen(inputs: FloatArray) -> None:
    lengths = []
    for text in ("x + 0.3*y", "x + 1e-6*y"):
        one = system(text)
        lengths.append(occam(1e12 * effects_of(one, inputs), one, inputs))
    assert lengths[1] - lengths[0] == pytest.approx(2.0 * np.log(0.3 / 1e-6), abs=2.0)


@pytest.mark.parametrize(("errors", "least", "most"), [(0.1, 4.0, 5.5), (1.0, 0.3, 1.0), (4.0, 0.0, 0.3)])
def test_the_price_is_that_of_the_integral_but_where_a_constant_is_hardly_seen(
    inputs: FloatArray, errors: float, least: float, most: float
) -> None:
    one = system("x + 0.001*y")
    effects = effects_of(one, inputs)
    e = abs(float(one.values[0])) * float(np.sqrt(effects[0, 0]))
    precision = errors / e
    cost = occam(precision**2 * effects, one, inputs)

    def density(value: float) -> float:
        return float(2.0 / np.pi * value**2 / (1.0 + value**2) ** 2 * np.exp(-0.5 * precision**2 * (value - e) ** 2))

    reach = 12.0 / precision
    exact = -np.log(quad(density, e - reach, e + reach, points=[0.0, e], epsabs=0.0)[0])
    assert least <= cost - exact <= most


def test_constants_that_are_not_there_cost_nothing(inputs: FloatArray) -> None:
    one = system("x + y")
    assert occam(np.zeros((0, 0)), one, inputs) == 0.0
