"""The box of states that an analysis looks at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.hints import did_you_mean


@dataclass(frozen=True, eq=False)
class Box:
    """Lower and upper bounds of D states, both (D,), lower < upper."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, states: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> "Box":
        """Return the box of these bounds by state; raises UsageError where a state has none or they are no interval."""
        for name in bounds:
            if name not in states:
                hint = did_you_mean(name, states)
                raise UsageError(f"there is no state '{name}' to bound; the states are {', '.join(states)}{hint}")
        for name in states:
            if name not in bounds:
                raise UsageError(f"state '{name}' was not measured, so that the box needs its lower and upper bound")
            lower, upper = bounds[name]
            if not (np.isfinite([lower, upper]).all() and lower < upper):
                raise UsageError(
                    f"the bounds {lower:g} and {upper:g} of '{name}' are no interval; give the lower one first"
                )
        ends = np.array([bounds[name] for name in states], dtype=np.float64)
        return cls(ends[:, 0].copy(), ends[:, 1].copy())

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

    def contains(self, points: FloatArray, margin: float = 0.0) -> np.ndarray:
        """Tell of each point (N, D) whether it lies in the box widened by `margin` widths."""
        beyond = margin * self.widths
        return np.asarray(((points >= self.lower - beyond) & (points <= self.upper + beyond)).all(axis=-1))
