"""LaTeX, MathML and sympy: names as mathematics or as they stand, expressions as the terminal shows them."""

from xml.etree import ElementTree

import pytest
import sympy
from hypothesis import assume, given

from atoll_core.expression.program import tree_size
from atoll_core.expression.text.export import (
    GIVEN_DIGITS,
    left_side_to_latex,
    left_side_to_mathml,
    to_latex,
    to_mathml,
    to_sympy,
)
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.property.programs import HOSTILE_NAMES, NAMES, programs
from tests.property.test_expressions import QUICK


@pytest.mark.parametrize(
    ("lhs", "latex"),
    [
        ("dx_1/dt", r"\frac{d x_{1}}{d t}"),
        ("d2theta/dt2", r"\frac{d^{2} \theta}{d t^{2}}"),
        ("d50% a_b$/dt", r"\frac{d \text{50\% a\_b\$}}{d t}"),
        ("dx^2 #{z}/dt", r"\frac{d \text{x\textasciicircum{}2 \#\{z\}}}{d t}"),
    ],
)
def test_names_are_mathematics_or_text(lhs: str, latex: str) -> None:
    assert left_side_to_latex(lhs) == latex


@pytest.mark.parametrize(
    ("text", "shown", "latex"),
    [
        ("3.0*x - x**2 - 2.0*(x*y)", "x*(3 - x - 2*y)", r"x \left(3 - x - 2 y\right)"),
        ("x/(2.0*y)", "0.5*x/y", r"\frac{0.5 x}{y}"),
        ("1/(x*(1.5 + y))", "1/(x*(1.5 + y))", r"\frac{1}{x \left(1.5 + y\right)}"),
        ("-x/y + sin(x)**2", "sin(x)**2 - x/y", r"\sin\left(x\right)^{2} - \frac{x}{y}"),
        ("1e-9*exp(-x)*2.0**y", "1e-09*exp(-x)*2**y", r"1 \cdot 10^{-9} \exp\left(- x\right) \cdot 2^{y}"),
        ("abs(x)**1.5*sqrt(y)", "sqrt(y)*abs(x)**1.5", r"\sqrt{y} \left|x\right|^{1.5}"),
        ("(x + y)**2.5", "(x + y)**2.5", r"\left(x + y\right)^{2.5}"),
        ("tan(x)*theta_1", "theta_1*tan(x)", r"\theta_{1} \tan\left(x\right)"),
    ],
)
def test_latex_and_mathml_have_the_writing_of_the_text(text: str, shown: str, latex: str) -> None:
    names = ("x", "y", "theta_1")
    program = from_infix(text, names)
    assert to_infix(program, names, digits=6) == shown
    assert to_latex(program, names) == latex
    told = "".join(ElementTree.fromstring(to_mathml(program, names)).itertext())
    for sign in "+-":
        assert told.replace("-9", "").count(sign) == shown.replace("e-", "e").count(sign)
    numbers = [element.text for element in ElementTree.fromstring(to_mathml(program, names)).iter("mn")]
    assert [number for number in ("3", "0.5", "1.5", "2.5") if number in shown and number not in numbers] == []


def test_mathml_separates_factors_by_dots_where_names_have_several_letters() -> None:
    program = from_infix("x*y*2.5", ("x", "y"))
    assert to_mathml(program, ("x", "y")).count("\u2062") == 2
    assert to_mathml(program, ("x", "prey")).count("\u00b7") == 2


@pytest.mark.slow
@QUICK
@given(programs(), HOSTILE_NAMES)
def test_whatever_variables_are_called_all_writings_are_made(program, names) -> None:
    assume(tree_size(program) <= 100 <= PRINTABLE_SIZE)
    plain, hostile = (to_mathml(program, spellings) for spellings in (NAMES, names))
    tags = [[element.tag for element in ElementTree.fromstring(text).iter("mfrac")] for text in (plain, hostile)]
    assert tags[0] == tags[1]
    assert to_latex(program, names).count(r"\frac") == to_latex(program, NAMES).count(r"\frac")


@pytest.mark.parametrize("name", ["sin", "lambda", "Symbol", "50% a", "None", "x + y", "e5"])
def test_sympy_takes_any_name_for_a_symbol(name: str) -> None:
    expression = to_sympy(from_infix("sin(x)*y**2 - x/2.5", ("x", "y")), (name, "y"))
    symbol = sympy.Symbol(name)
    assert expression == sympy.sin(symbol) * sympy.Symbol("y") ** 2 - symbol / sympy.Float("2.5")


def test_a_name_is_the_same_on_both_sides_of_an_equation() -> None:
    assert to_mathml(from_infix("x_1", ("x_1",)), ("x_1",)) in left_side_to_mathml("dx_1/dt")


def test_the_mark_of_an_unknown_part_has_a_box() -> None:
    names = ("x", "?", "?12")
    program = from_infix("x*a + b", ("x", "a", "b"))
    assert to_latex(program, names) == r"\boxed{?}_{12} + x \boxed{?}"
    assert '<msub><mi class="unknown">?</mi><mn>12</mn></msub>' in to_mathml(program, names)


def test_mathml_may_have_the_order_in_which_an_expression_was_written() -> None:
    names = ("x", "y")
    program = from_infix("y*x - 0.12345678*x + 2", names)
    told = "".join(ElementTree.fromstring(to_mathml(program, names, digits=GIVEN_DIGITS, is_given=True)).itertext())
    assert told.replace("\u2062", "").replace("\u00b7", "") == "yx-0.12345678x+2"
