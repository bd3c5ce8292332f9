"""Noisy measurements of the paper's systems, and what a model of them is judged by.

Noise is Gaussian, its standard deviation a share of each state's pooled standard deviation. One seed has one draw of
initial conditions and of noise, scaled over the levels: four trajectories of 100 points at a step of 0.1.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import RUNS, SYSTEMS, Sampled, drawn, solutions, table_of, with_noise

POINTS: Final = 100
TIMES: Final[FloatArray] = np.arange(POINTS, dtype=np.float64) * 0.1
_FRESH: Final = 4
"""Tells the stream of fresh trajectories from those that are measured."""


@dataclass(frozen=True, order=True)
class Key:
    """Which search: by what `method`, on which data."""

    method: str
    system: str
    level: float
    seed: int
    length: float = 0.0
    """Of a trajectory, in time units; 0: that of the paper."""

    @property
    def title(self) -> str:
        """The key as people read it."""
        length = f" length {self.length:g}" if self.length else ""
        return f"{self.system} noise {self.level:g}{length} seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Path:
    """One true trajectory: `times` (n,), `states` (n, S)."""

    times: FloatArray
    states: FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """What is measured, and what a model is judged by.

    `truths` has the right-hand sides by state, in the order of the states; `clean` the values (R,) without noise of
    every state; `fresh` are trajectories from initial conditions that were not measured.
    """

    table: Table
    truths: Mapping[str, str]
    clean: Mapping[str, FloatArray]
    fresh: tuple[Path, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Variables of expressions."""
        return tuple(self.clean)

    def slope(self, state: str) -> FloatArray:
        """Return the true derivative (R,) of `state` where it was measured, not finite where the truth is not."""
        return values_of(from_infix(self.truths[state], self.names), np.array([*self.clean.values()]))


def case(key: Key) -> Case:
    """Return the data of one search; equal keys give equal data, whatever the method."""
    system = SYSTEMS[key.system]
    clean, rng = _clean(key.system, key.seed)
    noisy = with_noise(clean, key.level, deepcopy(rng))
    table = table_of(Sampled(system.states, (TIMES,) * RUNS, tuple(noisy)))
    columns = dict(zip(system.states, np.concatenate(clean).T, strict=True))
    return Case(table, system.truth, columns, (fresh(key.system, key.seed),))


@lru_cache(maxsize=64)
def _clean(system: str, seed: int) -> tuple[list[FloatArray], np.random.Generator]:
    """Return trajectories before noise, and the stream that the noise comes from."""
    rng = np.random.default_rng(seed)
    return solutions(SYSTEMS[system], (TIMES,) * RUNS, rng), rng


@lru_cache(maxsize=64)
def fresh(system: str, seed: int) -> Path:
    """Return a trajectory of the paper's length from the system's own distribution of initial conditions."""
    return Path(TIMES, drawn(SYSTEMS[system], np.random.default_rng([seed, _FRESH]), TIMES))
