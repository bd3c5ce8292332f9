"""Noisy measurements of known systems, in several manners of sampling, and what a model of them is judged by.

Noise is Gaussian, its standard deviation a share of each state's pooled standard deviation. One seed has one draw of
initial conditions and of noise, scaled over the levels. Every manner has about 400 rows in four trajectories; ``plain``
is the paper's: 100 points each at a step of 0.1. ``odd`` is the same of systems whose constants are no simple numbers.
"""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal, get_args

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import RUNS, SYSTEMS, Sampled, System, drawn, solutions, table_of, with_noise
from benchmarks.noise.odd_systems import ODD

STEP: Final = 0.1
POINTS: Final = 100
LENGTHS: Final = (40, 70, 110, 180)
"""Points of the four trajectories of different lengths; 400 in all."""

MISSING: Final = 0.3
"""Share of the rows of which a cell is missing."""

Variant = Literal["plain", "uneven", "missing", "lengths", "odd"]
VARIANTS: Final[tuple[Variant, ...]] = get_args(Variant)
_FRESH: Final = 4
"""Tells the stream of fresh trajectories from those of the manners of sampling."""

Signal = Callable[[float], float]


@dataclass(frozen=True, order=True)
class Key:
    """Which search: by what `method`, on which data."""

    method: str
    variant: Variant
    system: str
    level: float
    seed: int

    @property
    def title(self) -> str:
        """The key as people read it."""
        variant = "" if self.variant == "plain" else f" {self.variant}"
        return f"{self.system}{variant} noise {self.level:g} seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Path:
    """One true trajectory: `times` (n,), `states` (n, S), and the inputs as functions of time."""

    times: FloatArray
    states: FloatArray
    inputs: tuple[Signal, ...] = ()


@dataclass(frozen=True, eq=False)
class Case:
    """What is measured, and what a model is judged by.

    `truths` has the right-hand sides by state, in the order of the states; `clean` the values (R,) without noise of
    every variable, inputs behind the states; `fresh` is a trajectory from initial conditions that were not measured.
    `data` are fields of the configuration's data section that the table needs.
    """

    table: Table
    truths: Mapping[str, str]
    clean: Mapping[str, FloatArray]
    fresh: Path
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Variables of expressions."""
        return tuple(self.clean)

    def slope(self, state: str) -> FloatArray:
        """Return the true derivative (R,) of `state` where it was measured, not finite where the truth is not."""
        return values_of(from_infix(self.truths[state], self.names), np.array([*self.clean.values()]))


def case(key: Key) -> Case:
    """Return the data of one search; equal keys give equal data, whatever the method."""
    system = _system(key.system, key.variant)
    clean = _clean(key.system, key.variant, key.seed)
    noisy = with_noise(clean.states, key.level, deepcopy(clean.rng))
    table = table_of(Sampled(system.states, clean.times, tuple(noisy)))
    data: dict[str, Any] = {}
    if key.variant == "missing":
        _lose(table, _chance(key.variant, key.seed))
        data["missing"] = "drop"
    columns = dict(zip(system.states, np.concatenate(clean.states).T, strict=True))
    return Case(table, system.truth, columns, fresh(key.system, key.seed, key.variant), data)


@dataclass(frozen=True, eq=False)
class _Clean:
    """Trajectories before noise, and the stream that the noise comes from."""

    times: tuple[FloatArray, ...]
    states: tuple[FloatArray, ...]
    rng: np.random.Generator


@lru_cache(maxsize=64)
def _clean(system: str, variant: Variant, seed: int) -> _Clean:
    rng = np.random.default_rng(seed)
    times = _times(variant, _chance(variant, seed))
    return _Clean(times, tuple(solutions(_system(system, variant), times, rng)), rng)


@lru_cache(maxsize=64)
def fresh(system: str, seed: int, variant: Variant = "plain") -> Path:
    """Return a trajectory of the paper's length from the system's own distribution of initial conditions."""
    rng = np.random.default_rng([seed, _FRESH])
    times = _grid(POINTS)
    return Path(times, drawn(_system(system, variant), rng, times))


def _system(name: str, variant: Variant) -> System:
    return ODD[name] if variant == "odd" else SYSTEMS[name]


def _chance(variant: Variant, seed: int) -> np.random.Generator:
    """Return the stream that decides when is measured and what is missing."""
    return np.random.default_rng([seed, VARIANTS.index(variant)])  # unused by plain and odd


def _times(variant: Variant, chance: np.random.Generator) -> tuple[FloatArray, ...]:
    if variant == "uneven":
        return tuple(np.sort(chance.uniform(0.0, (POINTS - 1) * STEP, POINTS)) for _ in range(RUNS))
    if variant == "lengths":
        return tuple(_grid(points) for points in LENGTHS)
    return (_grid(POINTS),) * RUNS


def _grid(points: int) -> FloatArray:
    return np.arange(points, dtype=np.float64) * STEP


def _lose(table: Table, chance: np.random.Generator) -> None:
    """Empty a cell of as many rows as `MISSING` says; ``--missing drop`` leaves those rows out."""
    rows = chance.choice(table.rows, round(MISSING * table.rows), replace=False)
    table.columns[chance.integers(1, len(table.names), len(rows)), rows] = np.nan
