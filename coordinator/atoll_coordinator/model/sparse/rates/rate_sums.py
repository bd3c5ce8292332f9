"""Sums of products with functions, fitted to derivatives robustly, and the shortest of them.

Errors of derivatives are systematic: of a sum they decide as few independent numbers do, however many rows there are.
So its misfit is that of `systematic_numbers` numbers with the scale of what it leaves.

Letters: K terms, N rows.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.least_squares import Descent, Solver, minimize, solver
from atoll_coordinator.model.sparse.elimination import eliminated, improved, shortest, without_one
from atoll_coordinator.model.sparse.kernels.robust import robust_fit
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows
from atoll_coordinator.model.sparse.shapes import Atom, program_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program


@dataclass(frozen=True, eq=False)
class RateSum:
    """A fitted sum: its terms, coefficients (K,), weights of rows (N,), the `scale` of what it leaves, its `nats`.

    `scale` is in standard errors of the derivative: of about half the rows the error is at most 0.67 times as large.
    """

    atoms: tuple[Atom, ...]
    coefficients: FloatArray
    weights: FloatArray
    scale: float
    nats: float

    def program(self) -> Program:
        """Return the sum as an expression."""
        return program_of(self.atoms, self.coefficients)


_LEAST_SCALE = 1e-6
"""Guard: scales below this are rounding."""


def fitted(rows: RateRows, atoms: Sequence[Atom], weights: FloatArray | None = None) -> RateSum | None:
    """Return the sum of these terms; None where one has no finite value, or there are more terms than rows."""
    columns = np.array([atom.values for atom in atoms])
    if len(atoms) >= len(rows.values) or not np.isfinite(columns).all():
        return None
    coefficients = np.zeros(len(atoms))
    begun = np.ones(len(rows.values)) if weights is None else weights.copy()
    scale = robust_fit(columns, rows.values, rows.errors, SETTINGS.effort.steps, coefficients, begun)
    misfit = SETTINGS.selection.systematic_numbers * log(max(scale, _LEAST_SCALE))
    price = math.fsum(atom.shape.price(len(rows.values)) for atom in atoms)
    return RateSum(tuple(atoms), coefficients, begun, scale, misfit + price)


def shortest_sum(rows: RateRows, atoms: Sequence[Atom]) -> RateSum | None:
    """Return the shortest description among the sums on the way from all `atoms` to one (Wald's test).

    The order in which terms go is that of the weights of all; each sum of a few terms is then fitted for itself.
    """
    whole = fitted(rows, atoms)
    if whole is None:
        return None
    factors = whole.weights / rows.errors
    columns = np.array([atom.values for atom in atoms]) * factors
    path = eliminated(columns, rows.values * factors)
    steps = range(max(1, len(atoms) - SETTINGS.effort.longest_sum), len(atoms))
    shorter = (fitted(rows, [atoms[place] for place in path.kept(step)], whole.weights) for step in steps)
    return pruned(rows, shortest([whole, *shorter]) or whole)


def pruned(rows: RateRows, best: RateSum) -> RateSum:
    """Return the sum without the terms that it can do without, one after another."""

    def fewer(rate_sum: RateSum) -> Iterator[RateSum | None]:
        for atoms in without_one(rate_sum.atoms, SETTINGS.effort.longest_sum):
            yield fitted(rows, atoms, rate_sum.weights)

    return improved(best, fewer)


def polished(rows: RateRows, rate_sum: RateSum) -> RateSum:
    """Return the sum with its inner constants fitted, weights of rows as they are in each step."""
    inner = [place for place, atom in enumerate(rate_sum.atoms) if atom.shape.has_constant]

    def linearise(at: RateSum) -> Solver[FloatArray]:
        columns = np.array([atom.shape.value(atom.constant) for atom in at.atoms])
        slopes = [at.coefficients[place] * at.atoms[place].shape.slope(at.atoms[place].constant) for place in inner]
        left = (rows.values - at.coefficients @ columns) * at.weights / rows.errors
        jacobian = np.array([*columns, *slopes]) * at.weights / rows.errors
        unit = SETTINGS.selection.systematic_numbers / max(float(left @ left), 1e-300)  # nats for half a square
        return solver(unit * (jacobian @ jacobian.T), -unit * (jacobian @ left))

    def move(at: RateSum, step: FloatArray) -> tuple[RateSum, float] | None:
        moves = dict(zip(inner, step[len(at.atoms) :].tolist(), strict=True))
        atoms = [atom.moved(moves.get(place, 0.0)) for place, atom in enumerate(at.atoms)]
        following = fitted(rows, atoms, at.weights)
        return None if following is None else (following, at.nats - following.nats)

    return minimize(Descent(rate_sum, linearise, move)) if inner else rate_sum
