"""Laws of textbooks that short tables are drawn from, and how long each is measured.

Laws of the second order have velocities whose names end in ``_dot``. Initial values are in units of a constant where
one is named. The duration is in units of the reciprocal of what `rate` makes of the constants.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

Constants = Mapping[str, float]
Box = tuple[float, float, str | None]


@dataclass(frozen=True)
class Law:
    """Right-hand sides over constants, their ranges, initial values and duration of a run."""

    equations: Mapping[str, str]
    constants: Mapping[str, tuple[float, float]]
    box: tuple[Box, ...]
    rate: Callable[[Constants], float]
    duration: tuple[float, float]
    order: int = 1

    @property
    def measured(self) -> tuple[str, ...]:
        """States that a table has."""
        return tuple(state for state in self.equations if self.order == 1 or not state.endswith("_dot"))

    def draw_constants(self, rng: np.random.Generator) -> dict[str, float]:
        """Return constants of two digits, drawn evenly in the logarithm."""
        drawn = {name: math.exp(rng.uniform(math.log(low), math.log(high))) for name, (low, high) in
                 self.constants.items()}  # fmt: skip
        return {name: float(f"{value:.2g}") for name, value in drawn.items()}

    def draw_start(self, constants: Constants, rng: np.random.Generator) -> tuple[float, ...]:
        """Return an initial state."""
        return tuple(
            float(f"{rng.uniform(low, high) * (constants[unit] if unit else 1.0):.3g}") for low, high, unit in self.box
        )

    def draw_duration(self, constants: Constants, rng: np.random.Generator) -> float:
        """Return how long a run is measured."""
        return float(rng.uniform(*self.duration)) / self.rate(constants)


DECAY: Final = Law({"x": "-k1*x"}, {"k1": (0.1, 3.0)}, ((2.0, 100.0, None),), lambda k: k["k1"], (1.5, 4.0))
COOLING: Final = Law(
    {"x": "k1*(k2 - x)"}, {"k1": (0.02, 0.5), "k2": (15.0, 25.0)}, ((50.0, 95.0, None),), lambda k: k["k1"], (1.5, 4.0)
)
LOGISTIC: Final = Law(
    {"x": "k1*x*(1.0 - x/k2)"}, {"k1": (0.2, 2.0), "k2": (1.0, 200.0)}, ((0.02, 0.3, "k2"),), lambda k: k["k1"],
    (4.0, 9.0),
)  # fmt: skip
GOMPERTZ: Final = Law(
    {"x": "k1*x - k2*x*log(x)"}, {"k1": (0.5, 2.0), "k2": (0.3, 1.0)}, ((0.2, 0.9, None),), lambda k: k["k2"],
    (3.0, 6.0),
)  # fmt: skip
ENZYME: Final = Law(
    {"x": "-k1*x/(k2 + x)"}, {"k1": (0.2, 3.0), "k2": (0.5, 2.0)}, ((2.0, 6.0, "k2"),),
    lambda k: k["k1"] / k["k2"], (3.0, 8.0),
)  # fmt: skip
OSCILLATOR: Final = Law(
    {"x": "v", "v": "-k1*x - k2*v"}, {"k1": (0.5, 9.0), "k2": (0.05, 0.4)}, ((0.5, 3.0, None), (-1.0, 1.0, None)),
    lambda k: math.sqrt(k["k1"]), (4.0, 9.0),
)  # fmt: skip
SPRING: Final = Law(
    {"x": "x_dot", "x_dot": "-k1*x - k2*x_dot"}, {"k1": (0.5, 9.0), "k2": (0.05, 0.4)},
    ((0.5, 3.0, None), (-1.0, 1.0, None)), lambda k: math.sqrt(k["k1"]), (4.0, 9.0), 2,
)  # fmt: skip
PREY: Final = Law(
    {"x": "k1*x - k2*x*y", "y": "k3*x*y - k4*y"},
    {"k1": (0.5, 1.5), "k2": (0.2, 1.0), "k3": (0.1, 0.5), "k4": (0.3, 1.0)}, ((1.0, 6.0, None), (0.5, 3.0, None)),
    lambda k: math.sqrt(k["k1"] * k["k4"]), (5.0, 10.0),
)  # fmt: skip

LAWS: Final = {
    "decay": DECAY,
    "cooling": COOLING,
    "logistic": LOGISTIC,
    "Gompertz": GOMPERTZ,
    "oscillator": OSCILLATOR,
    "spring": SPRING,
    "enzyme": ENZYME,
    "prey": PREY,
}
"""By name; `spring` is the oscillator by its positions alone."""
