"""Print programs as infix text that our parser (`atoll.expression.text.parsing`) and sympy read alike.

Two manners. *Exact* (the default): parsing the text gives the same bits on every row, because only rewritings are used
that IEEE 754 keeps: the operands of + and * swapped, signs moved, a*a as a**2, a + a as 2.0*a, sin(a)/cos(a) as
tan(a). *Display* (``digits``): the shortest writing (`atoll.expression.writing`) with rounded constants.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from atoll.expression.operators import (
    ADD,
    ARITY,
    CONSTANT,
    DIVIDE,
    INVERSE,
    MULTIPLY,
    NEGATE,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll.expression.program import Program, constant_places, with_constants
from atoll.expression.text.notation import INFIX, Notation

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
    _check_size(program)
    if digits is None:
        return _exact(program, names, repr)
    # Imported here: what is printed to the bit needs none of it.
    from atoll.expression.writing.shortest import shortest

    found = shortest(program)
    values = {place: float(f"{found.constants[place]:.{digits}g}") for place in constant_places(found)}
    rounded = with_constants(found, values)
    return _exact(shortest(rounded), names, lambda value: f"{value:.{digits}g}")


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
    return _exact(program, names, repr, notation, constants)


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


@dataclass(frozen=True, slots=True)
class _Piece:
    """A printed part; its value is ``-text`` when `negative`.

    A sum has `terms`, each with its sign, and no text of its own. `base` and `exponent` say that the text is a natural
    power, which means repeated multiplication from the left.
    """

    kind: int
    text: str = ""
    negative: bool = False
    terms: "tuple[_Piece, ...]" = ()
    base: str = ""
    exponent: int = 0


_SUM, _PRODUCT, _POWER, _CONSTANT, _ATOM = range(5)
_ONE: Final = _Piece(_CONSTANT, "1")
_TWO: Final = _Piece(_CONSTANT, "2.0")


def _exact(
    program: Program,
    names: Sequence[str],
    number: Callable[[float], str],
    notation: Notation = INFIX,
    constants: Mapping[int, str] = MappingProxyType({}),
) -> str:
    pieces: list[_Piece] = []
    for place, (code, left, right, value) in enumerate(program.nodes()):
        if code == VARIABLE:
            pieces.append(_Piece(_ATOM, names[left]))
        elif code == CONSTANT:
            pieces.append(_constant(constants.get(place), value, number))
        elif ARITY[code] == 2:
            pieces.append(_binary(code, pieces[left], pieces[right], notation))
        else:
            pieces.append(_unary(code, pieces[left], notation))
    return _signed(pieces[-1])


def _constant(name: str | None, value: float, number: Callable[[float], str]) -> _Piece:
    if name is not None:
        return _Piece(_CONSTANT, name)
    return _Piece(_CONSTANT, number(abs(value)), negative=math.copysign(1.0, value) < 0.0)


def _binary(code: int, left: _Piece, right: _Piece, notation: Notation) -> _Piece:
    if code == ADD:
        return _multiply(_TWO, left, notation) if left == right else _add(left, right)
    if code == SUBTRACT:
        return _add(left, _negated(right))
    if code == MULTIPLY:
        return _multiply(left, right, notation)
    if code == DIVIDE:
        return _divide(left, right, notation)
    operand = _signed if notation.is_call else _closed
    return _Piece(_ATOM if notation.is_call else _POWER, notation.power.format(operand(left), operand(right)))


def _unary(code: int, piece: _Piece, notation: Notation) -> _Piece:
    if code == NEGATE:
        return _negated(piece)
    if code == SQUARE:
        return _multiply(piece, piece, notation)
    if code == INVERSE:
        return _divide(_ONE, piece, notation)
    return _Piece(_ATOM, f"{notation.call(code)}({_signed(piece)})")


def _negated(piece: _Piece) -> _Piece:
    # Not term by term: -(a - b) and b - a differ in the sign of zero.
    piece = _grouped(piece)
    return replace(piece, negative=not piece.negative)


def _add(left: _Piece, right: _Piece) -> _Piece:
    if right.terms and not left.terms:
        left, right = right, left
    return _Piece(_SUM, terms=(*(left.terms or (left,)), _grouped(right)))


def _multiply(left: _Piece, right: _Piece, notation: Notation) -> _Piece:
    left, right, negative = _operands(left, right)
    power = _power(left, right, notation)
    if power is not None:
        return replace(power, negative=negative)
    if left.kind != _CONSTANT and (right.kind == _CONSTANT or (right.kind == _PRODUCT and left.kind != _PRODUCT)):
        left, right = right, left
    return _Piece(_PRODUCT, f"{left.text}*{_factor(right)}", negative)


def _divide(left: _Piece, right: _Piece, notation: Notation) -> _Piece:
    left, right, negative = _operands(left, right)
    for above, below, name in notation.quotients():
        argument = left.text.removeprefix(above)
        if left.kind == right.kind == _ATOM and left.text == above + argument and right.text == below + argument:
            return _Piece(_ATOM, name + argument, negative)
    return _Piece(_PRODUCT, f"{left.text}/{_factor(right)}", negative)


def _operands(left: _Piece, right: _Piece) -> tuple[_Piece, _Piece, bool]:
    """Return both without their signs, and the sign of their product or quotient."""
    left, right = _grouped(left), _grouped(right)
    return replace(left, negative=False), replace(right, negative=False), left.negative != right.negative


def _power(left: _Piece, right: _Piece, notation: Notation) -> _Piece | None:
    if _CONSTANT in (left.kind, right.kind):
        return None
    if left.text == right.text:
        return _natural_power(left.text if left.kind == _ATOM else f"({left.text})", 2, notation)
    for power, factor in ((left, right), (right, left)):
        if power.base == factor.text and factor.kind == _ATOM:
            return _natural_power(power.base, power.exponent + 1, notation)
    return None


def _natural_power(base: str, exponent: int, notation: Notation) -> _Piece:
    return _Piece(_POWER, notation.natural.format(base, exponent), base=base, exponent=exponent)


def _grouped(piece: _Piece) -> _Piece:
    """Return a sum in brackets, anything else as it is."""
    return _Piece(_ATOM, f"({_signed(piece)})") if piece.terms else piece


def _signed(piece: _Piece) -> str:
    """Return the whole text of a piece, sign included."""
    first, *rest = _leading_positive(piece.terms or (piece,))
    text = f"-{first.text}" if first.negative else first.text
    return "".join([text, *(f" {'-' if term.negative else '+'} {term.text}" for term in rest)])


def _leading_positive(terms: tuple[_Piece, ...]) -> tuple[_Piece, ...]:
    """Swap the first two terms where that makes the first one positive: the one reordering that keeps every bit."""
    if len(terms) > 1 and terms[0].negative and not terms[1].negative:
        return (terms[1], terms[0], *terms[2:])
    return terms


def _factor(piece: _Piece) -> str:
    """Return the text of the right operand of * or /."""
    return f"({piece.text})" if piece.kind == _PRODUCT else piece.text


def _closed(piece: _Piece) -> str:
    """Return the text of an operand of ``**``."""
    is_closed = piece.kind in (_ATOM, _CONSTANT) and not piece.negative
    return piece.text if is_closed else f"({_signed(piece)})"
