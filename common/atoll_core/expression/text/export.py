"""Expressions for other programs: sympy objects, LaTeX and MathML. sympy is imported only when asked for.

LaTeX and MathML have the order of terms and factors, the signs, powers and brackets that the text has.
"""

import re
from abc import abstractmethod
from collections.abc import Sequence
from html import escape, unescape
from typing import TYPE_CHECKING, Final, cast

from atoll_core.expression.operators import ABS, SQRT
from atoll_core.expression.program import Program
from atoll_core.expression.text.form import Form, Kind, Renderer, Signed
from atoll_core.expression.text.infix import displayed_form, exact_form
from atoll_core.expression.text.notation import INFIX

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
    return _Sympy(names).render(exact_form(program))


def to_latex(program: Program, names: Sequence[str], *, digits: int = 6) -> str:
    """Return `program` as LaTeX mathematics, written as `to_infix` shows it with so many `digits` of constants."""
    return _Latex(names, digits).render(displayed_form(program, digits))


def to_mathml(program: Program, names: Sequence[str], *, digits: int = 6) -> str:
    """Return `program` as presentation MathML without its ``math`` element, written as `to_infix` shows it.

    Factors are separated by dots where a name has several letters, and between numbers.
    """
    return _MathML(names, digits).render(displayed_form(program, digits))


class _Sympy(Renderer["sympy.Expr"]):
    """Makes sympy objects of operators and operands: a name may be whatever a column is called."""

    def __init__(self, names: Sequence[str]) -> None:
        import sympy

        super().__init__()
        self._symbols = [sympy.Symbol(name) for name in names]

    def negative(self, operand: "sympy.Expr") -> "sympy.Expr":
        return -operand

    def of(self, form: Form) -> "sympy.Expr":
        import sympy

        match form.kind:
            case Kind.NAME:
                return self._symbols[form.index]
            case Kind.NUMBER:
                value, name = form.number
                return sympy.Integer(1) if name else sympy.Float(repr(value))
            case Kind.CALL:
                function = getattr(sympy, "Abs" if form.code == ABS else INFIX.call(form.code))
                return cast("sympy.Expr", function(self.signed(form.parts[0])))
            case Kind.GROUP:
                return self.signed(form.parts[0])
            case Kind.SUM:
                return sum(map(self.signed, form.terms[1:]), self.signed(form.terms[0]))
            case Kind.NATURAL:
                return self.plain(form.parts[0]) ** form.exponent
        left, right = map(self.signed, form.parts)
        return (
            left * right if form.kind is Kind.PRODUCT else left / right if form.kind is Kind.QUOTIENT else left**right
        )


class _Typeset(Renderer[str]):
    """What is typeset has in common; `digits` are the significant ones of constants."""

    def __init__(self, names: Sequence[str], digits: int) -> None:
        super().__init__()
        self._names, self._digits = names, digits

    @abstractmethod
    def _bracketed(self, operand: Signed) -> str:
        """Return a part in brackets."""

    def _factor(self, operand: Signed) -> str:
        """Return what stands behind a factor."""
        return self._bracketed(operand) if operand.form.kind is Kind.PRODUCT else self.plain(operand)

    def _open(self, operand: Signed) -> str:
        """Return a part that what is around it closes."""
        return (
            self.signed(operand.form.parts[0])
            if operand.form.kind is Kind.GROUP and not operand.negative
            else self.signed(operand)
        )

    def _base(self, operand: Signed) -> str:
        return self.plain(operand) if _stands_alone(operand) else self._bracketed(operand)


class _Latex(_Typeset):
    """Writes forms as LaTeX: quotients as fractions, natural powers raised, one blank between factors."""

    def negative(self, operand: str) -> str:
        return f"- {operand}"

    def of(self, form: Form) -> str:
        match form.kind:
            case Kind.NAME:
                return _latex_name(self._names[form.index])
            case Kind.NUMBER:
                mantissa, power = _number(form.number[0], self._digits)
                return rf"{mantissa} \cdot 10^{{{power}}}" if power else mantissa
            case Kind.CALL:
                return self._called(form)
            case Kind.GROUP:
                return self._bracketed(form.parts[0])
            case Kind.SUM:
                first, *rest = form.terms
                signs = (f" {'-' if operand.negative else '+'} {self.plain(operand)}" for operand in rest)
                return "".join([self.signed(first), *signs])
            case Kind.PRODUCT:
                left, right = form.parts
                times = r" \cdot " if _begins_with_number(right) else " "
                return f"{self.plain(left)}{times}{self._factor(right)}"
            case Kind.QUOTIENT:
                return rf"\frac{{{self._open(form.parts[0])}}}{{{self._open(form.parts[1])}}}"
            case Kind.NATURAL:
                return f"{self._base(form.parts[0])}^{{{form.exponent}}}"
            case Kind.POWER:
                base, exponent = form.parts
                return f"{self._base(base)}^{{{self._open(exponent)}}}"

    def _called(self, form: Form) -> str:
        (argument,) = form.parts
        if form.code == SQRT:
            return rf"\sqrt{{{self.signed(argument)}}}"
        if form.code == ABS:
            return rf"\left|{self.signed(argument)}\right|"
        return rf"\{INFIX.call(form.code)}{self._bracketed(argument)}"

    def _bracketed(self, operand: Signed) -> str:
        return rf"\left({self.signed(operand)}\right)"


class _MathML(_Typeset):
    """Writes forms as presentation MathML, each as one element."""

    def __init__(self, names: Sequence[str], digits: int) -> None:
        super().__init__(names, digits)
        self._times = "<mo>\u00b7</mo>" if any(len(name) > 1 for name in names) else "<mo>\u2062</mo>"

    def negative(self, operand: str) -> str:
        return f"<mrow><mo>-</mo>{operand}</mrow>"

    def of(self, form: Form) -> str:
        match form.kind:
            case Kind.NAME:
                return _mathml_name(self._names[form.index])
            case Kind.NUMBER:
                mantissa, power = _number(form.number[0], self._digits)
                raised = f"<msup><mn>10</mn><mn>{power}</mn></msup>"
                return f"<mrow><mn>{mantissa}</mn><mo>\u00b7</mo>{raised}</mrow>" if power else f"<mn>{mantissa}</mn>"
            case Kind.CALL:
                return self._called(form)
            case Kind.GROUP:
                return self._bracketed(form.parts[0])
            case Kind.SUM:
                first, *rest = form.terms
                signs = (f"<mo>{'-' if operand.negative else '+'}</mo>{self.plain(operand)}" for operand in rest)
                return f"<mrow>{''.join([self.signed(first), *signs])}</mrow>"
            case Kind.PRODUCT:
                left, right = form.parts
                times = "<mo>\u00b7</mo>" if _begins_with_number(right) else self._times
                return f"<mrow>{self.plain(left)}{times}{self._factor(right)}</mrow>"
            case Kind.QUOTIENT:
                return f"<mfrac>{self._open(form.parts[0])}{self._open(form.parts[1])}</mfrac>"
            case Kind.NATURAL:
                return f"<msup>{self._base(form.parts[0])}<mn>{form.exponent}</mn></msup>"
            case Kind.POWER:
                base, exponent = form.parts
                return f"<msup>{self._base(base)}{self._open(exponent)}</msup>"

    def _called(self, form: Form) -> str:
        (argument,) = form.parts
        if form.code == SQRT:
            return f"<msqrt>{self.signed(argument)}</msqrt>"
        if form.code == ABS:
            return f"<mrow><mo>|</mo>{self.signed(argument)}<mo>|</mo></mrow>"
        return f"<mrow><mi>{INFIX.call(form.code)}</mi><mo>\u2061</mo>{self._bracketed(argument)}</mrow>"

    def _bracketed(self, operand: Signed) -> str:
        return f"<mrow><mo>(</mo>{self.signed(operand)}<mo>)</mo></mrow>"


def _stands_alone(operand: Signed) -> bool:
    """Tell whether a part may be raised to a power without brackets."""
    is_digits = operand.is_constant and "e" not in f"{operand.form.number[0]:g}"
    return not operand.negative and (operand.is_atom or is_digits)


def _begins_with_number(operand: Signed) -> bool:
    """Tell whether digits stand first in a factor that is no product of its own."""
    return operand.is_constant or (
        operand.form.kind in (Kind.NATURAL, Kind.POWER) and operand.form.parts[0].is_constant
    )


def _number(value: float, digits: int) -> tuple[str, str]:
    """Return the digits of a number, and the power of ten that they are times, "" for none."""
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    return mantissa, str(int(power)) if power else ""


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


def _mathml_name(name: str) -> str:
    """Return a name as an element: letters of Greek and indices as such, what is no identifier as it stands."""
    import sympy
    from sympy.printing.mathml import mathml

    if not re.fullmatch(r"\w+", name):
        return f"<mi>{escape(name)}</mi>"
    text = mathml(sympy.Symbol(name), printer="presentation")
    return _HTML_ENTITY.sub(lambda entity: unescape(entity[0]), text)


def left_side_to_mathml(lhs: str, *, is_name: bool = False) -> str:
    """Return ``dx/dt`` and ``d2x/dt2`` as fractions of MathML, other left-hand sides, and what `is_name`, as names."""
    order, *names = (0, lhs, "") if is_name else _derivative(lhs)
    above, below = (_mathml_name(name) if name else "" for name in names)
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
