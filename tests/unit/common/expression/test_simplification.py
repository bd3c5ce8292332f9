"""Simplification and complexity."""

import pytest

from atoll_core.expression.operators import (
    ADD,
    BY_NAME,
    DIVIDE,
    LOG,
    MULTIPLY,
    NEGATE,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.text.infix import to_infix
from tests.oracles.evaluate import apply
from tests.oracles.programs import program_of

NAMES = ("x", "y")
X, Y = (VARIABLE, 0), (VARIABLE, 1)


@pytest.mark.parametrize(
    ("nodes", "text"),
    [
        ([X, Y, (SIN, 1), 2.0, (MULTIPLY, 0, 3)], "2.0*x"),  # unused nodes
        ([2.0, 3.0, (MULTIPLY, 0, 1), X, (NEGATE, 2), (ADD, 3, 4)], "x - 6.0"),  # constants of constants
        ([0.1, 0.2, (ADD, 0, 1)], "0.30000000000000004"),  # to the bit
        ([X, (SUBTRACT, 0, 0)], "x - x"),  # no algebra of real numbers
        ([X, 0.0, (MULTIPLY, 0, 1)], "0.0*x"),
    ],
)
def test_programs_are_simplified_and_keep_every_bit(nodes, text):
    assert to_infix(simplify_program(program_of(nodes)), NAMES) == text


@pytest.mark.parametrize(
    ("nodes", "size"),
    [
        ([X, Y, (ADD, 0, 1), X, Y, (ADD, 4, 3), (MULTIPLY, 2, 5)], 4),  # y + x is x + y
        ([X, (MULTIPLY, 0, 0), (SQUARE, 0), (ADD, 1, 2)], 3),  # x*x is x**2
        ([X, Y, (SUBTRACT, 0, 1), (SUBTRACT, 1, 0), (ADD, 2, 3)], 5),
        ([0.0, -0.0, X, (MULTIPLY, 2, 0), (MULTIPLY, 2, 1), (ADD, 3, 4)], 6),
    ],
)
def test_equal_nodes_count_once(nodes, size):
    assert complexity(program_of(nodes)) == size


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_every_operator_on_constants_becomes_its_value(name):
    operator = BY_NAME[name]
    program = simplify_program(program_of([1.75, 2.5, (operator.code, 0, 1 if operator.arity == 2 else 0)]))
    assert len(program) == 1
    assert program.constants[0] == pytest.approx(apply(operator.code, 1.75, 2.5), rel=1e-15)


@pytest.mark.parametrize(
    "nodes", [[0.0, (LOG, 0)], [1.0, 0.0, (DIVIDE, 0, 1)], [-1.0, (SQRT, 0)], [1e200, (SQUARE, 0)], [1e6, (SIN, 0)]]
)
def test_what_has_no_finite_value_is_not_folded(nodes):
    assert len(simplify_program(program_of(nodes))) == len(nodes)


def test_programs_of_the_same_shape_have_the_same_bytes_in_whatever_order_they_were_listed():
    one = program_of([X, Y, (SIN, 0), (SIN, 1), (ADD, 2, 3)])
    other = program_of([Y, (SIN, 0), X, (SIN, 2), (ADD, 3, 1)])
    assert simplify_program(one) == simplify_program(other)
