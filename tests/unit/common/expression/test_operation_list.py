"""Programs as operation lists of a given shape and given operators."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from atoll_core.expression.operation_list import placed, placed_text
from atoll_core.expression.operators import ARITY, BY_NAME, CONSTANT
from atoll_core.expression.program import Program, check_program_bytes
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate

NAMES = ("x", "y")
ROWS = ((0.5, 1.5), (1.25, -0.75), (-2.0, 0.25), (3.0, 2.0))
TERMINALS, INNER = 7, 25


def codes(operators):
    return [BY_NAME[name].code for name in operators.split()]


def nodes_of(text, operators="+ - * / sin cos", terminals=TERMINALS, inner=INNER):
    return placed(from_infix(text, NAMES), codes(operators), terminals, inner)


def list_of(nodes, terminals=TERMINALS, inner=INNER):
    """Return the whole list as a program; what the nodes leave free is the constant 0, or a sum of it."""
    rows = [(CONSTANT, 0, 0, 0.0)] * terminals + [(BY_NAME["+"].code, 0, 0, 0.0)] * inner
    for node in nodes:
        rows[node.index] = (node.code, node.left, node.right, node.constant)
    columns = list(zip(*rows, strict=True))
    kinds = (np.int8, np.int16, np.int16, np.float64)
    return Program(*(np.array(column, kind) for column, kind in zip(columns, kinds, strict=True)))


@pytest.mark.parametrize(
    ("text", "operators"),
    [
        ("3*x - 2*x*y - x**2", "+ - * / sin cos"),
        ("3*x - 2*x*y - x**2", "+ *"),
        ("-x/10", "+ - * /"),
        ("-x/10", "+ *"),
        ("-x", "+ -"),
        ("-(x + y)*x", "+ * neg"),
        ("x**2*y**2", "* square"),
        ("x*x", "square +"),
        ("x/y + 1/x", "+ * inverse"),
        ("1/(2 + y)", "+ inverse"),
        ("x + y", "-  *"),
        ("tan(x) + x**3", "+ * / sin cos"),
        ("sqrt(abs(x)) + exp(y)*tanh(x)", "+ * sqrt abs exp tanh"),
        ("y", "* +"),
        ("y", "+"),
        ("2.5", "-"),
        ("x", "/ sin"),
        ("2*3*x", "*"),
    ],
)
def test_a_list_computes_what_was_written_with_the_operators_at_hand(text, operators):
    nodes = nodes_of(text, operators)
    program = list_of(nodes)
    check_program_bytes(program.to_bytes(), len(NAMES))
    assert {node.code for node in nodes if ARITY[node.code]} <= set(codes(operators))
    expected = [evaluate(from_infix(text, NAMES), row) for row in ROWS]
    assert [evaluate(program, row) for row in ROWS] == pytest.approx(expected, rel=1e-14)


def test_terminals_come_first_and_the_output_is_last():
    nodes = nodes_of("3*x + y")
    leaves = [node.index for node in nodes if not ARITY[node.code]]
    inner = [node.index for node in nodes if ARITY[node.code]]
    assert sorted(leaves) == [0, 1, 2]
    assert sorted(inner) == [TERMINALS + INNER - 2, TERMINALS + INNER - 1]


def numbers(text, terminals=TERMINALS):
    nodes = placed_text(text, NAMES, codes("+ - *"), terminals, INNER)
    return sorted(node.constant for node in nodes if node.code == CONSTANT)


def test_equal_numbers_are_constants_apart_as_long_as_there_is_room():
    assert numbers("2*x + 2*y - 2") == [2.0, 2.0, 2.0]
    assert numbers("2*x + 2*y - 2", terminals=5) == [2.0, 2.0, 2.0]
    assert numbers("2*x + 2*y - 2", terminals=4) == [2.0]
    assert numbers("-x - y - x*y") == [-1.0]
    assert numbers("(2*3)*x + 6*y") == [6.0, 6.0]
    assert numbers("-(x*y) - -(x + y)") == [-1.0]


def test_equal_parts_are_written_once():
    assert len(nodes_of("(x + y)*(x + y)")) == 4


@pytest.mark.parametrize(
    ("text", "operators", "words"),
    [
        ("sin(x)", "+ *", ["'sin'", "+,*"]),
        ("x - y", "+", ["'-'", "+"]),
        ("x/y", "+ - *", ["'/'"]),
        ("x**1.5", "+ *", ["'pow'"]),
        ("y", "sin", ["single variable", "sin"]),
        ("x*y", "+ square", ["'*'"]),
    ],
)
def test_what_the_operators_cannot_write_is_refused(text, operators, words):
    with pytest.raises(UsageError) as caught:
        nodes_of(text, operators)
    assert [word for word in words if word not in str(caught.value)] == []


def test_a_list_has_room_for_so_many_nodes_and_no_more():
    nodes_of("1*x + 2*y", terminals=4, inner=3)
    with pytest.raises(UsageError, match=r"has 4 different variables and constants, .* room for 3; .* more terminals"):
        nodes_of("1*x + 2*y", terminals=3, inner=3)
    with pytest.raises(UsageError, match=r"has 3 operators, .* room for 2"):
        nodes_of("1*x + 2*y", terminals=4, inner=2)
