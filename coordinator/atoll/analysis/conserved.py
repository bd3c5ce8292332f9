"""Hints at conserved quantities: combinations of simple functions that do not change along the flow.

The Lie derivatives of the functions are taken at points all over the box, and boxes 1e6 and 1e12 times as small and
as large: within one narrow box every course keeps some polynomial to any accuracy, as it keeps every combination that
hardly changes there, but a law of the formulas holds wherever they do. A combination whose derivative along the flow
vanishes at every point is a vector of their null space (singular values); it is a law where its derivative along the
flow vanishes beside its gradient, in every one of these boxes. It is a hint: constants that are
estimates make no exact combination vanish, and functions outside the dictionary are not seen. Letters: D states, F
functions, N points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from atoll.analysis.flow import Box, Flow
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.derivative import derivative
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import COS, SIN
from atoll_core.expression.program import Program, live_nodes

DEGREE: Final = 4
"""Of the largest powers: energies of oscillators with cubic forces have it."""

MOST_FUNCTIONS: Final = 150
"""More are not looked at together: the points are four times as many, so that no null vector is one of chance."""

TOLERANCE: Final = 1e-9
"""Largest singular value of a null vector, as a share of the largest, and largest share of a gradient along the flow:
what rounding leaves of texts with ten digits."""

_POINTS: Final = 4 * MOST_FUNCTIONS

_ANGLE_POINTS: Final = 16
"""At which the slopes of an angle are compared."""

_FACTORS: Final = (2.0**-40, 2.0**-20, 1.0, 2.0**20, 2.0**40)
"""By which the states of further boxes differ: a term that is a millionth of another one in one of them is its equal in
the next one, and `TOLERANCE` is far less."""

_LEAST_SHARE: Final = 1e-7
"""Of a term beside the largest one, over the box: less is what elimination leaves of 0."""


@dataclass(frozen=True)
class ConservedQuantity:
    """A sum of functions, as (coefficient, text), that is constant along every course; the largest coefficient is 1."""

    terms: tuple[tuple[float, str], ...]

    @property
    def text(self) -> str:
        """The sum as infix text."""
        signs = {1.0: "", -1.0: "-"}
        texts = [signs.get(value, f"{value:.10g}*") + name for value, name in self.terms]
        return " + ".join(texts).replace("+ -", "- ")


@dataclass(frozen=True, eq=False)
class _BasisFunction:
    text: str
    gradient: Callable[[FloatArray], FloatArray]


_Points = tuple[FloatArray, FloatArray]
"""Points (N, D) of one box, and the rates there (N, D)."""


def conserved_quantities(flow: Flow, box: Box) -> tuple[ConservedQuantity, ...]:
    """Return the conserved quantities of the simplest dictionary that has any: degree 2, functions, degrees 3 and 4.

    Of several within one dictionary each is given with as few terms as elimination leaves.
    """
    boxes = _looked_at(flow, box)
    functions: list[_BasisFunction] = []
    for more in _dictionaries(flow, box):
        functions = [*functions, *more]
        if more and len(functions) <= min(MOST_FUNCTIONS, len(boxes[0][0]) // 2):
            quantities = _laws(functions, boxes)
            if quantities:
                return tuple(quantities)
    return ()


def _looked_at(flow: Flow, box: Box) -> list[_Points]:
    """Return points of the box, and of others on the same side of 0, smaller and larger, where there are rates."""
    around = Box(np.minimum(box.lower, 0.0), np.maximum(box.upper, 0.0))
    spread = [box.points(_POINTS), *(factor * around.points(_POINTS // 4, 1) for factor in _FACTORS)]
    boxes = []
    with np.errstate(all="ignore"):
        for points in spread:
            rates = flow.rates(points)
            is_finite = np.isfinite(rates).all(axis=1)
            boxes.append((points[is_finite], rates[is_finite]))
    return boxes


def is_volume_preserving(flow: Flow, box: Box) -> bool:
    """Tell whether the divergence of the flow vanishes all over the box, up to rounding of its terms if it has any."""
    jacobians = flow.jacobian(box.points(_POINTS))
    diagonals = np.einsum("nii->ni", jacobians[np.isfinite(jacobians).all(axis=(1, 2))])
    if not len(diagonals):
        return False
    return bool(np.abs(diagonals.sum(axis=1)).max() <= 1e-10 * np.abs(diagonals).sum(axis=1).max())


def _dictionaries(flow: Flow, box: Box) -> list[list[_BasisFunction]]:
    """Return what is added to the dictionary, step by step.

    Sines and cosines are those of what the model has a sine or cosine of: those of a state alone have no meaning where
    it is no angle.
    """
    states = flow.field.states
    degrees = [[_monomial(factors, states) for factors in combinations_with_replacement(range(len(states)), degree)]
               for degree in range(1, DEGREE + 1) if len(states) ** degree <= 4 * MOST_FUNCTIONS]  # fmt: skip
    elementary = [function for slopes in _angles(flow, box) for function in _waves(slopes, states)]
    elementary += [_logarithm(index, f"log({states[index]})") for index in np.flatnonzero(box.lower >= 0.0).tolist()]
    return [*degrees[:2], elementary, *degrees[2:]]


def _angles(flow: Flow, box: Box) -> list[FloatArray]:
    """Return the slopes (D,) of what sines and cosines of the model are of, where these are linear in the states."""
    points = box.points(_ANGLE_POINTS)
    columns = np.vstack([points.T, np.repeat(flow.inputs[:, None], len(points), axis=1)])
    angles: list[FloatArray] = []
    for program in flow.field.programs:
        nodes = program.nodes()
        for argument in [left for code, left, *_ in nodes if code in (SIN, COS)]:
            angle = Program.of(live_nodes(nodes, argument))
            slopes = np.array([values_of(derivative(angle, state), columns) for state in range(flow.size)])
            slopes *= box.widths[:, None]
            middle = slopes.mean(axis=1)
            is_linear = np.abs(slopes - middle[:, None]).max() <= TOLERANCE * np.abs(middle).max()
            if is_linear and middle.any():  # the sine of an input has no slopes at all
                middle = middle / box.widths * np.sign(middle[np.flatnonzero(middle)[0]])
                if not any(np.allclose(known * box.widths, middle * box.widths, TOLERANCE, 0.0) for known in angles):
                    angles.append(middle)
    return angles


def _waves(slopes: FloatArray, states: tuple[str, ...]) -> list[_BasisFunction]:
    """Return cosine and sine of the sum of states times `slopes` (D,)."""
    terms = [name if slope == 1.0 else f"{slope:.10g}*{name}" for slope, name in zip(slopes, states, strict=True)
             if slope]  # fmt: skip
    angle = " + ".join(terms).replace("+ -", "- ")
    return [
        _BasisFunction(f"cos({angle})", lambda x: -np.sin(x @ slopes)[:, None] * slopes),
        _BasisFunction(f"sin({angle})", lambda x: np.cos(x @ slopes)[:, None] * slopes),
    ]


def _monomial(factors: tuple[int, ...], states: tuple[str, ...]) -> _BasisFunction:
    powers = np.bincount(np.array(factors), minlength=len(states))
    text = "*".join(
        name if power == 1 else f"{name}**{power}" for name, power in zip(states, powers.tolist(), strict=True) if power
    )

    def gradient(points: FloatArray) -> FloatArray:
        gradients = np.zeros_like(points)
        for index in np.flatnonzero(powers):
            lower = powers.copy()
            lower[index] -= 1
            gradients[:, index] = powers[index] * np.prod(points**lower, axis=1)
        return gradients

    return _BasisFunction(text, gradient)


def _logarithm(index: int, text: str) -> _BasisFunction:
    def gradient(points: FloatArray) -> FloatArray:
        gradients = np.zeros_like(points)
        gradients[:, index] = 1.0 / points[:, index]
        return gradients

    return _BasisFunction(text, gradient)


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Of F functions at the points of one box: `along` the flow (N, F), and the `sizes` of the terms of that (N, F)."""

    along: FloatArray
    sizes: FloatArray
    gradients: FloatArray
    rates: FloatArray

    @classmethod
    def of(cls, functions: Sequence[_BasisFunction], points: FloatArray, rates: FloatArray) -> "_Derivatives":
        with np.errstate(all="ignore"):
            gradients = np.array([function.gradient(points) for function in functions])
            gradients = gradients.transpose(1, 2, 0)  # (N, D, F)
            products = gradients * rates[:, :, None]
            sizes = np.abs(products).sum(axis=1)
        known = np.isfinite(sizes).all(axis=1)
        return cls(products.sum(axis=1)[known], sizes[known], gradients[known], rates[known])

    def is_kept(self, vector: FloatArray) -> bool:
        """Tell whether the gradient (D,) of a combination (F,) has no part along the flow."""
        along, most = np.abs(self.along @ vector), (np.abs(self.gradients @ vector) * np.abs(self.rates)).sum(axis=1)
        unit = float(most.max(initial=0.0)) or 1.0  # squares of rates may be too large or too small for numbers
        return float(((along / unit) ** 2).sum()) <= TOLERANCE**2 * float(((most / unit) ** 2).sum())


def _laws(functions: Sequence[_BasisFunction], boxes: Sequence[_Points]) -> list[ConservedQuantity]:
    """Return the combinations of functions that are conserved in all boxes, the first of which gives their sizes."""
    derivatives = [_Derivatives.of(functions, *box) for box in boxes]
    sizes = derivatives[0].sizes.max(axis=0, initial=0.0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    quantities = []
    for row in _reduced(_null_space(derivatives, 1.0 / sizes)):
        kept = np.abs(row) > _LEAST_SHARE * np.abs(row).max()
        vector = _refined(derivatives, np.where(kept, row / sizes, 0.0))
        if all(derivative.is_kept(vector) for derivative in derivatives):
            shares = zip(vector / vector[int(np.argmax(np.abs(vector)))], functions, strict=True)
            terms = ((float(f"{share:.10g}"), function.text) for share, function in shares if share)
            quantities.append(ConservedQuantity(tuple(terms)))
    return quantities


def _null_space(derivatives: Sequence[_Derivatives], units: FloatArray) -> FloatArray:
    """Return the combinations (n, F), of functions times `units` (F,), that no box sees change along the flow."""
    with np.errstate(all="ignore"):
        along = np.vstack([derivative.along for derivative in derivatives]) * units
        largest = (np.vstack([derivative.sizes for derivative in derivatives]) * units).max(axis=1, initial=0.0)
    is_known = (largest > 0.0) & np.isfinite(largest)
    rows = along[is_known] / largest[is_known, None]
    if not rows.any():
        return np.eye(len(units))
    _, values, vectors = np.linalg.svd(rows, full_matrices=len(rows) < len(units))
    values = np.append(values, np.zeros(len(vectors) - len(values)))
    return np.asarray(vectors[values <= TOLERANCE * values[0]])


def _refined(derivatives: Sequence[_Derivatives], vector: FloatArray) -> FloatArray:
    """Return a combination whose small coefficients are known as well as large ones: they matter in other boxes."""
    terms = np.flatnonzero(vector)
    parts = [replace(part, along=part.along[:, terms], sizes=part.sizes[:, terms]) for part in derivatives]
    null = _null_space(parts, np.abs(vector[terms]))
    if len(null) != 1:
        return vector
    refined = np.zeros_like(vector)
    refined[terms] = null[0] * np.abs(vector[terms])
    return refined


def _reduced(rows: FloatArray) -> FloatArray:
    """Return the reduced echelon form of `rows`, eliminating from the last column back: the simplest functions stay."""
    rows = rows.copy()
    done = 0
    for column in range(rows.shape[1] - 1, -1, -1):
        if done == len(rows):
            break
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[best, column]) < _LEAST_SHARE:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    return rows[::-1]
