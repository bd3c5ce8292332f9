"""Print programs as infix text that our parser (`atoll_core.expression.text.parsing`) and sympy read alike.

Two manners. *Exact* (the default): parsing the text gives the same bits on every row, because the form that is written
(`atoll_core.expression.text.form`) keeps them. *Display* (``digits``): the shortest writing
(`atoll_core.expression.writing`) with rounded constants.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.text.form import Form, Kind, Renderer, Signed, Written, form_of
from atoll_core.expression.text.notation import INFIX, Notation

PRINTABLE_SIZE: Final = 5_000
"""Largest tree that is printed. Shared nodes are printed once per use, so a short list can be a huge text."""


def to_infix(program: Program, names: Sequence[str], *, digits: int | None = None) -> str:
    """Return `program` as infix text over `names`, the symbols of the V input variables.

    Args:
        program: any valid program.
        names: symbols, one for each input variable.
        digits: significant digits of constants, for display; None prints exactly what is computed.

    Raises:
        ValueError: the text would have more than `PRINTABLE_SIZE` operations (see `tree_size`).
    """
    if digits is None:
        return _text(exact_form(program), names, repr)
    return _text(displayed_form(program, digits), names, lambda value: f"{value:.{digits}g}")


def exact_form(program: Program) -> Written:
    """Return how `program` is written to the bit; raises ValueError when it is too large."""
    _check_size(program)
    return form_of(program)


def displayed_form(program: Program, digits: int) -> Written:
    """Return how `program` is shown with constants of so many significant digits, whatever it is shown in.

    Raises:
        ValueError: it is too large.
    """
    _check_size(program)
    # Imported here: what is printed to the bit needs none of it.
    from atoll_core.expression.writing.shortest import shortest

    short = shortest(program)
    values = {place: float(f"{short.constants[place]:.{digits}g}") for place in constant_places(short)}
    return form_of(shortest(with_constants(short, values)))


def to_code(program: Program, names: Sequence[str], notation: Notation, constants: Mapping[int, str]) -> str:
    """Return `program` as an expression of another language, exactly as it is computed.

    Args:
        program: any valid program.
        names: what the language calls the V input variables.
        notation: how it writes functions and powers.
        constants: names of those constants that have one, by node; all others are written with all their digits.

    Raises:
        ValueError: the text would have more than `PRINTABLE_SIZE` operations.
    """
    _check_size(program)
    return _text(form_of(program, constants, quotients=notation.quotients), names, repr, notation)


def _check_size(program: Program) -> None:
    size = tree_size(program)
    if size > PRINTABLE_SIZE:
        raise ValueError(f"an expression of {size} operations is too long to print; at most {PRINTABLE_SIZE} are")


def tree_size(program: Program) -> int:
    """Return the number of nodes of `program` printed as a tree; both operands of a*a and a + a count once."""
    sizes: list[int] = []
    columns = (program.operators, program.left, program.right)
    for code, left, right in zip(*(column.tolist() for column in columns), strict=True):
        size = 1
        if code > CONSTANT:
            size += sizes[left]
        if ARITY[code] == 2 and (left != right or code not in (ADD, MULTIPLY)):
            size += sizes[right]
        sizes.append(size)
    return sizes[-1]


def _text(written: Written, names: Sequence[str], number: Callable[[float], str], notation: Notation = INFIX) -> str:
    return _Text(names, number, notation).render(written)


class _Text(Renderer[str]):
    """Writes forms as text of one notation."""

    def __init__(self, names: Sequence[str], number: Callable[[float], str], notation: Notation) -> None:
        super().__init__()
        self._names, self._number, self._notation = names, number, notation

    def negative(self, operand: str) -> str:
        return f"-{operand}"

    def of(self, form: Form) -> str:
        match form.kind:
            case Kind.NAME:
                return str(self._names[form.index])
            case Kind.NUMBER:
                value, name = form.number
                return str(name) or self._number(value)
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
