"""Programs as one Python function of numbers or arrays that computes their common parts once.

The table of operators writes the source text of the function. Names in this text are made of node numbers, so that it
never contains text of a user.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final

from atoll_core.expression.operators import ARITY, CONSTANT, Functions, definitions, partial_definitions
from atoll_core.expression.program import Program, ProgramBuilder

_LONGEST: Final = 200
"""Longest text, in characters, of a part that gets no variable of its own: Python accepts 200 nested brackets."""


def function_of(programs: Sequence[Program], variables: int, functions: Functions) -> Callable[..., tuple[Any, ...]]:
    """Return a function of this many variables (numbers or arrays) that returns the values of `programs`.

    It raises the errors that `functions` and divisions raise for arguments without a value.
    """
    # Any, because the types depend on the arguments and on `functions`, and the text is compiled here.
    builder = ProgramBuilder()
    outputs = [builder.copy(program.nodes())[-1] for program in programs]
    uses = Counter(argument for code, *pair, _ in builder.nodes for argument in pair[: ARITY[code]]) + Counter(outputs)
    names, lines = [], [f"def function({', '.join(f'x{index}' for index in range(variables))}):"]
    for place, (code, left, right, value) in enumerate(builder.nodes):
        if not ARITY[code]:
            names.append(_Formula(f"({value!r})" if code == CONSTANT else f"x{left}"))
            continue
        text = _OPERATORS[code].value(names[left], names[right])
        if uses[place] == 1 and len(text) < _LONGEST:
            names.append(_Formula(f"({text})"))
        else:
            names.append(_Formula(f"n{place}"))
            lines.append(f"    n{place} = {text}")
    lines.append(f"    return ({''.join(f'{names[place]}, ' for place in outputs)})")
    scope: dict[str, Any] = {**functions._asdict(), "inf": math.inf, "nan": math.nan}
    exec("\n".join(lines), scope)
    function: Callable[..., tuple[Any, ...]] = scope["function"]
    return function


class _Formula(str):
    """A part of a formula; arithmetic on it writes text."""

    def __add__(self, other: str) -> str:
        return f"{self} + {other}"

    def __sub__(self, other: str) -> str:
        return f"{self} - {other}"

    def __mul__(self, other: str) -> str:  # type: ignore[override]
        return f"{self} * {other}"

    def __truediv__(self, other: str) -> str:
        return f"{self} / {other}"

    def __rtruediv__(self, other: float) -> str:
        return f"{other} / {self}"

    def __neg__(self) -> str:
        return f"-{self}"


def _call(name: str) -> Callable[..., str]:
    return lambda *arguments: f"{name}({', '.join(arguments)})"


_FUNCTIONS: Final = Functions(*map(_call, Functions._fields))
_OPERATORS: Final = {**definitions(_FUNCTIONS), **partial_definitions(_FUNCTIONS)}
