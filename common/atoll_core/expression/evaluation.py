"""Values of programs, and their derivatives with respect to constants: computed by numpy on all rows, or by a Python
function.

This module is for the work after the search, which does not depend on the last bit. The search uses
`atoll_core.expression.kernels.tape`. Letters: N nodes, R rows, K constants.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import (
    ARITY,
    CONSTANT,
    TRIGONOMETRIC_LIMIT,
    VARIABLE,
    Functions,
    definitions,
    partial_definitions,
)
from atoll_core.expression.program import Program, ProgramBuilder, dependent_nodes


def _periodic(function: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """Return the sine or cosine function of programs: its value is NaN for arguments beyond `TRIGONOMETRIC_LIMIT`."""
    return lambda a: np.where(np.abs(a) > TRIGONOMETRIC_LIMIT, np.nan, function(a))


def _power(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where((x == 0.0) & (y < 0.0), np.nan, np.power(x, y))


def _base_log(x: FloatArray, v: FloatArray) -> FloatArray:
    return np.where((x == 0.0) & (v == 0.0), 0.0, np.log(x))


NUMPY: Final = Functions(
    _periodic(np.sin), _periodic(np.cos), np.exp, np.log, np.sqrt, np.abs, np.tanh, _power, np.sign, _base_log
)
DEFINITIONS: Final = {**definitions(NUMPY), **partial_definitions(NUMPY)}


def value_of(code: int, left: float, right: float) -> float:
    """Return the value of operator `code`. If there is no finite value, return NaN or infinity."""
    with np.errstate(all="ignore"):
        return float(DEFINITIONS[code].value(np.array([left]), np.array([right]))[0])


def values_of(program: Program, inputs: FloatArray) -> FloatArray:
    """Return the values of `program` at all rows of `inputs` (V, R), with the shape (R,). Values that are not defined
    are NaN or infinity."""
    return node_values(program, inputs)[-1]


def node_values(program: Program, inputs: FloatArray) -> list[FloatArray]:
    """Return the values of every node of `program` at all rows of `inputs` (V, R), each of shape (R,)."""
    rows = inputs.shape[1]
    values: list[FloatArray] = []
    with np.errstate(all="ignore"):
        for code, left, right, constant in program.nodes():
            if code == VARIABLE:
                values.append(inputs[left])
            elif code == CONSTANT:
                values.append(np.full(rows, constant))
            else:
                values.append(DEFINITIONS[code].value(values[left], values[right]))
    return values


def values_and_gradient(program: Program, inputs: FloatArray, places: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return the values (R,), and d(output)/d(constant) (K, R) for the K constants at the indices `places`.

    One reverse sweep computes all derivatives. A derivative that does not exist is NaN or infinity.
    """
    values = node_values(program, inputs)
    nodes = program.nodes()
    depends = dependent_nodes(nodes, places)
    adjoint: dict[int, FloatArray] = {len(nodes) - 1: np.ones_like(values[-1])}
    with np.errstate(all="ignore"):
        for place in range(len(nodes) - 1, -1, -1):
            code, left, right, _ = nodes[place]
            if place not in adjoint or not ARITY[code]:
                continue
            at = values[left], values[right], values[place]
            partials = (left, DEFINITIONS[code].left), (right, DEFINITIONS[code].right)
            for argument, partial in partials[: ARITY[code]]:
                if depends[argument]:
                    slope: FloatArray | float = float(partial.sign)
                    for factor in partial.factors:
                        slope = slope * factor(*at)
                    amount = adjoint[place] * (slope if partial.divisor is None else slope / partial.divisor(*at))
                    adjoint[argument] = adjoint[argument] + amount if argument in adjoint else amount
    zero = np.zeros_like(values[-1])
    return values[-1], np.array([adjoint.get(place, zero) for place in places]).reshape(len(places), len(zero))


# -------------------------------------------------------------------------------------------- as one Python function


_LONGEST: Final = 200
"""A part with a longer text gets a name of its own: Python reads at most 200 nested brackets."""


def function_of(programs: Sequence[Program], variables: int, functions: Functions) -> Callable[..., tuple[Any, ...]]:
    """Return a function that returns the values of `programs`.

    Its arguments are the values of `variables` variables, numbers or arrays. If there is no value, it raises the error
    of the division or of the function in `functions`.
    """
    # The type is `Any`, because the types depend on the arguments and on `functions`, and the text is only compiled
    # here.
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
