"""Hints at conserved quantities: combinations of simple functions that do not change along the flow.

The Lie derivatives of the functions are taken at points all over the box; a combination of them that vanishes at every
point is a vector of their null space (singular values). It is a hint: constants that are estimates make no exact
combination vanish, and functions outside the dictionary are not seen. Letters: D states, F functions, N points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.flow import Flow
from atoll.data.dataset import FloatArray

DEGREE: Final = 4
"""Of the largest powers: energies of oscillators with cubic forces have it."""

MOST_FUNCTIONS: Final = 150
"""More are not looked at together: the points are four times as many, so that no null vector is one of chance."""

TOLERANCE: Final = 1e-9
"""Largest singular value of a null vector, as a share of the largest."""

_POINTS: Final = 4 * MOST_FUNCTIONS


@dataclass(frozen=True)
class ConservedQuantity:
    """A sum of functions, as (coefficient, text), that is constant along every course; the largest coefficient is 1."""

    terms: tuple[tuple[float, str], ...]

    @property
    def text(self) -> str:
        """The sum as infix text."""
        return " + ".join(name if value == 1.0 else f"{value:.10g}*{name}" for value, name in self.terms).replace(
            "+ -", "- "
        )


@dataclass(frozen=True, eq=False)
class _Function:
    text: str
    gradient: Callable[[FloatArray], FloatArray]


def conserved_quantities(flow: Flow, box: Box) -> tuple[ConservedQuantity, ...]:
    """Return the conserved quantities of the simplest dictionary that has any: degree 2, functions, degrees 3 and 4.

    Of several within one dictionary each is given with as few terms as elimination leaves.
    """
    points = box.points(_POINTS)
    rates = flow.rates(points)
    known = np.isfinite(rates).all(axis=1)
    points, rates = points[known], rates[known]
    functions: list[_Function] = []
    for more in _dictionaries(flow.field.states, box):
        functions = [*functions, *more]
        if not more or len(functions) > min(MOST_FUNCTIONS, len(points) // 2):
            continue
        found = _null_vectors(functions, points, rates)
        if found:
            return tuple(_quantity(vector, functions) for vector in found)
    return ()


def is_volume_preserving(flow: Flow, box: Box) -> bool:
    """Tell whether the divergence of the flow vanishes all over the box."""
    jacobians = flow.jacobian(box.points(_POINTS))
    jacobians = jacobians[np.isfinite(jacobians).all(axis=(1, 2))]
    if not len(jacobians):
        return False
    return bool(np.abs(np.einsum("nii->n", jacobians)).max() <= 1e-10 * max(np.abs(jacobians).max(), 1e-300))


def _dictionaries(states: tuple[str, ...], box: Box) -> list[list[_Function]]:
    """Return what is added to the dictionary, step by step."""
    degrees = [[_monomial(each, states) for each in combinations_with_replacement(range(len(states)), degree)]
               for degree in range(1, DEGREE + 1) if len(states) ** degree <= 4 * MOST_FUNCTIONS]  # fmt: skip
    elementary = []
    for index, name in enumerate(states):
        elementary += [_of_one(index, f"cos({name})", lambda x: -np.sin(x)), _of_one(index, f"sin({name})", np.cos)]
        if box.lower[index] >= 0.0:
            elementary.append(_of_one(index, f"log({name})", lambda x: 1.0 / x))
    return [*degrees[:2], elementary, *degrees[2:]]


def _monomial(factors: tuple[int, ...], states: tuple[str, ...]) -> _Function:
    powers = np.bincount(np.array(factors), minlength=len(states))
    text = "*".join(
        name if power == 1 else f"{name}**{power}" for name, power in zip(states, powers.tolist(), strict=True) if power
    )

    def gradient(points: FloatArray) -> FloatArray:
        found = np.zeros_like(points)
        for index in np.flatnonzero(powers):
            lower = powers.copy()
            lower[index] -= 1
            found[:, index] = powers[index] * np.prod(points**lower, axis=1)
        return found

    return _Function(text, gradient)


def _of_one(index: int, text: str, slope: Callable[[FloatArray], FloatArray]) -> _Function:
    def gradient(points: FloatArray) -> FloatArray:
        found = np.zeros_like(points)
        found[:, index] = slope(points[:, index])
        return found

    return _Function(text, gradient)


def _null_vectors(functions: list[_Function], points: FloatArray, rates: FloatArray) -> list[FloatArray]:
    """Return combinations (F,) of the functions whose derivative along the flow is 0 at all points, reduced."""
    gradients = [each.gradient(points) for each in functions]
    columns = np.array([(its * rates).sum(axis=1) for its in gradients]).T
    sizes = np.array([(np.abs(its) * np.abs(rates)).sum(axis=1).max() for its in gradients])
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    if not np.isfinite(columns).all():
        return []
    _, values, vectors = np.linalg.svd(columns / sizes, full_matrices=False)
    null = vectors[values <= TOLERANCE * max(float(values[0]), 1e-300)] if values[0] > 0.0 else np.eye(len(functions))
    return [row / sizes for row in _reduced(null)]


def _reduced(rows: FloatArray) -> FloatArray:
    """Return the reduced echelon form of `rows`, eliminating from the last column back: the simplest functions stay."""
    rows = rows.copy()
    done = 0
    for column in range(rows.shape[1] - 1, -1, -1):
        if done == len(rows):
            break
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[best, column]) < 1e-7:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    return rows[::-1]


def _quantity(vector: FloatArray, functions: list[_Function]) -> ConservedQuantity:
    largest = vector[int(np.argmax(np.abs(vector)))]
    shares = vector / largest
    terms = [
        (float(f"{share:.10g}"), each.text) for share, each in zip(shares, functions, strict=True) if abs(share) > 1e-7
    ]
    return ConservedQuantity(tuple(terms))
