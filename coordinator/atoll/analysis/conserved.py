"""Hints of conserved quantities: combinations of simple functions that do not change along the flow.

The Lie derivatives of the functions are computed at points all over the box, and in boxes that are 1e6 and 1e12 times
smaller and larger. One box is not enough: in a narrow box, any combination that hardly varies seems conserved. A true
conservation law holds in boxes of any size. A combination whose Lie derivative vanishes at every point is a vector in
the null space of these derivatives, which is found from their singular values. The combination is reported if, in every
box, its derivative along the flow is negligible compared with its gradient.

Doubtful: this is only a hint. If the constants of the model are estimates, no combination vanishes exactly. Functions
outside of the dictionary are not found. Letters: D states, F functions, N points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from atoll.analysis.flow import Box, Flow
from atoll.model.vector_field import CompiledPrograms
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.derivative import derivative
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import COS, SIN
from atoll_core.expression.program import Program, live_nodes
from atoll_core.expression.text.parsing import from_infix

DEGREE: Final = 4
"""Largest degree of a polynomial: the energy of an oscillator with a cubic force has degree 4."""

MOST_FUNCTIONS: Final = 150
"""Largest size of a dictionary. There are four times as many points, so that null vectors do not occur by chance."""

TOLERANCE: Final = 1e-9
"""Largest singular value of a null vector, divided by the largest singular value. Also the largest component of a
gradient along the flow, divided by the gradient. It is the rounding error of numbers with ten digits."""

_POINTS: Final = 4 * MOST_FUNCTIONS

_ANGLE_POINTS: Final = 16
"""Number of points at which the slopes of an angle are compared."""

_FACTORS: Final = (2.0**-40, 2.0**-20, 1.0, 2.0**20, 2.0**40)
"""Scales of the further boxes. If a linear term is a millionth of a quadratic term in one box, both are equal in the
next box; `TOLERANCE` is far below a millionth."""

_LEAST_SHARE: Final = 1e-7
"""Smallest coefficient, relative to the largest one. Elimination yields smaller numbers instead of 0."""

_Functions = Sequence[tuple[str, str]]
"""Functions as pairs of displayed text and exact text."""


@dataclass(frozen=True)
class ConservedQuantity:
    """A sum of functions that is constant along the flow: (coefficient, text) pairs; the largest coefficient is 1."""

    terms: tuple[tuple[float, str], ...]

    @property
    def text(self) -> str:
        """The sum as infix text."""
        signs = {1.0: "", -1.0: "-"}
        texts = [signs.get(value, f"{value:.10g}*") + name for value, name in self.terms]
        return " + ".join(texts).replace("+ -", "- ")


def conserved_quantities(flow: Flow, box: Box) -> tuple[ConservedQuantity, ...]:
    """Return the conserved quantities from the simplest dictionary that has any.

    Dictionaries grow in this order: polynomials up to degree 2, sines, cosines and logarithms, degree 3, degree 4. If a
    dictionary has several conserved quantities, elimination gives each as few terms as possible.
    """
    around = Box(np.minimum(box.lower, 0.0), np.maximum(box.upper, 0.0))
    spread = [box.points(_POINTS), *(factor * around.points(_POINTS // 4, 1) for factor in _FACTORS)]
    boxes = []
    with np.errstate(all="ignore"):
        for points in spread:
            rates = flow.rates(points)
            is_finite = np.isfinite(rates).all(axis=1)
            boxes.append((points[is_finite], rates[is_finite]))
    functions: list[tuple[str, str]] = []
    for more in _dictionaries(flow, box):
        functions += more
        if more and len(functions) <= min(MOST_FUNCTIONS, len(boxes[0][0]) // 2):
            quantities = _conserved_combinations(functions, flow.field.states, boxes)
            if quantities:
                return tuple(quantities)
    return ()


def is_volume_preserving(flow: Flow, box: Box) -> bool:
    """Tell whether the divergence of the flow is 0, up to rounding, at points all over the box."""
    jacobians = flow.jacobian(box.points(_POINTS))
    diagonals = np.einsum("nii->ni", jacobians[np.isfinite(jacobians).all(axis=(1, 2))])
    if not len(diagonals):
        return False
    return bool(np.abs(diagonals.sum(axis=1)).max() <= 1e-10 * np.abs(diagonals).sum(axis=1).max())


def _dictionaries(flow: Flow, box: Box) -> list[_Functions]:
    """Return the functions that are added to the dictionary, step by step.

    Sines and cosines have the same arguments as in the model, because the sine of a state that is not an angle is
    meaningless.
    """
    states = flow.field.states
    degrees: list[_Functions] = []
    for degree in range(1, DEGREE + 1):
        monomials = []
        for factors in combinations_with_replacement(states, degree) if len(states) ** degree <= _POINTS else ():
            powers = {name: factors.count(name) for name in factors}
            text = "*".join(name if power == 1 else f"{name}**{power}" for name, power in powers.items())
            monomials.append((text, text))
        degrees.append(monomials)
    elementary = []
    for slopes in _angles(flow, box):
        parts = [(slope, name) for slope, name in zip(slopes, states, strict=True) if slope]
        exact = " + ".join(f"{slope:.17g}*{name}" for slope, name in parts)
        displayed = " + ".join(name if slope == 1.0 else f"{slope:.10g}*{name}" for slope, name in parts)
        displayed = displayed.replace("+ -", "- ")
        elementary += [(f"{name}({displayed})", f"{name}({exact})") for name in ("cos", "sin")]
    logarithms = [f"log({states[index]})" for index in np.flatnonzero(box.lower >= 0.0).tolist()]
    elementary += [(text, text) for text in logarithms]
    return [*degrees[:2], elementary, *degrees[2:]]


def _angles(flow: Flow, box: Box) -> list[FloatArray]:
    """Return the slopes (D,) of the arguments of sines and cosines of the model that are linear in the states."""
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
            if is_linear and middle.any():  # the sine of an input does not depend on the states
                middle = middle / box.widths * np.sign(middle[np.flatnonzero(middle)[0]])
                if not any(np.allclose(known * box.widths, middle * box.widths, TOLERANCE, 0.0) for known in angles):
                    angles.append(middle)
    return angles


@dataclass(frozen=True, eq=False)
class _LieDerivatives:
    """Lie derivatives of F functions at N points of one box.

    `along` (N, F) are the derivatives along the flow, and `sizes` (N, F) the sums of the absolute values of their
    terms. `gradients` are (N, D, F), `rates` (N, D).
    """

    along: FloatArray
    sizes: FloatArray
    gradients: FloatArray
    rates: FloatArray

    @classmethod
    def of(cls, compiled: CompiledPrograms, points: FloatArray, rates: FloatArray) -> "_LieDerivatives":
        count = points.shape[1]
        gradients = compiled.at_points([*points.T], (), len(points)).reshape(len(points), count, -1)  # (N, D, F)
        with np.errstate(all="ignore"):
            products = gradients * rates[:, :, None]
            sizes = np.abs(products).sum(axis=1)
        known = np.isfinite(sizes).all(axis=1)
        return cls(products.sum(axis=1)[known], sizes[known], gradients[known], rates[known])

    def is_conserved(self, vector: FloatArray) -> bool:
        """Tell whether the gradient (D,) of a combination `vector` (F,) has no component along the flow."""
        along, most = np.abs(self.along @ vector), (np.abs(self.gradients @ vector) * np.abs(self.rates)).sum(axis=1)
        unit = float(most.max(initial=0.0)) or 1.0  # squares of rates may overflow or underflow
        return float(((along / unit) ** 2).sum()) <= TOLERANCE**2 * float(((most / unit) ** 2).sum())


def _conserved_combinations(
    functions: _Functions, states: Sequence[str], boxes: Sequence[tuple[FloatArray, FloatArray]]
) -> list[ConservedQuantity]:
    """Return the combinations that are conserved in all `boxes`; a box is its points and their rates, both (N, D)."""
    programs = [from_infix(exact, states) for _, exact in functions]
    slopes = [derivative(program, place) for place in range(len(states)) for program in programs]
    compiled = CompiledPrograms(slopes, (len(slopes),), len(states))
    derivatives = [_LieDerivatives.of(compiled, *box) for box in boxes]
    sizes = derivatives[0].sizes.max(axis=0, initial=0.0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    quantities = []
    for row in _echelon(_null_space(derivatives, 1.0 / sizes)):
        kept = np.abs(row) > _LEAST_SHARE * np.abs(row).max()
        vector = _refine(derivatives, np.where(kept, row / sizes, 0.0))
        if all(derivative.is_conserved(vector) for derivative in derivatives):
            shares = zip(vector / vector[int(np.argmax(np.abs(vector)))], functions, strict=True)
            terms = ((float(f"{share:.10g}"), text) for share, (text, _) in shares if share)
            quantities.append(ConservedQuantity(tuple(terms)))
    return quantities


def _null_space(derivatives: Sequence[_LieDerivatives], units: FloatArray) -> FloatArray:
    """Return the combinations (n, F) of functions times `units` (F,) that are constant along the flow in all boxes."""
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


def _refine(derivatives: Sequence[_LieDerivatives], vector: FloatArray) -> FloatArray:
    """Return the combination with more precise small coefficients, because these matter in boxes of other sizes."""
    terms = np.flatnonzero(vector)
    parts = [replace(part, along=part.along[:, terms], sizes=part.sizes[:, terms]) for part in derivatives]
    null = _null_space(parts, np.abs(vector[terms]))
    if len(null) != 1:
        return vector
    refined = np.zeros_like(vector)
    refined[terms] = null[0] * np.abs(vector[terms])
    return refined


def _echelon(rows: FloatArray) -> FloatArray:
    """Return the reduced echelon form of `rows`, eliminated from the last column on, to keep the simplest functions."""
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
