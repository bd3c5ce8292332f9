"""Experiments on results with given sides: the numbers that were fitted are fitted again, and no others."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll.experiments.comparison import compare
from atoll.experiments.designs import Design, DesignPredictor
from atoll.experiments.fits import EquationSetFit, constants_of, equations_of, fit_displayed, fit_equations, measured_of
from atoll.experiments.identifiability import identify
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from tests.unit.library.experiments.made import Course, measured
from tests.unit.library.model.results import BIOREACTOR, given_entries, with_given
from tests.unit.library.model.results import result as result_of

NOISE = 0.005
TIMES = np.linspace(0.0, 15.0, 61)
GROWTH = {"?1": "S/(0.55 + 1.9*S)"}


def courses() -> list[Course]:
    """Return two runs of a bioreactor with the growth rate S/(0.6 + 2 S), the yield 0.5 and the dilution 0.2."""
    generator = np.random.default_rng(3)

    def rates(_: float, state: FloatArray) -> list[float]:
        growth = state[1] / (0.6 + 2.0 * state[1])
        return [growth * state[0] - 0.2 * state[0], -growth * state[0] / 0.5 + 0.2 * (3.0 - state[1])]

    runs = []
    for start in ([0.1, 3.0], [0.8, 0.4]):
        states = solve_ivp(rates, (0.0, 15.0), start, t_eval=TIMES, rtol=1e-9, atol=1e-9).y
        noisy = states + generator.normal(0.0, NOISE, states.shape)
        runs.append((TIMES, dict(zip(BIOREACTOR, noisy, strict=True))))
    return runs


def bioreactor(
    sides: Mapping[str, str] = BIOREACTOR, yields: float = 0.45, bounds: Any = None, parts: Mapping[str, str] = GROWTH
) -> Result:
    entries = given_entries(dict(sides), dict(parts), {"Y": yields} if "Y" in sides["S"] else {}, {"Y": bounds})
    return Result.of(with_given(measured(dict.fromkeys(sides, "1"), courses(), NOISE), entries))


@pytest.fixture(scope="module")
def result() -> Result:
    return bioreactor()


@pytest.fixture(scope="module")
def fitted(result: Result) -> EquationSetFit:
    return fit_displayed(measured_of(result), result)


def test_parameters_and_constants_of_unknown_parts_are_fitted_and_numbers_of_the_text_are_not(
    result: Result, fitted: EquationSetFit
) -> None:
    assert [one.name for one in constants_of(fitted.equations, result)] == ["c1", "c2", "Y"]
    np.testing.assert_allclose(fitted.values, [0.6, 2.0, 0.5], rtol=0.03)
    sides = dict(zip(result.symbols, fitted.fit.system.programs, strict=True))
    assert {0.2, 3.0} <= {*sides["S"].constants.tolist()}
    shared = [{value for value in side.constants.tolist() if value not in (0.0, 0.2, 3.0)} for side in sides.values()]
    assert shared[0] < shared[1]  # the constants of ?1 are the same numbers in both sides


def test_a_wrong_number_of_the_text_stays_as_it_was_given() -> None:
    sides = BIOREACTOR | {"X": "?1(S)*X - 0.25*X"}
    wrong = bioreactor(sides)
    fit = fit_displayed(measured_of(wrong), wrong)
    assert 0.25 in fit.fit.system.programs[0].constants.tolist()
    assert len(fit.values) == 3


def test_bounds_of_a_parameter_hold() -> None:
    bounded = bioreactor(bounds=[0.1, 0.48])
    fit = fit_displayed(measured_of(bounded), bounded)
    assert fit.values[2] == 0.48


def test_profiles_have_the_names_of_parameters(result: Result) -> None:
    profiled = identify(result)
    assert {constant.name: constant.verdict for constant in profiled.constants} == dict.fromkeys(
        ("c1", "c2", "Y"), "determined"
    )
    low, high = profiled["Y"].interval
    assert low < 0.5 < high
    np.testing.assert_allclose(profiled["Y"].interval, profiled["Y"].quadratic, rtol=1e-2)


def test_another_unknown_part_stands_in_all_its_sides(fitted: EquationSetFit) -> None:
    other = fitted.equations.with_searched(0, from_infix("0.4*S/(1.0 + S)", ("X", "S"), merges_constants=False))
    fit = fit_equations(fitted.measured, other, fitted.fit.starts)
    assert fit is not None
    assert len(fit.values) == 3  # 0.4, 1.0 and Y
    programs = fit.fit.system.programs
    assert {*fit.values[:2].tolist()} <= {*programs[0].constants.tolist()} & {*programs[1].constants.tolist()}
    assert abs(fit.misfit - fitted.misfit) < 1e-3  # the same law with other constants


def test_a_whole_equation_replaces_a_side_and_the_unknown_part_moves_to_the_other_side(fitted: EquationSetFit) -> None:
    text = "0.5*S*X/(0.3 + S) - 0.2*X"
    other = fitted.equations.with_equation(0, from_infix(text, ("X", "S"), merges_constants=False))
    fit = fit_equations(fitted.measured, other, fitted.fit.starts)
    assert fit is not None
    # the constants of X are free, those of ?1 and the yield belong to S only
    np.testing.assert_allclose(fit.values[:3], [0.5, 0.3, 0.2], rtol=0.15)
    assert len(fit.values) == 6


def test_predictions_of_designs_have_the_derivatives_of_shared_numbers(fitted: EquationSetFit) -> None:
    sigmas = np.array([NOISE, NOISE])
    times = np.linspace(0.0, 3.0, 5)
    design = Design(np.array([0.2, 1.0]), np.zeros(0), times)
    predictor = predictor_of(fitted, sigmas)
    spread = predictor.at(design).spread[..., :3]
    shift = 1e-5
    for number in range(3):
        values = fitted.values.copy()
        values[number] += shift
        moved = replace(fitted, fit=replace(fitted.fit, system=fitted.fit.system.with_values(values)))
        slope = (predictor_of(moved, sigmas).at(design).values - predictor.at(design).values) / shift
        weights = np.linalg.solve(fitted.root, np.eye(3)[number])
        np.testing.assert_allclose(spread @ weights, slope, rtol=2e-3, atol=2e-2)


def predictor_of(fitted: EquationSetFit, sigmas: FloatArray) -> DesignPredictor:
    return DesignPredictor(fitted, np.ones(2), np.array([[-9.0, 9.0], [-9.0, 9.0]]), sigmas)


def test_templates_are_compared_on_the_same_data(result: Result) -> None:
    wrong = bioreactor(BIOREACTOR | {"S": "-?1(S)*X/Y + 0.2*(2.5 - S)"})
    comparison = compare(result, wrong)
    (on,) = comparison.data
    assert [side.constants for side in on.sides] == [3, 3]
    assert on.nats > 100.0
    texts = (BIOREACTOR["S"], "-?1(S)*X/Y + 0.2*(2.5 - S)")
    assert comparison.forms["dS/dt"] == f"the same form, given as {texts[0]} and as {texts[1]}"
    swapped = compare(wrong, result)
    np.testing.assert_allclose(swapped.data[0].nats, -on.nats, rtol=1e-2)


def test_a_template_is_compared_with_free_equations(result: Result) -> None:
    texts = {"X": "0.5*S*X/(0.3 + S) - 0.2*X", "S": "0.6 - 0.2*S - 1.0*S*X/(0.3 + S)"}
    free = Result.of(measured(texts, courses(), NOISE))
    (on,) = compare(result, free).data
    assert [side.constants for side in on.sides] == [3, 7]
    assert abs(on.nats) < 20.0


def test_equal_constants_of_an_equation_beside_a_given_side_are_two_constants() -> None:
    contents = result_of({"X": "1", "S": "2.0*X - 2.0*S"})
    contents["equations"][0] |= given_entries(BIOREACTOR, {"?1": "S/(0.6 + 2.0*S)"}, {"Y": 0.5})["X"]
    program = from_infix("2.0*X - 2.0*S", ["X", "S"], merges_constants=False)
    contents["equations"][1]["program"] = program.to_bytes().hex()
    of = Result.of(contents)
    constants = constants_of(equations_of(of), of)
    assert [one.variable for one in constants if one.is_written] == ["X", "X", "S", "S"]
