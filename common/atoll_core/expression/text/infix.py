"""Programs as text. The order of terms, signs, powers, quotients and brackets is the same in all notations.

`form_of` turns a program into a `Written` form; infix text, code of other languages, LaTeX, MathML and sympy objects
are all rendered from it (`Renderer`). The form uses only rewritings that IEEE 754 keeps to the bit: swapping the
operands of + and *, moving signs, a*a as a**2, a + a as 2.0*a, sin(a)/cos(a) as tan(a). The form does not depend on the
names of variables.

There are two variants of text. *Exact* (the default): the program that is parsed from this text
(`atoll_core.expression.text.parsing`) gives the same bits on every row; sympy also reads the text. *Display* (with
``digits``): the shortest writing (`atoll_core.expression.writing`) with rounded constants.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import Any, Final, Generic, TypeVar

from atoll_core.expression import operators as op
from atoll_core.expression.program import Program, constant_places, tree_size, with_constants
from atoll_core.expression.text.parsing import LARGEST_POWER

TANGENT: Final = -1
COTANGENT: Final = -2
"""Codes of the quotients of sine and cosine, in addition to the codes of operators."""
_QUOTIENTS: Final = {(op.SIN, op.COS): TANGENT, (op.COS, op.SIN): COTANGENT}


class Kind(Enum):
    """Kind of a form."""

    NAME = "a variable"
    NUMBER = "a number without its sign"
    CALL = "a function of one argument"
    GROUP = "a sum in brackets"
    SUM = "terms, each with its sign"
    PRODUCT = "a factor times another"
    QUOTIENT = "a factor over another"
    NATURAL = "a natural power, which means repeated multiplication from the left"
    POWER = "any other power"


@dataclass(frozen=True, eq=False, slots=True)
class Form:
    """A written part without its sign. Equal parts of one program are one object.

    `parts` are the signed operands: the terms of a sum, both sides of a product, quotient or power, or the base of a
    natural power. The other fields belong to certain kinds: `index` to a variable, `code` to a function or a quotient
    of functions, `exponent` to a natural power, and `value` to a number, which may have a `name`. In forms of other
    kinds, these fields are -1, 0.0 and "".
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
        """The terms of a sum in reading order. The first term is positive if this order does not change a bit of the
        value."""
        first, *rest = self.parts
        if rest and first.negative and not rest[0].negative:
            return (rest[0], first, *rest[1:])
        return self.parts


@dataclass(frozen=True, slots=True)
class Signed:
    """A form with its sign."""

    form: Form
    negative: bool = False

    @property
    def is_constant(self) -> bool:
        """Whether the form is a number."""
        return self.form.kind is Kind.NUMBER

    @property
    def is_product(self) -> bool:
        """Whether the form is a product or a quotient."""
        return self.form.kind in (Kind.PRODUCT, Kind.QUOTIENT)

    @property
    def is_atom(self) -> bool:
        """Whether the form is a name, or has brackets around it."""
        return self.form.kind in (Kind.NAME, Kind.CALL, Kind.GROUP)


@dataclass(frozen=True, eq=False)
class Written:
    """The form of a whole program: all its parts, operands first, and the `whole`."""

    parts: tuple[Form, ...]
    whole: Signed


Output = TypeVar("Output")


class Renderer(ABC, Generic[Output]):
    """Renders forms, operands first. There is no recursion, so the depth of a form is not limited."""

    def __init__(self) -> None:
        self._done: dict[Form, Output] = {}

    def render(self, written: Written) -> Output:
        """Return the rendered program."""
        for form in written.parts:
            self._done[form] = self.of(form)
        return self.signed(written.whole)

    def signed(self, operand: Signed) -> Output:
        """Return a rendered operand with its sign."""
        return self.negative(self._done[operand.form]) if operand.negative else self._done[operand.form]

    def plain(self, operand: Signed) -> Output:
        """Return a rendered operand without its sign."""
        return self._done[operand.form]

    @abstractmethod
    def negative(self, operand: Output) -> Output:
        """Return the negative of a rendered operand."""

    @abstractmethod
    def of(self, form: Form) -> Output:
        """Return the rendered form, without its sign; its operands are rendered already."""


def form_of(
    program: Program,
    constants: Mapping[int, str] = MappingProxyType({}),
    *,
    quotients: frozenset[int] = frozenset({TANGENT, COTANGENT}),
) -> Written:
    """Return the form of a program. If a part is used twice, it is written twice.

    `constants` are the names of named constants, by node. `quotients` has `TANGENT` and `COTANGENT`, if the language
    has these functions.
    """
    writer = _Writer(quotients)
    operands: list[Signed] = []
    for place, (code, left, right, value) in enumerate(program.nodes()):
        if code == op.VARIABLE:
            operands.append(Signed(writer.form(Kind.NAME, index=left)))
        elif code == op.CONSTANT:
            operands.append(writer.number(value, constants.get(place, "")))
        elif op.ARITY[code] == 2:
            operands.append(writer.binary(code, operands[left], operands[right]))
        else:
            operands.append(writer.unary(code, operands[left]))
    return Written(tuple(_needed(writer.forms, operands[-1].form)), operands[-1])


def _needed(forms: dict[Hashable, Form], whole: Form) -> Iterator[Form]:
    """Yield the forms that are parts of a whole, operands first."""
    needed = {whole}
    for form in reversed(forms.values()):
        if form in needed:
            needed.update(part.form for part in form.parts)
    yield from (form for form in forms.values() if form in needed)


@dataclass(frozen=True)
class _Writer:
    """Makes forms, each only once, operands first."""

    quotients: frozenset[int]
    forms: dict[Hashable, Form] = field(default_factory=dict)

    def form(self, kind: Kind, *parts: Signed, **content: Any) -> Form:
        key = (kind, parts, *sorted(content.items()))
        if key not in self.forms:
            self.forms[key] = Form(kind, parts, **content)
        return self.forms[key]

    def number(self, value: float, name: str = "") -> Signed:
        """Return a constant; the name of a named constant includes its sign."""
        if name:
            return Signed(self.form(Kind.NUMBER, value=value, name=name))
        is_negative = value.hex().startswith("-")  # -0.0 is also negative
        return Signed(self.form(Kind.NUMBER, value=abs(value), name=""), is_negative)

    def binary(self, code: int, left: Signed, right: Signed) -> Signed:
        if code == op.ADD:
            return self._multiplied(self.number(2.0), left) if left == right else self._added(left, right)
        if code == op.SUBTRACT:
            return self._added(left, self._negated(right))
        if code == op.MULTIPLY:
            return self._multiplied(left, right)
        if code == op.DIVIDE:
            return self._divided(left, right)
        # BASE_LOG occurs in derivatives with respect to an exponent. It is multiplied by a power, which is 0 if the
        # logarithm is infinite
        if code == op.BASE_LOG:
            return self.unary(op.LOG, left)
        return Signed(self.form(Kind.POWER, left, right))

    def unary(self, code: int, operand: Signed) -> Signed:
        if code == op.NEGATE:
            return self._negated(operand)
        if code == op.SQUARE:
            return self._multiplied(operand, operand)
        if code == op.INVERSE:
            return self._divided(self.number(1.0, "1"), operand)
        return Signed(self.form(Kind.CALL, operand, code=code))

    def _grouped(self, operand: Signed) -> Signed:
        """Return a sum in brackets. Other forms are returned unchanged."""
        return Signed(self.form(Kind.GROUP, operand)) if operand.form.kind is Kind.SUM else operand

    def _negated(self, operand: Signed) -> Signed:
        # The sign is not moved into the terms: -(a - b) and b - a differ in the sign of zero.
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
        """Return both operands without their signs, and the sign of their product or quotient."""
        left, right = self._grouped(left), self._grouped(right)
        return Signed(left.form), Signed(right.form), left.negative != right.negative

    def _natural_power(self, left: Signed, right: Signed) -> Form | None:
        """Return a product as a natural power. None if the parser would not read this power as the same product."""
        if left.is_constant or right.is_constant:
            return None
        if left == right:
            return self.form(Kind.NATURAL, left, exponent=2)
        for power, factor in ((left.form, right), (right.form, left)):
            is_next = power.kind is Kind.NATURAL and power.parts == (factor,) and factor.is_atom
            if is_next and power.exponent < LARGEST_POWER:
                return self.form(Kind.NATURAL, factor, exponent=power.exponent + 1)
        return None


@dataclass(frozen=True)
class Notation:
    """The functions and powers of one language; all languages write + - * / and brackets in the same way.

    `functions` has, by operator code, the names that differ from Atoll's names; `prefix` is put before all other names.
    The template `power` is for a base and an exponent, `natural` for a base and a natural number. `is_call`: a power is
    written as a function call, so its arguments need no brackets. `tangent` and `cotangent` are the names of the
    quotients of sine and cosine; empty: the language has no such function.
    """

    functions: Mapping[int, str] = field(default_factory=dict)
    prefix: str = ""
    power: str = "{0}^{1}"
    natural: str = "{0}^{1}"
    is_call: bool = False
    tangent: str = "tan"
    cotangent: str = ""

    def call(self, code: int) -> str:
        """Return the name of the function of an operator, or of a quotient of sine and cosine."""
        ours = op.FUNCTIONS | {TANGENT: self.tangent, COTANGENT: self.cotangent}
        return self.functions.get(code) or self.prefix + ours[code]

    @property
    def quotients(self) -> frozenset[int]:
        """The codes of the quotients of sine and cosine that have a name."""
        return frozenset(code for code, name in ((TANGENT, self.tangent), (COTANGENT, self.cotangent)) if name)


INFIX: Final = Notation(power="{0}**{1}", natural="{0}**{1}", cotangent="cot")
"""The notation of Atoll's own expressions, which Atoll's parser and sympy read."""

PRINTABLE_SIZE: Final = 5_000
"""Most operations of a printed expression. A shared node is printed once for each use, so a short list of nodes can
become a huge text."""


def to_infix(program: Program, names: Sequence[str], *, digits: int | None = None, is_given: bool = False) -> str:
    """Return `program` as infix text over `names`, the symbols of the V input variables.

    If `digits` are given (significant digits of constants), the text is for display; otherwise it is exact. A program
    that `is_given` by the user is displayed as it is, and not in the shortest writing. Raises ValueError if the text
    would have more than `PRINTABLE_SIZE` operations (see `tree_size`).
    """
    if digits is None:
        return _Text(names, repr).render(exact_form(program))
    form = displayed_form(program, digits, is_given=is_given)
    return _Text(names, lambda value: f"{value:.{digits}g}").render(form)


def exact_form(program: Program) -> Written:
    """Return the exact form of `program`; raises ValueError if it is too large."""
    _check_size(program)
    return form_of(program)


def displayed_form(program: Program, digits: int, *, is_given: bool = False) -> Written:
    """Return the form for display with this many significant digits; raises ValueError if `program` is too large.

    If the program `is_given`, it is not rewritten.
    """
    _check_size(program)
    if is_given:
        values = {place: float(f"{program.constants[place]:.{digits}g}") for place in constant_places(program)}
        return form_of(with_constants(program, values))
    # Imported here, because exact printing does not need this module.
    from atoll_core.expression.writing.shortest import shortest

    short = shortest(program)
    values = {place: float(f"{short.constants[place]:.{digits}g}") for place in constant_places(short)}
    return form_of(shortest(with_constants(short, values)))


def to_code(program: Program, names: Sequence[str], notation: Notation, constants: Mapping[int, str]) -> str:
    """Return `program` as an exact expression of another language.

    `names` are the names of the V input variables, `constants` the names of named constants, by node. All other
    constants are written with all digits. Raises ValueError as `to_infix` does.
    """
    _check_size(program)
    return _Text(names, repr, notation).render(form_of(program, constants, quotients=notation.quotients))


def _check_size(program: Program) -> None:
    size = tree_size(program)
    if size > PRINTABLE_SIZE:
        raise ValueError(f"an expression of {size} operations is too long to print; at most {PRINTABLE_SIZE} can be")


class _Text(Renderer[str]):
    """Renders forms as text of one notation."""

    def __init__(self, names: Sequence[str], number: Callable[[float], str], notation: Notation = INFIX) -> None:
        super().__init__()
        self._names, self._number, self._notation = names, number, notation

    def negative(self, operand: str) -> str:
        return f"-{operand}"

    def of(self, form: Form) -> str:
        match form.kind:
            case Kind.NAME:
                return self._names[form.index]
            case Kind.NUMBER:
                return form.name or self._number(form.value)
            case Kind.CALL:
                return f"{self._notation.call(form.code)}({self.signed(form.parts[0])})"
            case Kind.GROUP:
                return f"({self.signed(form.parts[0])})"
            case Kind.SUM:
                first, *rest = form.terms
                signs = (f" {'-' if operand.negative else '+'} {self.plain(operand)}" for operand in rest)
                return "".join([self.signed(first), *signs])
            case Kind.PRODUCT | Kind.QUOTIENT:
                sign = "*" if form.kind is Kind.PRODUCT else "/"
                return f"{self.plain(form.parts[0])}{sign}{self._factor(form.parts[1])}"
            case Kind.NATURAL:
                return self._notation.natural.format(self._base(form.parts[0]), form.exponent)
            case Kind.POWER:
                write = self.signed if self._notation.is_call else self._closed
                return self._notation.power.format(*map(write, form.parts))

    def _factor(self, operand: Signed) -> str:
        """Return the text of the right operand of * or /."""
        return f"({self.plain(operand)})" if operand.is_product else self.plain(operand)

    def _base(self, operand: Signed) -> str:
        """Return the text of the base of a natural power."""
        is_closed = operand.is_atom or (operand.form.kind is Kind.POWER and self._notation.is_call)
        return self.plain(operand) if is_closed else f"({self.plain(operand)})"

    def _closed(self, operand: Signed) -> str:
        """Return the text of an operand of ``**``."""
        is_closed = (operand.is_atom or operand.is_constant) and not operand.negative
        return self.signed(operand) if is_closed else f"({self.signed(operand)})"
