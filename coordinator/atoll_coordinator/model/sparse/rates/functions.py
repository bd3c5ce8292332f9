"""Which products with a function a polynomial lacks: all are compared, the polynomial projected out.

On the rows whose derivatives are known best: errors of the others would decide. Inner constants are fitted one by one.

Letters: A atoms, K terms, N rows.
"""

import math
from collections.abc import Callable, Collection, Sequence

import numpy as np

from atoll_coordinator.model.least_squares import coefficients_of
from atoll_coordinator.model.sparse.kernels.robust import NORMAL_DEVIATION
from atoll_coordinator.model.sparse.products import products
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows
from atoll_coordinator.model.sparse.rates.rate_sums import RateSum, fitted, polished
from atoll_coordinator.model.sparse.shapes import Atom, Shape, powers, shapes
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import DIVIDE

_NARROWED = 1e-5
"""Numerics: the logarithm of an inner constant is found to that."""
_DEPENDENT = 1e-7
"""Share of a column beyond the polynomial that is rounding."""


def extended(
    rows: RateRows, begun: Sequence[Atom], columns: Sequence[int], operators: Collection[int]
) -> list[tuple[Atom, ...]]:
    """Return `begun` with one product with a function more, the best first, inner constants fitted.

    Args:
        rows: of the derivative; the trusted share of them counts.
        begun: terms that are there already.
        columns: variables that may be used.
        operators: codes of operators that may be used.
    """
    trusted = rows.trusted()
    if len(trusted.values) < SETTINGS.sparse.rows_per_term * len(begun):
        return []
    here = [Atom(atom.shape.over(trusted.inputs), atom.constant) for atom in begun]
    beside = Beside(np.array([atom.values for atom in here]), trusted.values, trusted.errors)
    ends: list[RateSum] = []
    for atom in beside.best_atoms(dictionary(trusted.inputs, columns, operators)):
        joined = fitted(trusted, [*here, atom])
        if joined is not None:
            ends.append(polished(trusted, joined))
    ends.sort(key=lambda end: end.nats)
    return [tuple(Atom(atom.shape.over(rows.inputs), atom.constant) for atom in end.atoms) for end in ends]


def dictionary(inputs: FloatArray, columns: Sequence[int], operators: Collection[int]) -> list[Shape]:
    """Return products of up to two variables with functions, of one or none where there are too many.

    Where all functions are too many for two variables, quotients are taken by themselves: most laws with many variables
    have these.
    """
    both = _products(inputs, columns, operators, 2)
    if both is not None:
        return both
    quotients = _products(inputs, columns, {DIVIDE} & set(operators), 2)
    rest = set(operators) if quotients is None else set(operators) - {DIVIDE}
    others = next((those for degree in (1, 0) if (those := _products(inputs, columns, rest, degree)) is not None), [])
    return [*(quotients or ()), *others]


def _products(
    inputs: FloatArray, columns: Sequence[int], operators: Collection[int], degree: int
) -> list[Shape] | None:
    """Return products of variables up to a degree with functions, None where there are too many."""
    plain = powers(inputs, products(columns, degree))
    single = shapes(inputs, columns, operators, plain[:1], has_powers=True)
    if len(plain) * sum(len(shape.constants()) for shape in single) > SETTINGS.rates.most_atoms:
        return None
    return list(shapes(inputs, columns, operators, plain, has_powers=True))


class Beside:
    """What terms leave of a derivative, and what others explain of that. Rows weigh by errors and by what is missing.

    The variance of what is missing, the same on all rows, is that which makes the median residual normal.

    Args:
        columns: terms (K, N).
        values: the derivative (N,), or what stands for it.
        errors: its standard errors (N,).
        sampled: what makes columns (A, N) of the values of atoms.
    """

    def __init__(
        self,
        columns: FloatArray,
        values: FloatArray,
        errors: FloatArray,
        sampled: Callable[[FloatArray], FloatArray] = lambda values: values,
    ) -> None:
        self._sampled = sampled
        missing, weights = float(values.std()), np.ones(len(values))
        for _ in range(SETTINGS.effort.steps):
            weights = 1.0 / np.sqrt(errors**2 + missing**2)
            left = values - coefficients_of(columns * weights, values * weights) @ columns
            square = (NORMAL_DEVIATION * float(np.median(np.abs(left)))) ** 2 - float(np.median(errors)) ** 2
            before, missing = missing, math.sqrt(max(square, 0.0))
            if abs(missing - before) <= 1e-2 * before:
                break
        self._weights = weights
        sizes = np.sqrt(((columns * weights) ** 2).sum(axis=1))[:, None]
        self._basis = np.linalg.qr((columns * weights / np.where(sizes > 0.0, sizes, 1.0)).T)[0]
        self._left = self._projected(values[None])[0]
        self._square = float(self._left @ self._left)

    def _projected(self, values: FloatArray) -> FloatArray:
        """Return what the terms leave of weighted `values` (A, N)."""
        remainder = values * self._weights
        for _ in range(2):  # the second time for what rounding left
            remainder = remainder - (remainder @ self._basis) @ self._basis.T
        return np.asarray(remainder)

    def best_atoms(self, tried: Sequence[Shape]) -> list[Atom]:
        """Return the few atoms that explain most, inner constants fitted one by one."""
        candidates = [
            candidate
            for candidate in (self.narrowed(shape, near) for shape, near in self.best(tried))
            if candidate is not None
        ]
        candidates.sort(key=lambda candidate: candidate[0])
        return [atom for _, atom in candidates[: SETTINGS.effort.beam]]

    def best(self, tried: Sequence[Shape]) -> list[tuple[Shape, float]]:
        """Return the shapes that explain most with the inner constants, on their grids, at which they do.

        A shape may have several: those that explain more than the constants beside them.
        """
        ranked: list[tuple[float, int, float]] = []
        with np.errstate(all="ignore"):
            for index, shape in enumerate(tried):
                constants = list(shape.constants())
                gains = self._gains(self._sampled(np.array([shape.value(constant) for constant in constants])))
                around = np.concatenate([[-1.0], gains, [-1.0]])
                peaks = np.flatnonzero((gains >= around[:-2]) & (gains >= around[2:]))
                ranked += [(-float(gains[peak]), index, constants[peak]) for peak in peaks]
        ranked.sort()
        return [(tried[index], constant) for _, index, constant in ranked[: SETTINGS.effort.kept]]

    def _gains(self, columns: FloatArray) -> FloatArray:
        if not len(columns):
            return np.zeros(0)
        sizes = np.sqrt(((columns * self._weights) ** 2).sum(axis=1))
        beside = self._projected(columns)
        norms = np.sqrt((beside**2).sum(axis=1))
        gains = np.where(norms > _DEPENDENT * sizes, (beside @ self._left) / np.maximum(norms, 1e-300), 0.0) ** 2
        return np.asarray(np.where(np.isfinite(gains) & np.isfinite(sizes), gains, 0.0))

    def narrowed(self, shape: Shape, near: float) -> tuple[float, Atom] | None:
        """Return the share that the shape leaves at the best inner constant between those beside `near`, and its atom.

        None where it explains nothing.
        """

        def left(constant: float) -> float:
            with np.errstate(all="ignore"):
                return 1.0 - float(self._gains(self._sampled(shape.value(constant)[None]))[0]) / self._square

        from scipy.optimize import minimize_scalar

        if not self._square > 0.0:
            return None
        best = near
        if shape.has_constant:
            bounds = [math.log(abs(constant)) for constant in _bracket(sorted(shape.constants(), key=abs), near)]
            found = minimize_scalar(
                lambda size: left(math.copysign(math.exp(size), near)), bounds=bounds, method="bounded",
                options={"xatol": _NARROWED},
            )  # fmt: skip
            best = math.copysign(math.exp(found.x), near)
        share = left(best)
        return (share, Atom(shape, best)) if share < 1.0 else None


def _bracket(grid: Sequence[float], near: float) -> tuple[float, float]:
    """Return the constants of a grid on either side of `near`, of its sign, beyond its ends by the same ratio."""
    constants = [constant for constant in grid if (constant > 0.0) == (near > 0.0)]
    place = constants.index(near)
    ratio = constants[place] / constants[place - 1] if place else constants[1] / constants[0] if constants[1:] else 2.0
    low = constants[place - 1] if place else near / ratio
    return low, constants[place + 1] if place + 1 < len(constants) else near * ratio
