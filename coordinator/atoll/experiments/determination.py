"""What the data determine of each constant of a model, as it is said. Letters: P constants, n points of a profile."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from atoll.analysis.plain_data import plain
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.quoting import first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1

Determination = Literal[
    "determined", "open above", "open below", "practically non-identifiable", "structurally non-identifiable"
]
"""An interval that is closed, has no upper or no lower end, neither; or the deviance does not change at all
(Raue et al. 2009)."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction in the space of constants.

    `error` is the standard error along it, over the sizes of the constants (infinite: not determined at all); `weights`
    (P,) its components, of length 1; `is_sloppy` tells whether the data leave it open; `words` says what of the
    constants is determined, "" where it is not sloppy.
    """

    error: float
    weights: FloatArray
    is_sloppy: bool
    words: str


@dataclass(frozen=True, eq=False)
class ProfiledConstant:
    """A constant with its profile, in the sign that the text of its equation gives it.

    `estimate` is the best value, `std_error` the standard error by the curvature there (infinite: none), `interval` by
    the profile, `quadratic` the estimate plus and minus the quantile times the standard error.
    """

    name: str
    variable: str
    is_written: bool
    estimate: float
    std_error: float
    interval: tuple[float, float]
    quadratic: tuple[float, float]
    verdict: Determination
    is_cut: tuple[bool, bool]
    values: FloatArray = field(repr=False)
    deviances: FloatArray = field(repr=False)

    @property
    def _digits(self) -> int:
        """How many digits tell the ends of the interval apart, and two more; four at least."""
        largest = max((abs(end) for end in self.interval if math.isfinite(end)), default=0.0)
        width = self.interval[1] - self.interval[0]
        return max(4, math.ceil(math.log10(largest / width)) + 2) if 0.0 < width < largest else 4

    @property
    def sentence(self) -> str:
        """What is known of it, in a sentence without its name."""
        low, high = (f"{end:.{self._digits}g}" for end in self.interval)
        ends = {
            "determined": f": {low} to {high}",
            "open above": f": at least {low}",
            "open below": f": at most {high}",
        }
        return f"{self.estimate:.{self._digits}g}, {self.verdict}{ends.get(self.verdict, '')}"


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data determine of the constants of a model.

    `quantile` is that of Student's t at `level` with `freedom` degrees, and the deviance is compared with its square.
    `directions` are of all constants together, the least determined first. `source` says which data, `piece` in pieces
    of how many rows trajectories were simulated.
    """

    level: float
    freedom: float
    quantile: float
    constants: tuple[ProfiledConstant, ...]
    directions: tuple[Direction, ...]
    source: str
    piece: int

    def __getitem__(self, name: str) -> ProfiledConstant:
        """Return a constant by name; raises KeyError."""
        return {constant.name: constant for constant in self.constants}[name]

    @property
    def sloppy(self) -> tuple[Direction, ...]:
        """The directions that the data leave open."""
        return tuple(direction for direction in self.directions if direction.is_sloppy)

    def __str__(self) -> str:
        lines = [f"identifiability ({100 * self.level:g} % profile likelihood; {self.source}):"]
        lines += [f"  {constant.name} = {constant.sentence}" for constant in self.constants]
        lines += [f"  {direction.words}" for direction in self.sloppy]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the constants, a row each, with the ends `lower` and `upper` of their intervals (infinite: open).

        As a frame of ``"polars"`` or ``"pandas"``; raises UsageError if it is missing.
        """
        constants = self.constants
        named = ("name", "variable", "estimate", "std_error", "verdict")
        columns: dict[str, list[object]] = {name: [getattr(each, name) for each in constants] for name in named}
        ends: dict[str, list[object]] = {
            name: [each.interval[place] for each in constants] for place, name in enumerate(("lower", "upper"))
        }
        return frame_of(columns | ends, library)

    def as_dict(self) -> dict[str, object]:
        """Return all of it as plain data; null is infinite."""
        names = [constant.name for constant in self.constants]
        return plain(
            {
                "schema": SCHEMA,
                "level": self.level,
                "freedom": self.freedom,
                "threshold": self.quantile**2,
                "data": self.source,
                "piece": self.piece,
                "constants": [_constant_data(constant) for constant in self.constants],
                "directions": [
                    {
                        "error": direction.error,
                        "weights": dict(zip(names, direction.weights, strict=True)),
                        "is_sloppy": direction.is_sloppy,
                        "words": direction.words,
                    }
                    for direction in self.directions
                ],
            }
        )


def _constant_data(constant: ProfiledConstant) -> dict[str, object]:
    data: dict[str, object] = {**vars(constant), "sentence": constant.sentence}
    profile = {name: data.pop(name) for name in ("values", "deviances")}
    return {**data, "profile": profile}
