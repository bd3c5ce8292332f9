"""Expressions for other programs: sympy objects and LaTeX. sympy is imported only when asked for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from atoll.expression.program import Program
from atoll.expression.text.infix import to_infix
from atoll.expression.text.parsing import from_infix

if TYPE_CHECKING:
    import sympy


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

    rounded = from_infix(to_infix(program, names, digits=digits), names)
    return str(sympy.latex(_plain_numbers(to_sympy(rounded, names))))


def _plain_numbers(expression: "sympy.Expr") -> "sympy.Expr":
    """Return `expression` with whole floats as integers and the others at the digits they need."""
    import sympy

    def plain(number: "sympy.Float") -> "sympy.Expr":
        value = float(number)
        if value.is_integer() and abs(value) < 1e6:
            return sympy.Integer(int(value))
        return sympy.Float(repr(value), len(repr(value).lstrip("-0.").replace(".", "").split("e")[0]))

    return expression.xreplace({number: plain(number) for number in expression.atoms(sympy.Float)})


def left_side_to_latex(lhs: str) -> str:
    """Return ``dx/dt`` and ``d2x/dt2`` as fractions, any other left-hand side as a name."""
    import sympy

    above, slash, below = lhs.rpartition("/")
    if not slash:
        return str(sympy.latex(sympy.Symbol(lhs)))
    second = above.startswith("d2") and below.endswith("2")
    numerator = str(sympy.latex(sympy.Symbol(above[2:] if second else above[1:])))
    denominator = str(sympy.latex(sympy.Symbol(below[1:-1] if second else below[1:])))
    order = "^{2}" if second else ""
    return rf"\frac{{d{order} {numerator}}}{{d {denominator}{order}}}"
