"""Expressions for other programs: sympy objects, LaTeX and MathML. sympy is imported only for sympy objects.

In LaTeX and MathML, the order of terms and factors, the signs, the powers and the brackets are the same as in the infix
text.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, cast

from atoll_core.expression.operators import ABS, SQRT
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import INFIX, Form, Kind, Renderer, Signed, displayed_form, exact_form
from atoll_core.expression.text.names import name_to_latex, name_to_mathml

if TYPE_CHECKING:
    import sympy

_LATEX_ESCAPES: Final = {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"} | {
    letter: f"\\{letter}" for letter in "{}$%#&_"
}

_LATEX_UNITS: Final = {" ": r"\ ", "°": r"{}^{\circ}", "µ": r"\mu ", "μ": r"\mu ", "Ω": r"\Omega "}
_UNKNOWN: Final = re.compile(r"\?(\d*)")
"""The name of an unknown part of a given equation."""
GIVEN_DIGITS: Final = 15
"""Significant digits that every floating-point number keeps, so that a given number is displayed as it was written."""
_RAISED: Final = "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺"
_LOWERED: Final = str.maketrans(_RAISED, "0123456789-+")
_UNIT_PART: Final = re.compile(
    rf"(?:\^|\*\*)(?P<power>[-+]?\d[\d.]*)|(?P<raised>[{_RAISED}]+)|(?P<times>[*·⋅×])|(?P<words>[^*·⋅×^{_RAISED}]+|\^)"
)
"""A power, a product, or other text."""


Parts = Mapping[int, tuple[str, Program]]
"""Labels and programs that are written for variables, by index: a brace with the label is below the program."""
_NO_PARTS: Final[Parts] = MappingProxyType({})


def to_sympy(program: Program, names: Sequence[str]) -> "sympy.Expr":
    """Return `program` as a sympy expression over ``Symbol(name)`` for each of `names`; constants have the same bits.

    sympy reorders terms and joins constants, so the values of both agree only up to rounding errors.
    """
    return _Sympy(names).render(exact_form(program))


def to_latex(
    program: Program, names: Sequence[str], *, digits: int = 6, is_given: bool = False, parts: Parts = _NO_PARTS
) -> str:
    """Return `program` as LaTeX mathematics, in the form of `to_infix`. Constants have `digits` significant digits.

    Factors are separated by a space if a name is a word. `is_given` is as in `to_infix`. The variables of `parts` come
    after the `names`.
    """
    has_words = any(r"\mathrm" in name or r"\text" in name for name in map(_latex_name, names))
    return _Typeset(_LATEX, names, digits, r" \, " if has_words else " ", parts).typeset(program, is_given=is_given)


def to_mathml(
    program: Program, names: Sequence[str], *, digits: int = 6, is_given: bool = False, parts: Parts = _NO_PARTS
) -> str:
    """Return `program` as presentation MathML without its ``math`` element, in the form of `to_infix`.

    Factors are separated by dots if a name has several letters, and before numbers. The other arguments are as in
    `to_latex`.
    """
    times = _MATHML.dot if any(len(name) > 1 for name in names) else "<mo>\u2062</mo>"
    return _Typeset(_MATHML, names, digits, times, parts).typeset(program, is_given=is_given)


class _Sympy(Renderer["sympy.Expr"]):
    """Renders forms as sympy objects; names may be any column names."""

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
                return sympy.Integer(1) if form.name else sympy.Float(repr(form.value))
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


class _Markup(NamedTuple):
    """Templates of a markup language, and a function that writes a `name`.

    The template `scaled` is for a number times a power of ten, `addend` for a sign and a term, and `product` for a
    factor, a multiplication sign and a factor; `braced` for an expression above a brace and a label. `derivatives` has
    one template for each order of a derivative (0, 1, 2). The template writes a left-hand side from its function and
    variable.
    """

    name: Callable[[str], str]
    number: str
    scaled: str
    negative: str
    bracketed: str
    sum: str
    addend: str
    product: str
    dot: str
    quotient: str
    power: str
    root: str
    magnitude: str
    call: str
    braced: str
    derivatives: tuple[str, str, str]


class _Typeset(Renderer[str]):
    """Renders forms in a markup language: quotients as fractions, powers raised.

    `digits` are the significant digits of constants; `times` is the multiplication sign between factors that are not
    numbers. `parts` are written for some variables.
    """

    def __init__(self, markup: _Markup, names: Sequence[str], digits: int, times: str, parts: Parts) -> None:
        super().__init__()
        self._parts = parts
        self._markup, self._names, self._digits, self._times = markup, names, digits, times

    def typeset(self, program: Program, *, is_given: bool) -> str:
        """Return a program as markup."""
        return self.render(displayed_form(program, self._digits, is_given=is_given))

    def negative(self, operand: str) -> str:
        return self._markup.negative.format(operand)

    def of(self, form: Form) -> str:
        markup = self._markup
        match form.kind:
            case Kind.NAME:
                return self._variable(form.index)
            case Kind.NUMBER:
                mantissa, _, power = f"{form.value:.{self._digits}g}".partition("e")
                return markup.scaled.format(mantissa, int(power)) if power else markup.number.format(mantissa)
            case Kind.CALL:
                return self._called(form.code, form.parts[0])
            case Kind.GROUP:
                return self._bracketed(form.parts[0])
            case Kind.SUM:
                first, *rest = form.terms
                addends = (markup.addend.format("-" if term.negative else "+", self.plain(term)) for term in rest)
                return markup.sum.format("".join([self.signed(first), *addends]))
            case Kind.PRODUCT:
                left, right = form.parts
                times = markup.dot if _begins_with_number(right) else self._times
                factor = self._bracketed(right) if right.form.kind is Kind.PRODUCT else self.plain(right)
                return markup.product.format(self.plain(left), times, factor)
            case Kind.QUOTIENT:
                return markup.quotient.format(*map(self._open, form.parts))
            case Kind.NATURAL:
                return markup.power.format(self._base(form.parts[0]), markup.number.format(form.exponent))
            case Kind.POWER:
                base, exponent = form.parts
                return markup.power.format(self._base(base), self._open(exponent))

    def _variable(self, index: int) -> str:
        if index not in self._parts:
            return self._markup.name(self._names[index])
        label, part = self._parts[index]
        inside = _Typeset(self._markup, self._names, self._digits, self._times, _NO_PARTS)
        return self._markup.braced.format(inside.typeset(part, is_given=True), label)

    def _called(self, code: int, argument: Signed) -> str:
        if code == SQRT:
            return self._markup.root.format(self.signed(argument))
        if code == ABS:
            return self._markup.magnitude.format(self.signed(argument))
        return self._markup.call.format(INFIX.call(code), self._bracketed(argument))

    def _bracketed(self, operand: Signed) -> str:
        return self._markup.bracketed.format(self.signed(operand))

    def _open(self, operand: Signed) -> str:
        """Return a part that needs no brackets in its position."""
        is_group = operand.form.kind is Kind.GROUP and not operand.negative
        return self.signed(operand.form.parts[0] if is_group else operand)

    def _base(self, operand: Signed) -> str:
        is_digits = operand.is_constant and "e" not in f"{operand.form.value:g}"
        stands_alone = not operand.negative and (operand.is_atom or is_digits)
        return self.plain(operand) if stands_alone else self._bracketed(operand)


def _begins_with_number(operand: Signed) -> bool:
    """Tell whether a factor begins with digits."""
    return operand.is_constant or (
        operand.form.kind in (Kind.NATURAL, Kind.POWER) and operand.form.parts[0].is_constant
    )


def _latex_name(name: str) -> str:
    """Return a name as mathematics; words are upright, since adjacent italic letters mean a product.

    A name that is not an identifier becomes text, with special characters escaped.
    """
    unknown = _UNKNOWN.fullmatch(name)
    if unknown is not None:
        return rf"\boxed{{?}}_{{{unknown[1]}}}" if unknown[1] else r"\boxed{?}"
    if re.fullmatch(r"\w*", name):
        return name_to_latex(name) if name else ""
    return rf"\text{{{_latex_escaped(name)}}}"


def _latex_escaped(text: str) -> str:
    return "".join(_LATEX_ESCAPES.get(letter, letter) for letter in text)


def unit_to_latex(unit: str) -> str:
    """Return a unit, such as ``m/s^2`` or ``kg·m⁻¹``, as LaTeX mathematics with upright letters."""
    return _UNIT_PART.sub(_unit_part, unit)


def _unit_part(part: re.Match[str]) -> str:
    power = part["power"] or part["raised"]
    if power:
        return f"^{{{power.translate(_LOWERED)}}}"
    if part["times"]:
        return r"\,"
    words = "".join(_LATEX_UNITS.get(letter, _latex_escaped(letter)) for letter in part["words"])
    return rf"\mathrm{{{words}}}"


def _mathml_name(name: str) -> str:
    """Return a name as an element, with Greek letters and indices. A name that is not an identifier is not changed.

    The question mark of an unknown part has the class ``unknown``, so that pages can draw a box around it.
    """
    unknown = _UNKNOWN.fullmatch(name)
    if unknown is not None:
        mark = '<mi class="unknown">?</mi>'
        return f"<msub>{mark}<mn>{unknown[1]}</mn></msub>" if unknown[1] else mark
    return name_to_mathml(name) if re.fullmatch(r"\w+", name) else f"<mi>{escape(name)}</mi>"


_LATEX: Final = _Markup(
    name=_latex_name,
    number="{}",
    scaled=r"{} \cdot 10^{{{}}}",
    negative="- {}",
    bracketed=r"\left({}\right)",
    sum="{}",
    addend=" {} {}",
    product="{}{}{}",
    dot=r" \cdot ",
    quotient=r"\frac{{{}}}{{{}}}",
    power="{}^{{{}}}",
    root=r"\sqrt{{{}}}",
    magnitude=r"\left|{}\right|",
    call=r"\{}{}",
    braced=r"\underbrace{{{}}}_{{{}}}",
    derivatives=("{}", r"\frac{{d {}}}{{d {}}}", r"\frac{{d^{{2}} {}}}{{d {}^{{2}}}}"),
)
_MATHML: Final = _Markup(
    name=_mathml_name,
    number="<mn>{}</mn>",
    scaled="<mrow><mn>{}</mn><mo>\u00b7</mo><msup><mn>10</mn><mn>{}</mn></msup></mrow>",
    negative="<mrow><mo>-</mo>{}</mrow>",
    bracketed="<mrow><mo>(</mo>{}<mo>)</mo></mrow>",
    sum="<mrow>{}</mrow>",
    addend="<mo>{}</mo>{}",
    product="<mrow>{}{}{}</mrow>",
    dot="<mo>\u00b7</mo>",
    quotient="<mfrac>{}{}</mfrac>",
    power="<msup>{}{}</msup>",
    root="<msqrt>{}</msqrt>",
    magnitude="<mrow><mo>|</mo>{}<mo>|</mo></mrow>",
    call="<mrow><mi>{}</mi><mo>\u2061</mo>{}</mrow>",
    braced='<munder><munder><mrow>{}</mrow><mo stretchy="true">\u23df</mo></munder><mtext>{}</mtext></munder>',
    derivatives=(
        "{}",
        "<mfrac><mrow><mi>d</mi>{}</mrow><mrow><mi>d</mi>{}</mrow></mfrac>",
        "<mfrac><mrow><msup><mi>d</mi><mn>2</mn></msup>{}</mrow><mrow><mi>d</mi><msup>{}<mn>2</mn></msup></mrow></mfrac>",
    ),
)


def left_side_to_latex(lhs: str, *, is_name: bool = False) -> str:
    """Return a left-hand side as LaTeX: ``dx/dt`` and ``d2x/dt2`` as fractions, and all others as names. If `is_name`,
    each left-hand side is a name."""
    return _left_side(_LATEX, lhs, is_name)


def left_side_to_mathml(lhs: str, *, is_name: bool = False) -> str:
    """Return a left-hand side as MathML, as `left_side_to_latex` does."""
    return _left_side(_MATHML, lhs, is_name)


def _left_side(markup: _Markup, lhs: str, is_name: bool) -> str:
    order, *names = (0, lhs) if is_name else _derivative(lhs)
    return markup.derivatives[order].format(*(markup.name(name) if name else "" for name in names))


def _derivative(lhs: str) -> tuple[int, str] | tuple[int, str, str]:
    """Return the order of a derivative, its function and its variable. For other left-hand sides, return order 0 and
    the name."""
    for order, pattern in ((2, "d2(.*)/d([^/]*)2"), (1, "d(.*)/d([^/]*)")):
        match = re.fullmatch(pattern, lhs, re.DOTALL)
        if match:
            return order, match[1], match[2]
    return 0, lhs
