"""Evaluate programs on columns by numpy, independently of the kernels: for judging models, not for finding them."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

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
    VARIABLE,
)
from atoll.expression.program import Program

FloatArray = npt.NDArray[np.float64]

OPERATIONS: Final[dict[int, Callable[[Any, Any], Any]]] = {
    ADD: np.add,
    SUBTRACT: np.subtract,
    MULTIPLY: np.multiply,
    DIVIDE: np.divide,
    POW: np.power,
    SIN: lambda a, _: np.sin(a),
    COS: lambda a, _: np.cos(a),
    EXP: lambda a, _: np.exp(a),
    LOG: lambda a, _: np.log(a),
    SQRT: lambda a, _: np.sqrt(a),
    ABS: lambda a, _: np.abs(a),
    TANH: lambda a, _: np.tanh(a),
    INVERSE: lambda a, _: 1.0 / a,
    SQUARE: lambda a, _: a * a,
    NEGATE: lambda a, _: -a,
}
"""By code; one-sided ones ignore their second argument."""


def evaluate(program: Program, columns: Sequence[FloatArray]) -> FloatArray:
    """Return the values of `program` on rows given by column, by numpy's functions."""
    return node_values(program, columns)[-1]


def node_values(program: Program, columns: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the values of every node of `program`, the last being its output."""
    values: list[FloatArray] = []
    parts = (program.operators, program.left, program.right, program.constants)
    for code, left, right, value in zip(*(part.tolist() for part in parts), strict=True):
        if code == VARIABLE:
            values.append(columns[left])
        elif code == CONSTANT:
            values.append(np.full(len(columns[0]), value))
        else:
            values.append(OPERATIONS[code](values[left], values[right]))
    return values
