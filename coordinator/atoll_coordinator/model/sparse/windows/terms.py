"""Terms of sums integrated over windows, with the errors that those of the variables give them.

Letters: K terms, W windows, N rows of all trajectories, V variables.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from atoll_coordinator.model.criteria import constant_nats_of
from atoll_coordinator.model.sparse.kernels.errors_in_variables import error_products
from atoll_coordinator.model.sparse.shapes import Atom, Shape
from atoll_coordinator.model.sparse.windows.window_rows import WindowRows
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import VARIABLE


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms on the windows of one equation; integrals are by cubics and by straight lines.

    Terms `shared` (places) have inner constants that another equation has fitted.
    """

    rows: WindowRows
    atoms: tuple[Atom, ...]
    shared: frozenset[int] = frozenset()

    def price(self, place: int) -> float:
        """Return the nats of a term in a sum: its structure, and 1/2 ln N for each constant that is fitted to it."""
        count = len(self.rows.first)
        return self.atoms[place].shape.price(count) - (constant_nats_of(count) if place in self.shared else 0.0)

    @cached_property
    def integrals(self) -> FloatArray:
        """The integrals (2, K, W)."""
        values = np.array([atom.values for atom in self.atoms])
        return np.array([self.rows.integrals(values), self.rows.integrals_by_lines(values)])

    @cached_property
    def errors(self) -> tuple[FloatArray, FloatArray]:
        """Covariances of the errors of integrals: with each other (W, K, K), with the sides' (W, K)."""
        gradients = np.array([gradient(atom, self.rows) for atom in self.atoms])
        return covariances(self.rows, gradients)

    @cached_property
    def is_finite(self) -> bool:
        """Whether all integrals and covariances are numbers."""
        return bool(
            np.isfinite(self.integrals).all() and all(np.isfinite(covariance).all() for covariance in self.errors)
        )


def covariances(rows: WindowRows, gradients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances (W, K, K) and (W, K) of terms with these `gradients` (K, V, N)."""
    count, windows = len(gradients), len(rows.first)
    products, cross = np.zeros((windows, count, count)), np.zeros((windows, count))
    gradients = np.ascontiguousarray(gradients)
    error_products(rows.first, rows.bumps[0], rows.slopes[0], gradients, rows.noise, rows.target, products, cross)
    return products, cross


def gradient(atom: Atom, rows: WindowRows, *, is_slope: bool = False) -> FloatArray:
    """Return the derivatives (V, N) of a term by the variables with errors; of its slope by the inner constant.

    Differences over the errors' deviation: what is beyond first order is averaged.
    """
    derivatives = np.zeros_like(rows.inputs)
    with np.errstate(all="ignore"):
        for variable, size in enumerate(rows.noise.tolist()):
            if size > 0.0 and depends(atom.shape, variable):
                above, below = (_moved(atom, rows, variable, step, is_slope=is_slope) for step in (size, -size))
                derivatives[variable] = (above - below) / (2.0 * size)
    return derivatives


def _moved(atom: Atom, rows: WindowRows, variable: int, step: float, *, is_slope: bool) -> FloatArray:
    inputs = rows.inputs.copy()
    inputs[variable] += step
    shape = atom.shape.over(inputs)
    return shape.slope(atom.constant) if is_slope else shape.value(atom.constant)


def depends(shape: Shape, variable: int) -> bool:
    """Tell whether a shape has a variable (index), as a factor or in its argument."""
    return variable in shape.factors or _has(shape.argument, variable)


def _has(expression: object, variable: int) -> bool:
    if not isinstance(expression, tuple):
        return False
    if len(expression) == 2 and expression[0] == VARIABLE:
        return bool(expression[1] == variable)
    return any(_has(part, variable) for part in expression[1:])
