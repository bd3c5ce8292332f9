"""Names as mathematics: sympy is the oracle, except for accents in words and for a few of its own words."""

import re
from html import unescape

import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from sympy.printing.mathml import mathml

from atoll_core.expression.text.names import GREEK, name_to_latex, name_to_mathml
from tests.property.test_expressions import QUICK

WORD = re.compile(r"(?<![^\W\d_])(?<!\\)[^\W\d_]{2,}")
"""Two or more adjacent letters that are not a LaTeX command."""
NAMES = [
    *GREEK, "x", "x1", "x_1", "theta_1", "k__on", "k__on_2", "_x", "__x", "x_", "x__", "x___y", "a_b_c", "prey1", "x12",
    "prey_max", "mu_max2", "1x", "x1_2", "x_1__2", "T_in", "e5", "None", "β_1", "α1", "Größe", "x_alpha", "beta2", "__",
    "xdot", "xddot", "thetahat", "x_dot", "phi_dot", "ddot", "Omegabar_2", "é1", "x²",
]  # fmt: skip


def sympy_latex(name: str) -> str:
    return WORD.sub(lambda word: rf"\mathrm{{{word[0]}}}", str(sympy.latex(sympy.Symbol(name))))


def sympy_mathml(name: str) -> str:
    return unescape(mathml(sympy.Symbol(name), printer="presentation"))


@pytest.mark.parametrize("name", NAMES)
def test_names_are_written_as_sympy_writes_them(name: str) -> None:
    assert name_to_latex(name) == sympy_latex(name)
    assert unescape(name_to_mathml(name)) == sympy_mathml(name)


@QUICK
@given(st.text("xyk_12", min_size=1, max_size=8))
def test_raised_and_lowered_parts_are_the_parts_of_sympy(name: str) -> None:
    assert name_to_latex(name) == sympy_latex(name)
    assert unescape(name_to_mathml(name)) == sympy_mathml(name)


@pytest.mark.parametrize("name", ["crowbar", "mag", "robot", "prime", "pivot_norm"])
def test_words_have_no_accents(name: str) -> None:
    assert re.fullmatch(r"\\mathrm\{\w+\}(_\{\\mathrm\{\w+\}\})?", name_to_latex(name))


def test_a_letter_has_an_accent() -> None:
    assert name_to_latex("hbar") == r"\bar{h}"
