"""The box of states that an analysis looks at."""

from dataclasses import dataclass

import numpy as np

from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Box:
    """Lower and upper bounds of D states, both (D,), lower < upper."""

    lower: FloatArray
    upper: FloatArray

    @property
    def widths(self) -> FloatArray:
        """The widths (D,)."""
        return self.upper - self.lower

    @property
    def middle(self) -> FloatArray:
        """The middle (D,)."""
        return 0.5 * (self.lower + self.upper)

    def points(self, count: int, seed: int = 0) -> FloatArray:
        """Return `count` points (count, D) spread evenly over the box: an additive recurrence (Roberts 2018).

        Its ratios are powers of the root of g**(D + 1) = g + 1; `seed` numbers disjoint stretches of it.
        """
        size, root = len(self.lower), 1.5
        for _ in range(64):
            root = (1.0 + root) ** (1.0 / (size + 1))
        ratios = root ** -np.arange(1.0, size + 1)
        numbers = np.arange(1.0, count + 1) + seed * count
        return np.asarray(self.lower + self.widths * ((0.5 + numbers[:, None] * ratios) % 1.0))

    def excursions(self, states: FloatArray) -> FloatArray:
        """Return how far states (N, D) are from the middle, (N,), in the width by which they are farthest from it."""
        return np.asarray((np.abs(states - self.middle) / self.widths).max(axis=1))

    def contains(self, points: FloatArray, margin: float = 0.0) -> np.ndarray:
        """Tell of each point (N, D) whether it lies in the box widened by `margin` widths."""
        beyond = margin * self.widths
        return np.asarray(((points >= self.lower - beyond) & (points <= self.upper + beyond)).all(axis=-1))
