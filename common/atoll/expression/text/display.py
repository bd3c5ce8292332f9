"""Expressions for the eye: rounded constants, sums and products flattened and like terms joined, as in the reals.

What is shown here has the value of the program up to rounding, but not its operations; see
`atoll.expression.text.infix` for the exact text. Nothing is expanded: the brackets of the program stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from atoll.expression.operators import (
    ADD,
    ARITY,
    CONSTANT,
    FUNCTIONS,
    INVERSE,
    MULTIPLY,
    NEGATE,
    POW,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll.expression.program import Program


@dataclass(frozen=True, slots=True)
class _Product:
    """A coefficient times integer powers of factors, each factor by its text, in the order met."""

    coefficient: float
    powers: tuple[tuple[str, int], ...] = ()

    def times(self, other: "_Product", exponent: int) -> "_Product":
        """Return this product times `other` to the power of `exponent`, 1 or -1."""
        powers = dict(self.powers)
        for factor, count in other.powers:
            powers[factor] = powers.get(factor, 0) + exponent * count
        coefficient = self.coefficient * other.coefficient if exponent > 0 else self.coefficient / other.coefficient
        return _Product(coefficient, tuple(item for item in powers.items() if item[1]))


_Sum = tuple[_Product, ...]


def display(program: Program, names: Sequence[str], digits: int) -> str:
    """Return `program` as infix text for reading, constants rounded to `digits` significant digits."""
    return _Display(names, digits).show(program)


class _Display:
    """Builds the sum of products of every node, from the first node to the last."""

    def __init__(self, names: Sequence[str], digits: int) -> None:
        self._names = names
        self._digits = digits

    def show(self, program: Program) -> str:
        sums: list[_Sum] = []
        for code, left, right, value in program.nodes():
            if code == VARIABLE:
                sums.append(_factor(self._names[left]))
            elif code == CONSTANT:
                sums.append((_Product(value),))
            elif ARITY[code] == 2:
                sums.append(self._binary(code, sums[left], sums[right]))
            else:
                sums.append(self._unary(code, sums[left]))
        return _unbracketed(self._text(sums[-1]), sums[-1])

    def _binary(self, code: int, left: _Sum, right: _Sum) -> _Sum:
        if code == ADD:
            return _added(left, right)
        if code == SUBTRACT:
            return _added(left, _negated(right))
        if code == POW:
            return _factor(f"({self._closed(left)}**{self._closed(right)})")
        return self._product_of(left, right, 1 if code == MULTIPLY else -1)

    def _unary(self, code: int, argument: _Sum) -> _Sum:
        if code == NEGATE:
            return _negated(argument)
        if code == SQUARE:
            return self._product_of(argument, argument, 1)
        if code == INVERSE:
            return self._product_of((_Product(1.0),), argument, -1)
        return _factor(f"{FUNCTIONS[code]}({self._text(argument)})")

    def _product_of(self, left: _Sum, right: _Sum, exponent: int) -> _Sum:
        first, second = self._single(left), self._single(right)
        if exponent < 0 and second.coefficient == 0.0:
            return _factor(f"({self._text(left)}/{self._closed(right)})")
        return (first.times(second, exponent),)

    def _single(self, terms: _Sum) -> _Product:
        """Return a sum as one product: itself, or a bracket."""
        if len(terms) == 1:
            return terms[0]
        return _factor(f"({self._text(terms)})")[0] if terms else _Product(0.0)

    def _text(self, terms: _Sum) -> str:
        shown = [self._term(term) for term in terms]
        if not shown:
            return "0"
        lead = next((index for index, (negative, _) in enumerate(shown) if not negative), 0)
        shown.insert(0, shown.pop(lead))
        text = "".join(f" {'-' if negative else '+'} {magnitude}" for negative, magnitude in shown)
        return text[3:] if text.startswith(" +") else f"-{text[3:]}"

    def _term(self, term: _Product) -> tuple[bool, str]:
        """Return the sign and the text of the magnitude of one product."""
        number = f"{abs(term.coefficient):.{self._digits}g}"
        above = [_power(factor, count) for factor, count in term.powers if count > 0]
        below = [_power(factor, -count) for factor, count in term.powers if count < 0]
        if number != "1" or not above:
            above.insert(0, number)
        text = "*".join(above)
        if below:
            text += f"/{below[0]}" if len(below) == 1 else f"/({'*'.join(below)})"
        return term.coefficient < 0.0, text

    def _closed(self, terms: _Sum) -> str:
        """Return the text of an operand of ``**``."""
        text = self._text(terms)
        return text if text.isidentifier() or text.replace(".", "").isdigit() else f"({text})"


def _unbracketed(text: str, terms: _Sum) -> str:
    """Return the text of a lone bracket without it."""
    is_bracket = [(text, 1)] == [power for term in terms for power in term.powers] and text.startswith("(")
    return text[1:-1] if is_bracket else text


def _factor(text: str) -> _Sum:
    return (_Product(1.0, ((text, 1),)),)


def _power(factor: str, count: int) -> str:
    return factor if count == 1 else f"{factor}**{count}"


def _negated(terms: _Sum) -> _Sum:
    return tuple(replace(term, coefficient=-term.coefficient) for term in terms)


def _added(left: _Sum, right: _Sum) -> _Sum:
    """Return the sum with like terms joined, in the order met; a coefficient of exactly zero goes."""
    coefficients = {term.powers: term.coefficient for term in left}
    for term in right:
        coefficients[term.powers] = coefficients.get(term.powers, 0.0) + term.coefficient
    return tuple(_Product(coefficient, powers) for powers, coefficient in coefficients.items() if coefficient)
