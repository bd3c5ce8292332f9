"""Sums of fewer terms, and of more: elimination, forward selection, terms taken in again, terms that can be spared.

What a sum is fitted to says who asks: windows, derivatives with errors of their own, or trajectories. A fit has the
nats of its description, by which fits are compared.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from atoll_coordinator.model.sparse.kernels.elimination import eliminate
from atoll_coordinator.model.sparse.kernels.least_squares import DEPENDENT, windowed_sums
from atoll_core.data.dataset import FloatArray


class Fit(Protocol):
    """A sum of terms that has been fitted."""

    @property
    def nats(self) -> float:
        """The length of its description."""


Fitted = TypeVar("Fitted", bound=Fit)
Item = TypeVar("Item")


def shortest(fits: Iterable[Fitted | None]) -> Fitted | None:
    """Return the fit of the shortest description, the first of equal ones; None where there is none."""
    return min((fit for fit in fits if fit is not None), key=lambda fit: fit.nats, default=None)


def on_the_way(fit: Item, without_least: Callable[[Item], Item | None]) -> Iterator[Item]:
    """Yield a fit, then that without its least significant term, and so on as long as there is one."""
    following: Item | None = fit
    while following is not None:
        yield following
        following = without_least(following)


def improved(best: Fitted, nearby: Callable[[Fitted], Iterable[Fitted | None]], least_gain: float = 0.0) -> Fitted:
    """Return the end of a search that goes to the shortest of the fits nearby as long as that gains more than this."""
    while True:
        nearest = shortest(nearby(best))
        if nearest is None or not nearest.nats < best.nats - least_gain:
            return best
        best = nearest


def without_one(kept: Sequence[Item], most: int | None = None) -> Iterator[tuple[Item, ...]]:
    """Yield the terms of a sum without each of them in turn; nothing of a single one, or of more than `most`."""
    for place in range(len(kept)) if 1 < len(kept) <= (most or len(kept)) else ():
        yield (*kept[:place], *kept[place + 1 :])


@dataclass(frozen=True, eq=False)
class Elimination:
    """The sums on the way from all columns (K, N) to nothing, by least squares (Wald's test).

    `order` (K,) are the columns as they go, `squares` (K + 1,) what is left with the last K, K - 1, ... 0 of these, at
    each step the `coefficients` (K, K).
    """

    order: list[int]
    squares: FloatArray
    coefficients: FloatArray

    def kept(self, step: int) -> list[int]:
        """Return which columns there are at a step."""
        return sorted(self.order[step:])

    def factors(self, step: int) -> list[float]:
        """Return the coefficients of those."""
        return [float(self.coefficients[step, place]) for place in self.kept(step)]


def eliminated(
    columns: FloatArray | Sequence[FloatArray], sides: FloatArray, errors: tuple[FloatArray, FloatArray] | None = None
) -> Elimination:
    """Return the elimination of `columns` (K, N) that describe `sides` (N,).

    Products of columns have the mean `errors` (K, K), with the sides (K,); fewer terms leave no less than all do.
    """
    count = len(columns)
    products, cross = (np.zeros((0, 0)), np.zeros(0)) if errors is None else errors
    order, coefficients = np.zeros(count, np.int64), np.zeros((count, count))
    squares, added = np.zeros((2, count + 1))
    eliminate(
        np.ascontiguousarray(columns), np.ascontiguousarray(sides), np.ascontiguousarray(products), cross, order,
        squares, coefficients, added,
    )  # fmt: skip
    return Elimination(order.tolist(), np.maximum(squares - added + added[0], squares[0]), coefficients)


def selected_forward(columns: FloatArray, side: FloatArray) -> Iterator[tuple[int, float]]:
    """Yield the column (K, N) that explains most of what is left of `side` (N,), and so on, with the square left then.

    That is orthogonal matching pursuit; it ends where no column is left. Sums have a fixed order.
    """
    sizes = np.sqrt(_dots(columns * columns, np.ones_like(side)))
    rest, left = columns / np.where(sizes > 0.0, sizes, 1.0)[:, None], side
    free = np.where(sizes > 0.0, 1.0, 0.0)
    while True:
        gains = np.where(free > DEPENDENT, _dots(rest, left) ** 2 / np.maximum(free, DEPENDENT), 0.0)
        best = int(np.argmax(gains))
        if not gains[best] > 0.0:
            return
        unit = rest[best] / np.sqrt(free[best])
        left = left - _dots(left[None], unit) * unit
        rest = rest - _dots(rest, unit)[:, None] * unit
        free = _dots(rest * rest, np.ones_like(side))
        free[best] = 0.0
        yield best, float(_dots(left[None], left)[0])


def _dots(columns: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the products (K,) of columns (K, N) with a vector (N,)."""
    sums = np.zeros((len(columns), 1))
    windowed_sums(np.zeros(1, np.int64), np.ascontiguousarray(vector)[None], np.ascontiguousarray(columns), sums)
    return sums[:, 0]
