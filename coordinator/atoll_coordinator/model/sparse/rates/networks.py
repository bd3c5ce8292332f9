"""The law of a node of a network: a hyperbolic tangent of a weighted sum of variables beside a linear part.

A library has no columns for it, since all weights are inside. They are fitted by least squares from several directions:
the first is that of linear regression, which is the right one where variables are symmetric (Brillinger 1982).

Letters: N rows, V variables of the sum, K terms beside it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.least_squares import Descent, Solver, coefficients_of, minimize, solver
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows
from atoll_coordinator.model.sparse.rates.rate_sums import RateSum, fitted
from atoll_coordinator.model.sparse.shapes import SCALED, Atom, Shape
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import ADD, MULTIPLY, TANH, VARIABLE
from atoll_core.expression.program import Expression

_STEEPNESS = (1.0, 3.0, 10.0)
"""Standard deviations of the argument to begin with, each about the root of ten times the one before.

Of a normal argument the tangent correlates by 0.96 with a line at the first, and at the last 92 % of its values are
beyond ±0.76, as those of a step. Each takes a fit of every direction; with fewer, more fits end in a minimum nearby.
"""


@dataclass(frozen=True, eq=False)
class _Node:
    """The terms beside a sum (K, N), the derivative and its errors (N,), and the variables of the sum (V, N)."""

    beside: FloatArray
    values: FloatArray
    errors: FloatArray
    inputs: FloatArray

    def left(self, numbers: FloatArray) -> FloatArray:
        """Return what is left (N,), in standard errors; `numbers` are K factors, that of the tangent, V weights."""
        count = len(self.beside)
        tangent = np.tanh(numbers[count + 1 :] @ self.inputs)
        return np.asarray((numbers[:count] @ self.beside + numbers[count] * tangent - self.values) / self.errors)

    def misfit(self, numbers: FloatArray) -> float:
        """Return the median size of what is left, in standard errors."""
        return float(np.median(np.abs(self.left(numbers))))

    def slopes(self, numbers: FloatArray) -> FloatArray:
        """Return its derivatives by the numbers (N, K + 1 + V)."""
        count = len(self.beside)
        tangent = np.tanh(numbers[count + 1 :] @ self.inputs)
        inner = numbers[count] * (1.0 - tangent * tangent) * self.inputs
        return np.asarray((np.vstack([self.beside, tangent, inner]) / self.errors).T)

    def begun(self, weights: FloatArray) -> FloatArray:
        """Return the numbers for these weights (V,) of the sum, the others by least squares."""
        columns = np.vstack([self.beside, np.tanh(weights @ self.inputs)])
        return np.concatenate([coefficients_of(columns, self.values), weights])

    def fit(self, numbers: FloatArray) -> FloatArray:
        """Return the numbers of least Cauchy loss nearby."""

        def loss(at: FloatArray) -> float:
            return 0.5 * float(np.log1p(self.left(at) ** 2).sum())

        def linearise(at: FloatArray) -> Solver[FloatArray]:
            left, slopes = self.left(at), self.slopes(at)
            weighted = slopes / (1.0 + left * left)[:, None]
            return solver(weighted.T @ slopes, weighted.T @ left)

        def move(at: FloatArray, step: FloatArray) -> tuple[FloatArray, float]:
            return at + step, loss(at) - loss(at + step)

        return minimize(Descent(numbers, linearise, move, lambda at: SETTINGS.effort.settled * loss(at)))


def with_network(rows: RateRows, begun: Sequence[Atom], columns: Sequence[int]) -> list[Atom]:
    """Return `begun` and a hyperbolic tangent of a weighted sum of the variables `columns`, weights fitted.

    Weights that the sum can do without are left out. Nothing where no sum leaves as little as the derivatives' errors.
    """
    inputs = np.vstack([np.ones(len(rows.values)), rows.inputs[list(columns)]])
    node = _Node(np.array([atom.values for atom in begun]), rows.values, rows.errors, inputs)
    coarse = replace(node, errors=np.full(len(rows.values), float(rows.values.std())))
    ends = [coarse.fit(coarse.begun(weights)) for weights in _starts(rows, columns)]
    for numbers in sorted(ends, key=coarse.misfit)[: SETTINGS.effort.beam]:
        errors = np.maximum(rows.errors, coarse.misfit(numbers) * coarse.errors)
        fine = node.fit(replace(node, errors=errors).fit(numbers))
        fitted_sum = _sum(rows, begun, columns, fine[len(begun) + 1 :])
        if fitted_sum is not None and fitted_sum.scale <= 1.0:
            return list(_pruned(rows, begun, columns, node, fine, fitted_sum).atoms)
    return []


def _starts(rows: RateRows, columns: Sequence[int]) -> Iterator[FloatArray]:
    """Yield weights to begin with, that of the constant first: by linear regression, then in drawn directions."""
    values = rows.inputs[list(columns)]
    means, sizes = values.mean(axis=1), values.std(axis=1)
    unit = (values - means[:, None]) / np.where(sizes > 0.0, sizes, 1.0)[:, None]
    directions = [coefficients_of(unit, rows.values - rows.values.mean())]
    directions += list(np.random.default_rng(0).standard_normal((SETTINGS.effort.beam, len(columns))))
    for direction in directions:
        spread = float((direction @ unit).std())
        for steepness in _STEEPNESS if spread > 0.0 else ():
            weights = direction / np.where(sizes > 0.0, sizes, 1.0) * (steepness / spread)
            yield np.concatenate([[-float(weights @ means)], weights])


def _sum(rows: RateRows, begun: Sequence[Atom], columns: Sequence[int], weights: FloatArray) -> RateSum | None:
    """Return the fitted sum with the tangent of these weights, the constant's first; None without a weight."""
    shape = _shape(rows.inputs, columns, weights)
    return None if shape is None else fitted(rows, [*begun, Atom(*shape)])


def _shape(inputs: FloatArray, columns: Sequence[int], weights: FloatArray) -> tuple[Shape, float] | None:
    """Return the tangent and its inner constant, by which the weights of its argument are divided."""
    scale = float(max(weights[1:], key=abs))
    if not scale or not np.isfinite(weights).all():
        return None
    argument: Expression | None = None
    for column, weight in zip(columns, (weights[1:] / scale).tolist(), strict=True):
        part: Expression = (VARIABLE, column) if weight == 1.0 else (MULTIPLY, weight, (VARIABLE, column))
        if weight:
            argument = part if argument is None else (ADD, argument, part)
    assert argument is not None
    if weights[0]:
        argument = (ADD, argument, float(weights[0]) / scale)
    u = (weights[1:] @ inputs[list(columns)] + weights[0]) / scale
    return Shape((), np.ones(inputs.shape[1]), SCALED[TANH], argument, u), scale


def _pruned(
    rows: RateRows, begun: Sequence[Atom], columns: Sequence[int], node: _Node, numbers: FloatArray, best: RateSum
) -> RateSum:
    """Return the sum without the weights that it can do without, the least one after another."""
    first = len(begun) + 1
    sizes = np.sqrt((node.inputs**2).mean(axis=1))
    kept = list(range(len(sizes)))
    while len(kept) > 1:
        least = min(kept, key=lambda place: abs(numbers[first + place]) * sizes[place])
        fewer = [place for place in kept if place != least]
        trial = np.zeros_like(numbers)
        chosen = [*range(first), *(first + place for place in fewer)]
        trial[chosen] = replace(node, inputs=node.inputs[fewer]).fit(numbers[chosen])
        fitted_sum = _sum(rows, begun, columns, trial[first:])
        if fitted_sum is None or not fitted_sum.nats < best.nats:
            return best
        best, numbers, kept = fitted_sum, trial, fewer
    return best
