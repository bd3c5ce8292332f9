"""Models whose sides were given in part: names of constants, values, derivatives, texts, picks and candidates."""

from typing import Any

import numpy as np
import pytest

import atoll
from atoll.export.formats import as_csv
from atoll.model.equations import constant_names
from atoll.model.given_sides import GivenSides, program_of
from atoll.text.render import pick, render, render_text
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from tests.unit.library.model.results import bioreactor, given_entries, result, with_given

STATE = {"X": 0.7, "S": 0.9}


def rates(values: dict[str, float]) -> np.ndarray:
    growth = values["S"] / (0.6 + 2.0 * values["S"])
    return np.array([growth * values["X"] - 0.2 * values["X"], -growth * values["X"] / 0.5 + 0.2 * (3.0 - values["S"])])


def with_candidate(contents: dict[str, Any]) -> dict[str, Any]:
    """Return a result with another unknown part as a candidate and as a member of the front."""
    first, *others = contents["equations"]
    candidate = {
        "expression": "0.4*S*X - 0.2*X", "nats": 5.0, "unknown": "0.4*S", "parameters": {"Y": 0.45}, "origin": "front",
    }  # fmt: skip
    shown = {"expression": first["expression"], "nats": 0.0, "selected": True, "unknown": "S/(0.6 + 2.0*S)"}
    front = [{"expression": "0.4*S", "complexity": 3, "normalized_error": 0.1}]
    return contents | {"equations": [first | {"candidates": [shown, candidate], "front": front}, *others]}


def test_sides_are_composed_to_the_programs_of_the_result() -> None:
    of = Result.of(bioreactor())
    sides = GivenSides.of(of)
    assert list(sides.programs) == [program_of(equation, of.names) for equation in of.equations]
    assert sides.values.tolist() == [0.5]
    plain = Result.of(result({"x": "-2.0*x"}))
    assert GivenSides.of(plain).programs == (program_of(plain.equations[0], plain.names),)
    contents = bioreactor()
    contents["equations"][0]["given"]["unknowns"] = []
    with pytest.raises(UsageError, match="do not fit their unknown parts"):
        GivenSides.of(Result.of(contents))


def test_parameters_keep_their_names_and_numbers_of_the_text_have_none() -> None:
    model = atoll.Model(bioreactor())
    assert {name: one.value for name, one in model.params.items()} == {"c1": 0.6, "c2": 2.0, "Y": 0.5}
    assert model.params["Y"].bounds == (0.1, 2.0)
    assert constant_names(model.result) == {"X": ["c1", "c2", "0.2"], "S": ["c1", "c2", "Y", "0.2", "3"]}


def test_a_counted_name_is_never_the_name_of_a_parameter() -> None:
    sides = {"x": "-c1*x + ?", "y": "-3.0*y"}
    entries = given_entries(sides, {"?": "0.25*y"}, {"c1": 1.5})
    model = atoll.Model(with_given(result(dict.fromkeys(sides, "1")), entries))
    assert {name: one.value for name, one in model.params.items()} == {"c1": 1.5, "c2": 0.25}


def test_values_and_derivatives_are_those_of_the_sides() -> None:
    model = atoll.Model(bioreactor())
    point = [STATE["X"], STATE["S"]]
    np.testing.assert_allclose(model.field.values(point), rates(STATE), rtol=1e-14)
    changed = model.field.with_values({"Y": 0.5 + 1e-6, "c1": 0.6})
    slope = (changed.values(point) - model.field.values(point)) / 1e-6
    place = next(index for index, one in enumerate(model.field.parameters) if one.name == "Y")
    np.testing.assert_allclose(model.field.parameter_derivatives(point)[:, place], slope, rtol=1e-5, atol=1e-9)
    shared = model.field.with_values({"c2": 4.0}).values(point)
    growth = STATE["S"] / (0.6 + 4.0 * STATE["S"])
    expected = [growth * 0.7 - 0.2 * 0.7, -growth * 0.7 / 0.5 + 0.2 * (3.0 - 0.9)]
    np.testing.assert_allclose(shared, expected, rtol=1e-14)  # the constant changes in both sides
    with pytest.raises(UsageError, match="the parameters are c1, c2, Y; did you mean 'Y'"):
        model.simulate(STATE, [0.0, 1.0], parameters={"y": 1.0})


def test_a_simulation_uses_other_values_of_parameters() -> None:
    model, times = atoll.Model(bioreactor()), np.linspace(0.0, 5.0, 11)
    other = bioreactor()
    for equation, entry in zip(other["equations"], given_entries_with_yield(0.4), strict=True):
        equation.update(entry)
    expected = atoll.Model(other).simulate(STATE, times)
    np.testing.assert_allclose(model.simulate(STATE, times, parameters={"Y": 0.4})["S"], expected["S"], rtol=1e-9)


def given_entries_with_yield(value: float) -> list[dict[str, Any]]:
    sides = {"X": "?1(S)*X - 0.2*X", "S": "-?1(S)*X/Y + 0.2*(3 - S)"}
    return list(given_entries(sides, {"?1": "S/(0.6 + 2.0*S)"}, {"Y": value}).values())


def test_joint_errors_use_only_fitted_numbers() -> None:
    places = [("X", 0), ("X", 1), ("S", 0), ("S", 1), ("S", 2)]
    covariance = {
        "constants": [{"variable": name, "constant": place} for name, place in places],
        "matrix": (0.01 * np.eye(5)).tolist(),
        "freedom": 100.0,
    }
    model = atoll.Model(bioreactor(covariance=covariance))
    errors = model.joint_errors
    assert errors is not None
    named = [model.field.parameters[column].name for column in errors.columns]
    assert named == ["c1", "c2", "c1", "c2", "Y"]
    assert model.simulate(STATE, [0.0, 1.0]).lower is not None


def test_text_has_the_side_as_the_user_wrote_it_with_numbers() -> None:
    text = render_text(Result.of(bioreactor()))
    assert "dX/dt = S/(0.6 + 2*S)*X - 0.2*X\n    given: ?1(S)*X - 0.2*X\n    ?1 = S/(0.6 + 2*S)\n" in text
    assert "    given: -?1(S)*X/Y + 0.2*(3 - S)\n    Y = 0.5 (0.500 ± 0.010)\n    ?1 = S/(0.6 + 2*S)\n" in text
    assert "written out" not in text


def test_text_says_which_parameters_are_on_a_bound_or_not_determined() -> None:
    contents = bioreactor()
    place = contents["equations"][1]["given"]["parameters"]["Y"]
    constants = contents["equations"][1]["constants"]
    constants[place] = {"value": 0.5, "fitted": 0.5, "at_bound": True, "interval": [0.4, 0.5]}
    assert "Y = 0.5 (at its bound, 0.4 to 0.5)" in render_text(Result.of(contents))
    constants[place] = {"value": 0.5, "fitted": 0.5, "identifiable": False}
    assert "Y = 0.5 (not determined)" in render_text(Result.of(contents))


def test_a_front_has_the_label_of_the_unknown_part_that_was_searched_under_its_equation() -> None:
    sides = {"x": "-?1(x)", "y": "?1(x) - ?2(y)", "z": "?2(y) - 0.5*z"}
    contents = result(dict.fromkeys(sides, "1"))
    contents = with_given(contents, given_entries(sides, {"?1": "0.5*x", "?2": "0.3*y"}, {}))
    for entry in contents["equations"]:
        entry["front"] = [{"expression": "0.4*x", "complexity": 3, "normalized_error": 0.1}]
    of = Result.of(contents)
    heads = [line.split("R2  ")[1] for line in render_text(of, fronts=True).splitlines() if "R2  " in line]
    assert heads == ["expression of ?1", "expression of ?2", "expression"]
    shown = [line.split(",")[1] for line in as_csv(of).splitlines() if line.endswith("0.4*x")]
    assert shown == ["?1 in dx/dt", "?2 in dy/dt", "dz/dt"]


def test_a_picked_unknown_part_stands_in_all_its_sides() -> None:
    picked = pick(Result.of(with_candidate(bioreactor())), {"X": 0})
    model = atoll.Model(picked)
    growth = 0.4 * STATE["S"]
    expected = [growth * 0.7 - 0.2 * 0.7, -growth * 0.7 / 0.5 + 0.2 * (3.0 - 0.9)]
    np.testing.assert_allclose(model.field.values([0.7, 0.9]), expected, rtol=1e-14)
    assert [equation.verdict for equation in picked.equations] == [None, None]
    assert "?1 = 0.4*S" in render_text(picked)
    unchanged = pick(Result.of(with_candidate(bioreactor())), {})
    assert unchanged.equations == Result.of(with_candidate(bioreactor())).equations


def test_a_candidate_has_its_unknown_part_in_all_sides_and_its_own_parameters() -> None:
    (candidate,) = atoll.Model(with_candidate(bioreactor())).candidates
    growth = 0.4 * STATE["S"]
    expected = [growth * 0.7 - 0.2 * 0.7, -growth * 0.7 / 0.45 + 0.2 * (3.0 - 0.9)]
    np.testing.assert_allclose(candidate.field.values([0.7, 0.9]), expected, rtol=1e-14)
    assert candidate.params["Y"].stderr is None
    assert candidate.params["Y"].bounds == (0.1, 2.0)


def test_formulas_have_parameters_by_name_and_a_brace_below_unknown_parts() -> None:
    model = atoll.Model(bioreactor())
    assert r"\underbrace{\frac{S}{0.6 + 2 S}}_{?1}" in model.latex()
    assert r"Y = 0.5\; (0.500 \pm 0.010)" in model.latex()
    assert model.mathml().count("<mtext>?1</mtext>") == 2
    assert "<mi>Y</mi>" in model.mathml()
    assert "<code>?1 = S/(0.6 + 2*S)</code>" in model.to_html()


def test_sympy_source_has_parameters_as_symbols_with_their_values() -> None:
    space: dict[str, Any] = {}
    exec(render(Result.of(bioreactor()), "sympy"), space)
    side = space["equations"]["dS/dt"]
    assert {str(symbol) for symbol in side.free_symbols} == {"X", "S", "Y"}
    values = {space["symbols"][name]: value for name, value in STATE.items()}
    np.testing.assert_allclose(float(side.subs(space["parameters"]).subs(values)), rates(STATE)[1])


def test_expressions_of_the_result_have_the_same_values() -> None:
    of = Result.of(bioreactor())
    points = np.array([[STATE["X"]], [STATE["S"]]])
    for equation, expected in zip(of.equations, rates(STATE), strict=True):
        np.testing.assert_allclose(values_of(program_of(equation, of.names), points)[0], expected, rtol=1e-14)
