"""Expressions for other programs: sympy objects, LaTeX and MathML. sympy is imported only when asked for."""

import re
from collections.abc import Sequence
from html import escape, unescape
from typing import TYPE_CHECKING, Final

from atoll.expression.program import Program
from atoll.expression.text.infix import to_infix
from atoll.expression.text.parsing import from_infix

if TYPE_CHECKING:
    import sympy

_HTML_ENTITY: Final = re.compile(r"&(?!lt;|gt;|amp;|quot;|apos;|#)\w+;")
"""An entity that XML does not have, such as the invisible times."""

_LATEX_ESCAPES: Final = {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"} | {
    letter: f"\\{letter}" for letter in "{}$%#&_"
}


def to_sympy(program: Program, names: Sequence[str]) -> "sympy.Expr":
    """Return `program` as a sympy expression over ``Symbol(name)`` for each of `names`; constants keep every bit.

    sympy arranges terms anew and folds what it can, so the value agrees up to rounding.
    """
    import sympy

    symbols = {name: sympy.Symbol(name) for name in names}
    expression: sympy.Expr = sympy.parse_expr(to_infix(program, names), local_dict=symbols)
    return expression


def to_latex(program: Program, names: Sequence[str], *, digits: int = 6) -> str:
    """Return `program` as LaTeX mathematics, constants rounded to `digits` significant digits."""
    import sympy

    return str(sympy.latex(_rounded(program, names, digits)))


def to_mathml(program: Program, names: Sequence[str], *, digits: int = 6) -> str:
    """Return `program` as presentation MathML without its ``math`` element, constants rounded to `digits` digits.

    Factors are separated by dots where a name has several letters.
    """
    from sympy.printing.mathml import mathml

    product = "dot" if any(len(name) > 1 for name in names) else None
    text = mathml(_rounded(program, names, digits), printer="presentation", mul_symbol=product)
    return _HTML_ENTITY.sub(lambda found: unescape(found[0]), text)


def _rounded(program: Program, names: Sequence[str], digits: int) -> "sympy.Expr":
    return _plain_numbers(to_sympy(from_infix(to_infix(program, names, digits=digits), names), names))


def _plain_numbers(expression: "sympy.Expr") -> "sympy.Expr":
    """Return `expression` with whole floats as integers and the others at the digits they need."""
    import sympy

    def plain(number: "sympy.Float") -> "sympy.Expr":
        value = float(number)
        if value.is_integer() and abs(value) < 1e6:
            return sympy.Integer(int(value))
        return sympy.Float(repr(value), len(repr(value).lstrip("-0.").replace(".", "").split("e")[0]))

    return expression.xreplace({number: plain(number) for number in expression.atoms(sympy.Float)})


def left_side_to_latex(lhs: str, *, is_name: bool = False) -> str:
    """Return ``dx/dt`` and ``d2x/dt2`` as fractions, any other left-hand side, and one that `is_name`, as a name."""
    order, *names = (0, lhs, "") if is_name else _derivative(lhs)
    above, below = map(_latex_name, names)
    power = "^{2}" if order == 2 else ""
    return rf"\frac{{d{power} {above}}}{{d {below}{power}}}" if order else above


def _latex_name(name: str) -> str:
    """Return a name as mathematics; one that is no identifier as text, with what LaTeX would understand escaped."""
    import sympy

    if re.fullmatch(r"\w*", name):
        return str(sympy.latex(sympy.Symbol(name))) if name else ""
    return rf"\text{{{''.join(_LATEX_ESCAPES.get(letter, letter) for letter in name)}}}"


def left_side_to_mathml(lhs: str, *, is_name: bool = False) -> str:
    """Return ``dx/dt`` and ``d2x/dt2`` as fractions of MathML, other left-hand sides, and what `is_name`, as names."""
    order, *names = (0, lhs, "") if is_name else _derivative(lhs)
    above, below = (f"<mi>{escape(name)}</mi>" for name in names)
    if order == 0:
        return above
    d = "<mi>d</mi>"
    if order == 2:
        return f"<mfrac><mrow>{_squared(d)}{above}</mrow><mrow>{d}{_squared(below)}</mrow></mfrac>"
    return f"<mfrac><mrow>{d}{above}</mrow><mrow>{d}{below}</mrow></mfrac>"


def _squared(content: str) -> str:
    return f"<msup>{content}<mn>2</mn></msup>"


def _derivative(lhs: str) -> tuple[int, str, str]:
    """Return the order of a left-hand side, what is derived and by what; order 0 and the name where it is none."""
    above, slash, below = lhs.rpartition("/")
    if slash and above.startswith("d2") and below.startswith("d") and below.endswith("2"):
        return 2, above[2:], below[1:-1]
    if slash and above.startswith("d") and below.startswith("d"):
        return 1, above[1:], below[1:]
    return 0, lhs, ""
