"""A program's values and their derivatives with respect to its constants, on all rows at once, by numpy.

For what is done after the search, where a last bit more or less decides nothing; the kernels of
`atoll.expression.kernels.tape` are for the search. Letters: N nodes, R rows, K constants.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.operators import (
    ABS,
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    TANH,
    TRIGONOMETRIC_LIMIT,
    VARIABLE,
)
from atoll.expression.program import Program


def _periodic(function: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return sine or cosine as programs have it: not a number where the argument is too large to be reduced well."""

    def limited(a: FloatArray, _: FloatArray) -> FloatArray:
        values = function(a)
        return np.where(np.abs(a) > TRIGONOMETRIC_LIMIT, np.nan, values)

    return limited


_FORWARD: Final[dict[int, Callable[[FloatArray, FloatArray], FloatArray]]] = {
    ADD: np.add,
    SUBTRACT: np.subtract,
    MULTIPLY: np.multiply,
    DIVIDE: np.divide,
    SIN: _periodic(np.sin),
    COS: _periodic(np.cos),
    EXP: lambda a, _: np.exp(a),
    LOG: lambda a, _: np.log(a),
    SQRT: lambda a, _: np.sqrt(a),
    ABS: lambda a, _: np.abs(a),
    TANH: lambda a, _: np.tanh(a),
    POW: np.power,
    INVERSE: lambda a, _: 1.0 / a,
    SQUARE: lambda a, _: a * a,
    NEGATE: lambda a, _: -a,
}

_LEFT: Final[dict[int, Callable[[FloatArray, FloatArray, FloatArray], FloatArray | float]]] = {
    ADD: lambda a, b, v: 1.0,
    SUBTRACT: lambda a, b, v: 1.0,
    MULTIPLY: lambda a, b, v: b,
    DIVIDE: lambda a, b, v: 1.0 / b,
    SIN: lambda a, b, v: np.cos(a),
    COS: lambda a, b, v: -np.sin(a),
    EXP: lambda a, b, v: v,
    LOG: lambda a, b, v: 1.0 / a,
    SQRT: lambda a, b, v: 0.5 / v,
    ABS: lambda a, b, v: np.sign(a),
    TANH: lambda a, b, v: 1.0 - v * v,
    POW: lambda a, b, v: b * np.power(a, b - 1.0),
    INVERSE: lambda a, b, v: -v * v,
    SQUARE: lambda a, b, v: 2.0 * a,
    NEGATE: lambda a, b, v: -1.0,
}
"""Derivative with respect to the left argument, from both arguments and the value."""

_RIGHT: Final[dict[int, Callable[[FloatArray, FloatArray, FloatArray], FloatArray | float]]] = {
    ADD: lambda a, b, v: 1.0,
    SUBTRACT: lambda a, b, v: -1.0,
    MULTIPLY: lambda a, b, v: a,
    DIVIDE: lambda a, b, v: -v / b,
    POW: lambda a, b, v: v * np.log(a),
}
"""Derivative with respect to the right argument."""


def value_of(code: int, left: float, right: float) -> float:
    """Return the value of one operator; not finite where it has none."""
    with np.errstate(all="ignore"):
        return float(_FORWARD[code](np.array([left]), np.array([right]))[0])


def values_of(program: Program, inputs: FloatArray) -> FloatArray:
    """Return the values of `program` at all rows of `inputs` (V, R), shape (R,); not finite where there is none."""
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
                values.append(_FORWARD[code](values[left], values[right]))
    return values


def gradient_of(program: Program, values: list[FloatArray], places: Sequence[int]) -> FloatArray:
    """Return d(output)/d(constant) for the K constants at the indices `places`, (K, R), by one reverse sweep.

    `values` are those of `node_values`.
    """
    codes, lefts, rights = program.operators.tolist(), program.left.tolist(), program.right.tolist()
    depends = _dependent(codes, lefts, rights, places)
    adjoint: list[FloatArray | None] = [None] * len(codes)
    adjoint[-1] = np.ones_like(values[-1])
    with np.errstate(all="ignore"):
        for i in range(len(codes) - 1, -1, -1):
            code, mine = codes[i], adjoint[i]
            if mine is None or code <= CONSTANT:
                continue
            a, b = values[lefts[i]], values[rights[i]]
            if depends[lefts[i]]:
                _gather(adjoint, lefts[i], mine * _LEFT[code](a, b, values[i]))
            if code in _RIGHT and depends[rights[i]]:
                _gather(adjoint, rights[i], mine * _RIGHT[code](a, b, values[i]))
    found = [adjoint[place] for place in places]
    zero = np.zeros_like(values[-1])
    return np.array([zero if each is None else each for each in found]).reshape(len(found), len(zero))


def _dependent(codes: list[int], lefts: list[int], rights: list[int], places: Sequence[int]) -> list[bool]:
    """Return for every node whether it depends on a constant at `places`."""
    depends: list[bool] = []
    for index, (code, left, right) in enumerate(zip(codes, lefts, rights, strict=True)):
        if code <= CONSTANT:
            depends.append(index in places)
        else:
            depends.append(depends[left] or (code in _RIGHT and depends[right]))
    return depends


def _gather(adjoint: list[FloatArray | None], node: int, amount: FloatArray) -> None:
    known = adjoint[node]
    adjoint[node] = amount if known is None else known + amount
