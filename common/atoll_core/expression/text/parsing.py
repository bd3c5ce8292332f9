"""Parses infix text into a program. The text is the output of `atoll_core.expression.text.infix`, or an expression of a
user.

Operators: ``+ - * / **``, unary minus and brackets, with Python's precedence; the functions ``sin cos exp log sqrt abs
Abs tanh``; ``tan`` and ``cot``, which become quotients of sin and cos; and the number ``pi``. ``x**3`` with a natural
exponent is repeated multiplication from the left; ``x**2`` is a square; any other exponent is `pow`. Equal parts become
one node.

The parser has its own stacks, so deeply nested text cannot exhaust the interpreter's stack.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NoReturn, cast

from atoll_core.errors import UsageError
from atoll_core.expression import operators as op
from atoll_core.expression.program import MAX_NODES, Program, ProgramBuilder
from atoll_core.quoting import did_you_mean

LARGEST_POWER: Final = 64
"""Largest natural exponent that becomes repeated multiplication."""

_TOKEN: Final = re.compile(
    r"""
    (?P<number>\d+\.?\d*(?:[eE][+-]?\d+)? | \.\d+(?:[eE][+-]?\d+)?) |
    \*\*\s*(?P<natural>\d{1,3})(?![\w.])(?!\s*\*\*) |
    (?P<operator>\*\*|[-+*/()]) |
    (?P<blank>(?u:\s)+) |
    (?P<foreign>.)""",
    re.VERBOSE | re.ASCII | re.DOTALL,
)
_OPENING: Final = re.compile(r"\s*\(")
_CALLS: Final = {name: code for code, name in op.FUNCTIONS.items()} | {"Abs": op.ABS}
_LEVELS: Final = {op.ADD: 1, op.SUBTRACT: 1, op.MULTIPLY: 2, op.DIVIDE: 2, op.POW: 4}
_BINARY: Final = {op.OPERATORS[code].text: (level, code) for code, level in _LEVELS.items()}
_UNARY_LEVEL: Final = 3
_Kind = Literal["number", "call", "name", "natural", "operator", "blank", "foreign", "end"]
_MINUS: Final = "unary minus"


def from_infix(text: str, names: Sequence[str], *, merges_constants: bool = True) -> Program:
    """Return the program of `text` over the symbols `names`.

    If `merges_constants` is False, each number is a separate node, so that equal numbers can be fitted separately.

    Raises:
        UsageError: the text is not an expression over `names`; the message has the position.
    """
    return _Parser(text, names, merges_constants).parse()


def names_in(text: str) -> list[str]:
    """Return the names in an expression, without the names of called functions, in the order of the text."""
    return [token.text for token in _tokens(text) if token.kind == "name"]


@dataclass(frozen=True, slots=True)
class _Token:
    kind: _Kind
    text: str
    position: int


class _Parser:
    """Operator precedence with two stacks (Dijkstra's shunting yard)."""

    def __init__(self, text: str, names: Sequence[str], merges_constants: bool) -> None:
        self._text = text
        self._variables = {name: index for index, name in enumerate(names)}
        self._merges_constants = merges_constants
        self._builder = ProgramBuilder()
        self._values: list[int] = []
        self._pending: list[_Token] = []

    def parse(self) -> Program:
        expects_value = True
        for token in _tokens(self._text):
            expects_value = self._value(token) if expects_value else self._continuation(token)
        program = self._builder.program(self._values[-1])
        if len(program) > MAX_NODES:
            raise UsageError(f"the expression has {len(program)} different parts; at most {MAX_NODES} are possible")
        return program

    def _value(self, token: _Token) -> bool:
        """Process a token where a value must begin; return whether a value is still expected."""
        if token.kind == "number":
            value = float(token.text)
            if math.isinf(value):
                raise UsageError(f"the number {token.text} {self._where(token)} is too large; the largest is 1.8e308")
            self._values.append(self._constant(value))
            return False
        if token.kind == "name":
            self._values.append(self._named(token))
            return False
        if token.kind == "call" or token.text in ("-", "("):
            self._pending.append(token if token.text != "-" else replace(token, text=_MINUS))
            return True
        if token.text != "+":
            self._fail(token, "a number, a name, a function or '('")
        return True

    def _continuation(self, token: _Token) -> bool:
        """Process a token after a complete value; return whether a value is expected next."""
        if token.kind == "natural":
            self._values.append(self._natural_power(self._values.pop(), int(token.text)))
            return False
        if token.text == ")":
            self._reduce(0)
            if not self._pending:
                self._fail(token, "an operator or the end")
            opening = self._pending.pop()
            if opening.kind == "call":
                self._values.append(self._call(opening, self._values.pop()))
            return False
        if token.kind == "end":
            self._reduce(0)
            if self._pending:
                self._fail(token, "')'")
            return False
        if token.text not in _BINARY:
            self._fail(token, "an operator")
        level = _BINARY[token.text][0]
        self._reduce(level + 1 if token.text == "**" else level)
        self._pending.append(token)
        return True

    def _constant(self, value: float) -> int:
        return (
            self._builder.constant(value) if self._merges_constants else self._builder.append(op.CONSTANT, value=value)
        )

    def _named(self, token: _Token) -> int:
        if token.text in self._variables:
            return self._builder.add(op.VARIABLE, self._variables[token.text])
        if token.text == "pi":
            return self._constant(math.pi)
        known = ", ".join(self._variables)
        raise UsageError(
            f"{token.text!r} {self._where(token)} is unknown; known: {known}{did_you_mean(token.text, self._variables)}"
        )

    def _call(self, token: _Token, argument: int) -> int:
        if token.text in _CALLS:
            return self._builder.add(_CALLS[token.text], argument)
        if token.text not in ("tan", "cot"):
            known = ", ".join(sorted({*_CALLS, "tan", "cot"}))
            hint = did_you_mean(token.text, _CALLS)
            raise UsageError(f"{token.text!r} {self._where(token)} is no known function; known: {known}{hint}")
        parts = (self._builder.add(op.SIN, argument), self._builder.add(op.COS, argument))
        return self._builder.add(op.DIVIDE, *(parts if token.text == "tan" else parts[::-1]))

    def _reduce(self, level: int) -> None:
        """Apply pending operators that bind at least as tightly as `level`, back to the last bracket."""
        while self._pending and _level(self._pending[-1]) >= level:
            token, right = self._pending.pop(), self._values.pop()
            code, _, _, value = self._builder.nodes[right]
            if token.text != _MINUS:
                self._values.append(self._builder.add(_BINARY[token.text][1], self._values.pop(), right))
            elif code == op.CONSTANT:
                self._values.append(self._constant(-value))
            else:
                self._values.append(self._builder.add(op.NEGATE, right))

    def _natural_power(self, base: int, exponent: int) -> int:
        if not 1 <= exponent <= LARGEST_POWER:
            return self._builder.add(op.POW, base, self._constant(float(exponent)))
        if exponent == 1:
            return base
        power = self._builder.add(op.SQUARE, base)
        for _ in range(exponent - 2):
            power = self._builder.add(op.MULTIPLY, power, base)
        return power

    def _fail(self, token: _Token, expected: str) -> NoReturn:
        stop = "the text ends" if token.kind == "end" else f"{token.text!r} stands"
        hint = "; powers are written **" if token.text == "^" else ""
        raise UsageError(f"{stop} {self._where(token)} where {expected} was expected{hint}")

    def _where(self, token: _Token) -> str:
        start, stop = max(0, token.position - 30), token.position + 30
        excerpt = f"{'…' if start else ''}{self._text[start:stop]}{'…' if stop < len(self._text) else ''}"
        return f"at character {token.position + 1} of '{excerpt}'"


def _level(token: _Token) -> int:
    if token.text == _MINUS:
        return _UNARY_LEVEL
    return _BINARY[token.text][0] if token.kind == "operator" and token.text in _BINARY else -1


def _tokens(text: str) -> Iterator[_Token]:
    position = 0
    while position < len(text):
        if text[position].isidentifier():
            token, position = _named(text, position)
            yield token
            continue
        match = _TOKEN.match(text, position)
        assert match is not None  # every character matches at least the group "foreign"
        kind = cast(_Kind, match.lastgroup)
        if kind != "blank":
            yield _Token(kind, match[kind], match.start(kind))
        position = match.end()
    yield _Token("end", "", len(text))


def _named(text: str, start: int) -> tuple[_Token, int]:
    """Return the name at `start`, and where the name ends. If a bracket follows, the name is a function call."""
    end = start + 1
    while end < len(text) and ("_" + text[end]).isidentifier():
        end += 1
    bracket = _OPENING.match(text, end)
    if bracket is None:
        return _Token("name", text[start:end], start), end
    return _Token("call", text[start:end], start), bracket.end()
