"""Print programs as infix text that our parser (`atoll_core.expression.text.parsing`) and sympy read alike.

Two manners. *Exact* (the default): parsing the text gives the same bits on every row, because the form that is written
(`atoll_core.expression.text.form`) keeps them. *Display* (``digits``): the shortest writing
(`atoll_core.expression.writing`) with rounded constants.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll_core.expression.operators import ADD, ARITY, FUNCTIONS, MULTIPLY
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.text.form import COTANGENT, TANGENT, Form, Kind, Renderer, Signed, Written, form_of


@dataclass(frozen=True)
class Notation:
    """How one language writes functions and powers; the rest, + - * / with brackets, is the same in all languages.

    `functions` are names by operator code, where they differ from ours, and `prefix` stands before those that do not.
    `power` writes a base and an exponent, `natural` a base and a natural number. A power `is_call` where that is a
    function call, whose arguments need no brackets. `tangent` and `cotangent` name the quotients of sine and cosine;
    empty: there is no such function, and the quotient is written.
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
        ours = FUNCTIONS | {TANGENT: self.tangent, COTANGENT: self.cotangent}
        return self.functions.get(code) or self.prefix + ours[code]

    @property
    def quotients(self) -> frozenset[int]:
        """The codes of the quotients of sine and cosine that have a name."""
        return frozenset(code for code, name in ((TANGENT, self.tangent), (COTANGENT, self.cotangent)) if name)


INFIX: Final = Notation(power="{0}**{1}", natural="{0}**{1}", cotangent="cot")
"""That of Atoll's own expressions, which our parser and sympy read."""

PRINTABLE_SIZE: Final = 5_000
"""Largest tree that is printed. Shared nodes are printed once per use, so a short list can be a huge text."""


def to_infix(program: Program, names: Sequence[str], *, digits: int | None = None) -> str:
    """Return `program` as infix text over `names`, the symbols of the V input variables.

    With `digits`, the significant ones of constants, it is for display; else exactly what is computed. Raises
    ValueError when the text would have more than `PRINTABLE_SIZE` operations (see `tree_size`).
    """
    if digits is None:
        return _Text(names, repr).render(exact_form(program))
    return _Text(names, lambda value: f"{value:.{digits}g}").render(displayed_form(program, digits))


def exact_form(program: Program) -> Written:
    """Return how `program` is written to the bit; raises ValueError when it is too large."""
    _check_size(program)
    return form_of(program)


def displayed_form(program: Program, digits: int) -> Written:
    """Return how `program` is shown with so many significant digits; raises ValueError when it is too large."""
    _check_size(program)
    # Imported here: what is printed to the bit needs none of it.
    from atoll_core.expression.writing.shortest import shortest

    short = shortest(program)
    values = {place: float(f"{short.constants[place]:.{digits}g}") for place in constant_places(short)}
    return form_of(shortest(with_constants(short, values)))


def to_code(program: Program, names: Sequence[str], notation: Notation, constants: Mapping[int, str]) -> str:
    """Return `program` as an expression of another language, exactly as it is computed.

    `names` is what it calls the V input variables, `constants` those constants that have a name, by node; all others
    are written with all their digits. Raises ValueError as `to_infix` does.
    """
    _check_size(program)
    return _Text(names, repr, notation).render(form_of(program, constants, quotients=notation.quotients))


def _check_size(program: Program) -> None:
    size = tree_size(program)
    if size > PRINTABLE_SIZE:
        raise ValueError(f"an expression of {size} operations is too long to print; at most {PRINTABLE_SIZE} are")


def tree_size(program: Program) -> int:
    """Return the number of nodes of `program` printed as a tree; both operands of a*a and a + a count once."""
    sizes: list[int] = []
    for code, left, right, _ in program.nodes():
        size = 1
        if ARITY[code]:
            size += sizes[left]
        if ARITY[code] == 2 and (left != right or code not in (ADD, MULTIPLY)):
            size += sizes[right]
        sizes.append(size)
    return sizes[-1]


class _Text(Renderer[str]):
    """Writes forms as text of one notation."""

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
