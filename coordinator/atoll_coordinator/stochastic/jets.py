"""Values of programs with their first and second derivatives by the states, on all rows at once.

Forward differentiation of second order (Griewank & Walther 2008, chapter 13): the meaning of operators comes from
`atoll_core.expression.operators`, of which the arguments here are `Jet`. Letters: S states, V variables, R rows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import CONSTANT, TRIGONOMETRIC_LIMIT, VARIABLE, Functions, definitions
from atoll_core.expression.program import Program


@dataclass(frozen=True, eq=False)
class Jet:
    """A function of the states: `value` (R,), `gradient` (S, R), `hessian` (S, S, R); float 0.0 where they vanish."""

    value: FloatArray
    gradient: FloatArray | float = 0.0
    hessian: FloatArray | float = 0.0

    def __add__(self, other: "Jet") -> "Jet":
        return Jet(self.value + other.value, self.gradient + other.gradient, self.hessian + other.hessian)

    def __sub__(self, other: "Jet") -> "Jet":
        return Jet(self.value - other.value, self.gradient - other.gradient, self.hessian - other.hessian)

    def __neg__(self) -> "Jet":
        return Jet(-self.value, -self.gradient, -self.hessian)

    def __mul__(self, other: "Jet") -> "Jet":
        gradient = _scaled(self.value, other.gradient) + _scaled(other.value, self.gradient)
        hessian = _scaled(self.value, other.hessian) + _scaled(other.value, self.hessian)
        return Jet(self.value * other.value, gradient, hessian + _both(self.gradient, other.gradient))

    def __truediv__(self, other: "Jet") -> "Jet":
        return self * (1.0 / other)

    def __rtruediv__(self, number: float) -> "Jet":
        inverse = number / self.value
        return self.mapped(inverse, -inverse / self.value, 2.0 * inverse / (self.value * self.value))

    def mapped(self, value: FloatArray, first: FloatArray, second: FloatArray) -> "Jet":
        """Return a function of this one, from its value and its derivatives by it, (R,) each."""
        if isinstance(self.gradient, float):
            return Jet(value)
        square = self.gradient[:, None] * self.gradient[None, :]
        return Jet(value, first * self.gradient, second * square + _scaled(first, self.hessian))


def _scaled(value: FloatArray, derivative: FloatArray | float) -> FloatArray | float:
    return 0.0 if isinstance(derivative, float) else np.asarray(value * derivative)


def _both(one: FloatArray | float, other: FloatArray | float) -> FloatArray | float:
    if isinstance(one, float) or isinstance(other, float):
        return 0.0
    product = one[:, None] * other[None, :]
    return np.asarray(product + product.transpose(1, 0, 2))


def _sin(a: Jet) -> Jet:
    sine, cosine = np.sin(a.value), np.cos(a.value)
    return a.mapped(np.where(np.abs(a.value) > TRIGONOMETRIC_LIMIT, np.nan, sine), cosine, -sine)


def _cos(a: Jet) -> Jet:
    sine, cosine = np.sin(a.value), np.cos(a.value)
    return a.mapped(np.where(np.abs(a.value) > TRIGONOMETRIC_LIMIT, np.nan, cosine), -sine, -cosine)


def _exp(a: Jet) -> Jet:
    value = np.exp(a.value)
    return a.mapped(value, value, value)


def _log(a: Jet) -> Jet:
    return a.mapped(np.log(a.value), 1.0 / a.value, -1.0 / (a.value * a.value))


def _sqrt(a: Jet) -> Jet:
    root = np.sqrt(a.value)
    return a.mapped(root, 0.5 / root, -0.25 / (root * a.value))


def _abs(a: Jet) -> Jet:
    return a.mapped(np.abs(a.value), np.sign(a.value), np.zeros_like(a.value))


def _tanh(a: Jet) -> Jet:
    value = np.tanh(a.value)
    slope = 1.0 - value * value
    return a.mapped(value, slope, -2.0 * value * slope)


def _power(a: Jet, b: Jet) -> Jet:
    if not isinstance(b.gradient, float):
        return _exp(b * _log(a))
    x, y = a.value, b.value
    value = np.where((x == 0.0) & (y < 0.0), np.nan, np.power(x, y))
    return a.mapped(value, y * np.power(x, y - 1.0), y * (y - 1.0) * np.power(x, y - 2.0))


_unused: Final[Callable[..., Any]] = _abs
"""`Functions` has parts of derivatives, too, which are made of jets here."""
_OPERATORS: Final = definitions(
    Functions(_sin, _cos, _exp, _log, _sqrt, _abs, _tanh, _power, sign=_unused, base_log=_unused)
)


def jet_of(program: Program, points: FloatArray, states: int) -> Jet:
    """Return `program` at `points` (V, R), whose first rows are the states; not finite where it has no value."""
    found: list[Jet] = []
    for code, left, right, constant in program.nodes():
        if code == VARIABLE:
            found.append(_variable(points, left, states))
        elif code == CONSTANT:
            found.append(Jet(np.full(points.shape[1], constant)))
        else:
            found.append(_OPERATORS[code].value(found[left], found[right]))
    return found[-1]


def _variable(points: FloatArray, index: int, states: int) -> Jet:
    if index >= states:
        return Jet(points[index])
    gradient = np.zeros((states, points.shape[1]))
    gradient[index] = 1.0
    return Jet(points[index], gradient)
