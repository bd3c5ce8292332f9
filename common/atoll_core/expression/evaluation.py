"""Values of a program and their derivatives with respect to its constants, on all rows at once, by numpy.

For use after the search, where the last bit does not matter; the search uses `atoll_core.expression.kernels.tape`.
Letters: N nodes, R rows, K constants.
"""

from collections.abc import Callable, Sequence
from typing import Final

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
from atoll_core.expression.program import Program, dependent_nodes


def _periodic(function: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """Return sine or cosine as in programs: NaN beyond `TRIGONOMETRIC_LIMIT`."""
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
    """Return the value of operator `code`; NaN or infinity if it has no finite value."""
    with np.errstate(all="ignore"):
        return float(DEFINITIONS[code].value(np.array([left]), np.array([right]))[0])


def values_of(program: Program, inputs: FloatArray) -> FloatArray:
    """Return the values of `program` at all rows of `inputs` (V, R), shape (R,); NaN or infinity where undefined."""
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

    One reverse sweep gives all derivatives; NaN or infinity where a derivative does not exist.
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
