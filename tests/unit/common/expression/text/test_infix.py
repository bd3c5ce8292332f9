"""Printing: brackets, signs, powers, display; and reading by sympy."""

import pytest
import sympy

from atoll_core.expression.operators import ADD, COS, DIVIDE, INVERSE, MULTIPLY, NEGATE, SIN, SQUARE, SUBTRACT, VARIABLE
from atoll_core.expression.program import tree_size
from atoll_core.expression.text.export import to_sympy
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.programs import program_of

NAMES = ("x", "y", "z")
X, Y, Z = (VARIABLE, 0), (VARIABLE, 1), (VARIABLE, 2)


@pytest.mark.parametrize(
    ("nodes", "text"),
    [
        ([X, Y, (ADD, 0, 1)], "x + y"),
        ([X, Y, (ADD, 0, 1), Z, (ADD, 3, 2)], "x + y + z"),
        ([X, Y, (ADD, 0, 1), Z, (SUBTRACT, 3, 2)], "z - (x + y)"),
        ([X, Y, (SUBTRACT, 0, 1), (ADD, 0, 1), (ADD, 2, 3)], "x - y + (x + y)"),
        ([X, Y, (MULTIPLY, 0, 1), Z, (MULTIPLY, 3, 2)], "x*y*z"),
        ([2.0, X, Y, (MULTIPLY, 1, 2), (MULTIPLY, 0, 3)], "2.0*(x*y)"),
        ([X, Y, (DIVIDE, 0, 1), Z, (DIVIDE, 3, 2)], "z/(x/y)"),
        ([X, Y, (DIVIDE, 0, 1), Z, (DIVIDE, 2, 3)], "x/y/z"),
        ([X, -2.0, (MULTIPLY, 0, 1)], "-2.0*x"),
        ([Y, X, -2.0, (MULTIPLY, 1, 2), (ADD, 0, 3)], "y - 2.0*x"),
        ([Y, X, -2.0, (MULTIPLY, 1, 2), (SUBTRACT, 0, 3)], "y + 2.0*x"),
        ([X, (NEGATE, 0), Y, (ADD, 1, 2)], "y - x"),
        ([X, Y, (ADD, 0, 1), (NEGATE, 2)], "-(x + y)"),
        ([X, (NEGATE, 0), (SQUARE, 1)], "x**2"),
        ([X, (NEGATE, 0), (SIN, 1)], "sin(-x)"),
        ([X, (MULTIPLY, 0, 0), (MULTIPLY, 1, 0)], "x**3"),
        ([X, (SQUARE, 0), (SQUARE, 1)], "(x**2)**2"),
        ([X, (ADD, 0, 0)], "2.0*x"),
        ([X, Y, (ADD, 0, 1), (SQUARE, 2)], "(x + y)**2"),
        ([X, (INVERSE, 0)], "1/x"),
        ([1.0, X, (DIVIDE, 0, 1)], "1.0/x"),
        ([X, -3.0, (ADD, 0, 1)], "x - 3.0"),
        ([0.1, 0.2, (ADD, 0, 1)], "0.1 + 0.2"),
        ([X, (SIN, 0), (COS, 0), (DIVIDE, 1, 2)], "tan(x)"),
        ([X, (SIN, 0), (NEGATE, 1), (COS, 0), (DIVIDE, 3, 2)], "-cot(x)"),
        ([X, Y, (SIN, 0), (COS, 1), (DIVIDE, 2, 3)], "sin(x)/cos(y)"),
    ],
)
def test_text_has_no_more_brackets_than_it_needs(nodes, text):
    assert to_infix(program_of(nodes), NAMES) == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("3.0000000001*x - x**2 - 2.0*(x*y)", "x*(3 - x - 2*y)"),
        ("0.99999999999*x", "x"),
        ("30.772*x*y/(30.772 + 30.772*x)", "x*y/(1 + x)"),
        ("x/(2.0*y)", "0.5*x/y"),
        ("1.0/(x*y)", "1/(x*y)"),
        ("-(x + y)", "-x - y"),
        ("x - (y - z)", "x - y + z"),
        ("x*x*x*x", "x**4"),
        ("x**0.5", "sqrt(x)"),
        ("-x*-y", "x*y"),
        ("(x + y)**2", "(x + y)**2"),
        ("(x + y)*1.0", "x + y"),
        ("(x + y)*(x - z)", "(x + y)*(x - z)"),
        ("x*x**0.5", "x*sqrt(x)"),
        ("x*x**0.7", "x**1.7"),
        ("x - x", "0"),
        ("1/(x - x)", "1/(x - x)"),
        ("sin(2*(x*3))", "sin(6*x)"),
    ],
)
def test_display_rounds_and_shortens(text, shown):
    assert to_infix(from_infix(text, NAMES), NAMES, digits=6) == shown


def test_a_list_that_is_a_huge_tree_is_refused_at_once():
    nodes = [X, Y]
    nodes += [(ADD, index - 1, index - 2) for index in range(2, 100)]
    program = program_of(nodes)
    assert tree_size(program) > 1e18
    with pytest.raises(ValueError, match=f"at most {PRINTABLE_SIZE}"):
        to_infix(program, NAMES)


@pytest.mark.parametrize(
    "text",
    [
        "3.0*x - x**2 - 2.0*x*y",
        "abs(x) + tanh(y)*sqrt(z**2) - exp(-x)/log(2.5 + y**2)",
        "x**(-2.5) + 1e-07*sin(x)/cos(1.0 + y)",
        "-(x + y)**3/(z - 4.0)",
    ],
)
def test_sympy_reads_what_we_read(text):
    program = from_infix(text, NAMES)
    values = {"x": 1.25, "y": 0.75, "z": 2.5}
    symbols = {name: sympy.Symbol(name) for name in NAMES}
    read = sympy.parse_expr(to_infix(program, NAMES), local_dict=symbols)
    assert float(read.subs(values)) == pytest.approx(float(sympy.sympify(text).subs(values)), rel=1e-12)
    assert to_sympy(program, NAMES) == read
