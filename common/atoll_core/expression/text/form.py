"""The written form of a program: in which order, with which signs, powers, quotients and brackets it is written.

All writings are made of it: infix text, the expressions of other languages, LaTeX, MathML, sympy objects. Only such
rewritings are used as IEEE 754 keeps to the bit: the operands of + and * swapped, signs moved, a*a as a**2, a + a as
2.0*a, sin(a)/cos(a) as tan(a). They are made of operators and operands: what a variable is called plays no part.
"""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import Any, Final, Generic, TypeVar

from atoll_core.expression.operators import (
    ADD,
    ARITY,
    BASE_LOG,
    CONSTANT,
    COS,
    DIVIDE,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    SIN,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import LARGEST_POWER

TANGENT: Final = -1
COTANGENT: Final = -2
"""Codes of the quotients of sine and cosine, beside those of operators."""
_QUOTIENTS: Final = {(SIN, COS): TANGENT, (COS, SIN): COTANGENT}


class Kind(Enum):
    """What a form is."""

    NAME = "a variable"
    NUMBER = "a number, its sign left out"
    CALL = "a function of one argument"
    GROUP = "a sum in brackets"
    SUM = "terms, each with its sign"
    PRODUCT = "a factor times another"
    QUOTIENT = "a factor over another"
    NATURAL = "a natural power, which means repeated multiplication from the left"
    POWER = "any other power"


@dataclass(frozen=True, eq=False, slots=True)
class Form:
    """A part as it is written, without its sign. Equal parts of one program are one object.

    `parts` are the signed operands: of a sum its terms, of a product, a quotient or a power both of its sides (a
    natural one has its base alone). `index` is that of a variable, `code` that of a function or of a quotient of
    functions, `exponent` that of a natural power, `value` that of a number, which may have a `name`; -1, 0.0 and ""
    stand for what a kind does not have.
    """

    kind: Kind
    parts: "tuple[Signed, ...]" = ()
    index: int = -1
    code: int = -1
    exponent: int = -1
    value: float = 0.0
    name: str = ""

    @property
    def terms(self) -> "tuple[Signed, ...]":
        """The terms of a sum in the order of reading: the first is positive where that keeps every bit."""
        first, *rest = self.parts
        if rest and first.negative and not rest[0].negative:
            return (rest[0], first, *rest[1:])
        return self.parts


@dataclass(frozen=True, slots=True)
class Signed:
    """A form; the value is that of its negative where it is `negative`."""

    form: Form
    negative: bool = False

    @property
    def is_constant(self) -> bool:
        """Whether it is a number."""
        return self.form.kind is Kind.NUMBER

    @property
    def is_product(self) -> bool:
        """Whether it is a product or a quotient, which begins with a factor."""
        return self.form.kind in (Kind.PRODUCT, Kind.QUOTIENT)

    @property
    def is_atom(self) -> bool:
        """Whether it is one thing, or stands in brackets of its own."""
        return self.form.kind in (Kind.NAME, Kind.CALL, Kind.GROUP)


@dataclass(frozen=True, eq=False)
class Written:
    """The form of a whole program: all its parts, operands before what they are operands of, and the `whole`."""

    parts: tuple[Form, ...]
    whole: Signed


Output = TypeVar("Output")


class Renderer(ABC, Generic[Output]):
    """Writes forms as something, operands before what they are operands of, so that no depth is too great."""

    def __init__(self) -> None:
        self._done: dict[Form, Output] = {}

    def render(self, written: Written) -> Output:
        """Return what a whole program is written as."""
        for form in written.parts:
            self._done[form] = self.of(form)
        return self.signed(written.whole)

    def signed(self, operand: Signed) -> Output:
        """Return an operand, which was written before, with its sign."""
        return self.negative(self._done[operand.form]) if operand.negative else self._done[operand.form]

    def plain(self, operand: Signed) -> Output:
        """Return an operand, which was written before, without its sign."""
        return self._done[operand.form]

    @abstractmethod
    def negative(self, operand: Output) -> Output:
        """Return the negative of what was written."""

    @abstractmethod
    def of(self, form: Form) -> Output:
        """Return a form, whose operands were written before, without its sign."""


def form_of(
    program: Program,
    constants: Mapping[int, str] = MappingProxyType({}),
    *,
    quotients: frozenset[int] = frozenset({TANGENT, COTANGENT}),
) -> Written:
    """Return the form of a program; parts that are used twice are written twice.

    `constants` are the names of those that have one, by node; `quotients` what the language has of `TANGENT` and
    `COTANGENT`.
    """
    writer = _Writer(quotients)
    operands: list[Signed] = []
    for place, (code, left, right, value) in enumerate(program.nodes()):
        if code == VARIABLE:
            operands.append(Signed(writer.form(Kind.NAME, index=left)))
        elif code == CONSTANT:
            operands.append(writer.number(value, constants.get(place, "")))
        elif ARITY[code] == 2:
            operands.append(writer.binary(code, operands[left], operands[right]))
        else:
            operands.append(writer.unary(code, operands[left]))
    return Written(tuple(_needed(writer.forms, operands[-1].form)), operands[-1])


def _needed(forms: dict[Hashable, Form], whole: Form) -> Iterator[Form]:
    """Yield the forms that a whole is made of, operands first."""
    needed = {whole}
    for form in reversed(forms.values()):
        if form in needed:
            needed.update(part.form for part in form.parts)
    yield from (form for form in forms.values() if form in needed)


@dataclass(frozen=True)
class _Writer:
    """Makes forms, each but once, in the order in which they are needed."""

    quotients: frozenset[int]
    forms: dict[Hashable, Form] = field(default_factory=dict)

    def form(self, kind: Kind, *parts: Signed, **content: Any) -> Form:
        key = (kind, parts, *sorted(content.items()))
        if key not in self.forms:
            self.forms[key] = Form(kind, parts, **content)
        return self.forms[key]

    def number(self, value: float, name: str = "") -> Signed:
        """Return a constant; of one that has a name the sign is part of what is named."""
        if name:
            return Signed(self.form(Kind.NUMBER, value=value, name=name))
        is_negative = value.hex().startswith("-")  # also of zero
        return Signed(self.form(Kind.NUMBER, value=abs(value), name=""), is_negative)

    def binary(self, code: int, left: Signed, right: Signed) -> Signed:
        if code == ADD:
            return self._multiplied(self.number(2.0), left) if left == right else self._added(left, right)
        if code == SUBTRACT:
            return self._added(left, self._negated(right))
        if code == MULTIPLY:
            return self._multiplied(left, right)
        if code == DIVIDE:
            return self._divided(left, right)
        if code == BASE_LOG:  # in derivatives by an exponent; the power beside it tells where it is 0
            return self.unary(LOG, left)
        return Signed(self.form(Kind.POWER, left, right))

    def unary(self, code: int, operand: Signed) -> Signed:
        if code == NEGATE:
            return self._negated(operand)
        if code == SQUARE:
            return self._multiplied(operand, operand)
        if code == INVERSE:
            return self._divided(self.number(1.0, "1"), operand)
        return Signed(self.form(Kind.CALL, operand, code=code))

    def _grouped(self, operand: Signed) -> Signed:
        """Return a sum in brackets, anything else as it is."""
        return Signed(self.form(Kind.GROUP, operand)) if operand.form.kind is Kind.SUM else operand

    def _negated(self, operand: Signed) -> Signed:
        # Not term by term: -(a - b) and b - a differ in the sign of zero.
        operand = self._grouped(operand)
        return Signed(operand.form, not operand.negative)

    def _added(self, left: Signed, right: Signed) -> Signed:
        if right.form.kind is Kind.SUM and left.form.kind is not Kind.SUM:
            left, right = right, left
        terms = left.form.parts if left.form.kind is Kind.SUM else (left,)
        return Signed(self.form(Kind.SUM, *terms, self._grouped(right)))

    def _multiplied(self, left: Signed, right: Signed) -> Signed:
        left, right, is_negative = self._operands(left, right)
        power = self._natural_power(left, right)
        if power is not None:
            return Signed(power, is_negative)
        if not left.is_constant and (right.is_constant or (right.is_product and not left.is_product)):
            left, right = right, left
        return Signed(self.form(Kind.PRODUCT, left, right), is_negative)

    def _divided(self, left: Signed, right: Signed) -> Signed:
        left, right, is_negative = self._operands(left, right)
        above, below = left.form, right.form
        code = _QUOTIENTS.get((above.code, below.code)) if above.kind is below.kind is Kind.CALL else None
        if code in self.quotients and above.parts == below.parts:
            return Signed(self.form(Kind.CALL, *above.parts, code=code), is_negative)
        return Signed(self.form(Kind.QUOTIENT, left, right), is_negative)

    def _operands(self, left: Signed, right: Signed) -> tuple[Signed, Signed, bool]:
        """Return both without their signs, and the sign of their product or quotient."""
        left, right = self._grouped(left), self._grouped(right)
        return Signed(left.form), Signed(right.form), left.negative != right.negative

    def _natural_power(self, left: Signed, right: Signed) -> Form | None:
        """Return a product as a natural power; None where it is none that is read as the same product."""
        if left.is_constant or right.is_constant:
            return None
        if left == right:
            return self.form(Kind.NATURAL, left, exponent=2)
        for power, factor in ((left.form, right), (right.form, left)):
            is_next = power.kind is Kind.NATURAL and power.parts == (factor,) and factor.is_atom
            if is_next and power.exponent < LARGEST_POWER:
                return self.form(Kind.NATURAL, factor, exponent=power.exponent + 1)
        return None
