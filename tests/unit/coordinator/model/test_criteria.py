"""What it takes to write a structure down."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.expression.program import with_constants
from atoll.expression.text.parsing import from_infix
from atoll_coordinator.model.criteria import structure_length
from atoll_coordinator.model.structure.moves.extensions import extensions
from tests.unit.coordinator.model.fitting import parsed


def nats(text):
    return structure_length(from_infix(text, ("x", "y")))


@pytest.mark.parametrize(
    ("plain", "dear"),
    [
        ("x", "sin(x)"),
        ("x*y", "x/y"),
        ("x/y", "exp(x)*y"),
        ("sin(x)", "sin(sin(x))"),
        ("sin(x) + sin(y)", "sin(x + sin(y))"),
        ("cos(x)*sin(y)", "cos(x*sin(y))"),
        ("x*x", "exp(x)"),
        ("x*x", "x**1.5"),
        ("x", "x + y"),
        ("2.0*x", "2.0*x + 3.0"),
        ("x*y + 2.0*x", "x*y + 2.0*x + 2.0*y"),
    ],
)
def test_what_is_rarer_in_equations_of_motion_costs_more(plain, dear):
    assert nats(plain) < nats(dear)


def test_a_function_inside_a_function_costs_more_than_both_apart():
    assert nats("sin(cos(x))") > nats("sin(x)") + nats("cos(x)") - nats("x")
    assert nats("sin(2.0*cos(x) + y)") - nats("2.0*cos(x) + y") > nats("sin(x)") - nats("x")


def test_what_is_no_transcendental_function_may_stand_anywhere():
    assert nats("sin(x*x)") - nats("x*x") == pytest.approx(nats("sin(x)") - nats("x"))
    assert nats("sin(-x)") == nats("sin(x)")


def test_a_square_costs_about_as_much_as_the_product():
    assert abs(nats("x**2") - nats("x*x")) <= 1.5


def test_using_a_part_again_is_cheaper_than_writing_it_twice():
    shared = nats("(x + 2.0*y)*(x + 2.0*y)")
    assert shared < nats("(x + 2.0*y)*(x + 3.0*y)")
    assert shared > nats("x + 2.0*y")


@settings(max_examples=30, deadline=None)
@given(value=st.floats(-1e6, 1e6))
def test_the_values_of_constants_do_not_count(value):
    program = parsed("3.5*x + sin(2.5*y)")
    places = [index for index, code in enumerate(program.operators.tolist()) if code == 1]
    assert structure_length(with_constants(program, dict.fromkeys(places, value))) == structure_length(program)


@pytest.mark.parametrize("text", ["x", "3.0*x - 2.0*x*y", "sin(x)/y"])
def test_every_extension_that_is_one_costs_more(text):
    program = parsed(text)
    for extended in extensions(program, [1.0, 1.0], range(2, 17)):
        if len(extended) > len(program):  # sin(x)/y over sin(x) is shorter
            assert structure_length(extended) > structure_length(program)
