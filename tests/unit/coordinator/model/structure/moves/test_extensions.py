"""Programs with one small part more."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.structure.moves.extensions import extensions, further_terms, leaps
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, ARITY, BY_NAME, COS, DIVIDE, MULTIPLY, NEGATE, SIN, SQUARE, SUBTRACT
from atoll_core.expression.program import constant_places, structure
from atoll_core.expression.writing.shortest import shortest
from tests.unit.coordinator.model.fitting import parsed, shown

ALL = [operator.code for operator in BY_NAME.values()]
TEXTS = ("x", "1.5", "3.0*x - 2.0*x*y", "sin(x)/y", "0.5*x/(1.2 + x*x)", "exp(-0.3*x) + y")
DRAW = np.random.default_rng(4)
INPUTS = np.stack([DRAW.uniform(0.5, 2.0, 40), DRAW.uniform(-2.0, -0.5, 40)])


def is_wrapped(program, extended):
    """Tell whether a function came in or went without a small constant, which is no small change."""
    brought = len(constant_places(extended)) - len(constant_places(program))
    return waves(extended) != waves(program) and (brought <= 0 or waves(extended) < waves(program))


def waves(program):
    return sum(code in (SIN, COS) for code in program.operators.tolist())


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(text=st.sampled_from(TEXTS), powers=st.tuples(st.integers(0, 1), st.integers(0, 1)))
def test_each_has_nearly_the_values_of_the_original_in_smaller_units_too(text, powers):
    units = [10.0**power for power in powers]
    inputs = INPUTS * np.array(units)[:, None]
    scales = np.abs(inputs).mean(axis=1).tolist()
    for name, unit in zip(("x", "y"), units, strict=True):
        text = re.sub(rf"\b{name}\b", f"({name}/{unit!r})", text)
    program = shortest(parsed(text))
    before = values_of(program, inputs)
    for extended in extensions(program, scales, ALL):
        if is_wrapped(program, extended):
            continue
        change = np.abs(values_of(extended, inputs) - before).max()
        assert 0.0 < change <= 300.0 * SETTINGS.common.negligible * (1.0 + np.abs(before).max())


def names(program):
    return {code for code in program.operators.tolist() if ARITY[code]}


@pytest.mark.parametrize("text", TEXTS)
def test_each_structure_comes_once_and_has_one_constant_more(text):
    program = parsed(text)
    made = list(extensions(program, [1.0, 1.0], ALL))
    assert len({structure(extension) for extension in made} | {structure(program)}) == len(made) + 1
    counts = {len(constant_places(extension)) - len(constant_places(program)) for extension in made}
    assert counts <= {0, 1, 2}  # functions alone bring none, 1 + c v brings two
    assert 1 in counts


def test_every_kind_of_part_is_tried():
    made = {shown(extension) for extension in extensions(parsed("x"), [1.0, 1.0], ALL)}
    wanted = (
        "x + 0.001", "x + 0.001*y", "x + 0.001*x*x", "x + 0.001*y*x", "x + 0.001*y*y", "x + 0.001/y",
        "x + 0.001*sin(y)", "x + 0.001*cos(x)", "x*(1.001 + 0.001*y)", "x/(1.001 + 0.001*y)",
        "x*sin(y)", "x/cos(y)",
    )  # fmt: skip
    for text in wanted:
        assert any(_is_near(text, other) for other in made), text


def test_further_terms_are_linear_first_then_a_constant_then_products_of_two():
    made = [shown(longer) for longer in further_terms(parsed("2.0*x*x*y"), [1.0, 1.0], ALL)]
    for text, longer in zip(("x", "y", "1", "x*x", "x*y", "y*y"), made, strict=True):
        assert _is_near(f"2.0*x*x*y + 0.002*{text}", longer)


def test_further_terms_have_the_variables_and_operators_that_are_allowed_and_are_of_no_structure_known():
    assert len(list(further_terms(parsed("x"), [1.0, 0.0], ALL))) == 3
    assert len(list(further_terms(parsed("2.0*x"), [1.0, 0.0], ALL))) == 2
    assert not list(further_terms(parsed("x"), [1.0, 1.0], [MULTIPLY]))


def _is_near(text, other):
    values = [values_of(parsed(program), INPUTS) for program in (text, other)]
    return bool(np.abs(values[0] - values[1]).max() < 1e-12)


@pytest.mark.parametrize(
    "operators",
    [(ADD, MULTIPLY), (ADD, SUBTRACT, MULTIPLY, DIVIDE), (ADD, MULTIPLY, SIN), (MULTIPLY, DIVIDE), (ADD, COS)],
)
def test_only_allowed_operators_are_brought_in(operators):
    """Squares are products, and signs differences."""
    program = parsed("0.5*x")
    allowed = {*operators, MULTIPLY, *((SQUARE,) if MULTIPLY in operators else ()), NEGATE}
    for extension in extensions(program, [1.0, 1.0], operators):
        assert names(extension) <= allowed


def test_a_variable_of_size_0_is_not_used():
    assert all("y" not in shown(extension) for extension in extensions(parsed("0.5*x"), [1.0, 0.0], ALL))
    assert any("y" in shown(extension) for extension in extensions(parsed("0.5*x"), [1.0, 1.0], ALL))
    assert {shown(extension) for extension in extensions(parsed("x"), [0.0, 0.0], ALL)} == {"0.001 + x"}


def test_a_single_use_of_a_variable_is_extended_by_itself():
    program = parsed("20.0 - x - 2.0*y/x")
    texts = [shown(extension) for extension in extensions(program, [1.0, 1.0], [ADD, SUBTRACT, MULTIPLY, DIVIDE])]
    assert any(text.count("0.001/x") == 1 and "- x" in text and "/(" in text for text in texts), texts


@pytest.mark.parametrize(("text", "inner", "outer"), [("cos(sin(x))", SIN, COS), ("sin(cos(x))", COS, SIN)])
def test_functions_open_into_the_beginning_of_their_series(text, inner, outer):
    """It has nearly the values of the function, and no function of a function."""
    program = parsed(text)
    differences = [
        values_of(leap, INPUTS) - values_of(program, INPUTS)
        for leap in leaps(program, ALL)
        if inner in leap.operators.tolist() and outer not in leap.operators.tolist()
    ]
    assert min(np.abs(difference).max() for difference in differences) < 0.05


def test_a_variable_leaps_into_its_sine_and_cosine():
    assert {shown(leap) for leap in leaps(parsed("0.5*x"), ALL)} == {"0.5*sin(x)", "0.5*cos(x)"}
    assert {shown(leap) for leap in leaps(parsed("0.5*x"), [ADD, SIN])} == {"0.5*sin(x)"}


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_new_parts_are_small_beside_what_they_are_joined_to_whatever_the_units(unit):
    inputs = INPUTS * unit
    program = parsed("3.0*x - 2.0*y")
    before = values_of(program, inputs)
    made = [*extensions(program, np.abs(inputs).mean(axis=1).tolist(), (ADD, SUBTRACT, MULTIPLY, DIVIDE))]
    assert len(made) > 20
    for extended in made:
        assert (
            0.0
            < np.abs(values_of(extended, inputs) - before).max()
            <= 20.0 * SETTINGS.common.negligible * np.abs(before).max()
        )
