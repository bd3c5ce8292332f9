"""All islands of one equation in this process, advanced in small strides: for benchmarks that count every evaluation.

No bus and no coordinator; what is found is the same function of the seed as in a service, since an island does not
know who advances it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.config import JobConfig, Preset
from atoll_core.data.dataset import FloatArray, Problem, Target
from atoll_core.search.pareto import FrontEntry
from atoll_island_worker.evolution.island import Island, reshuffle_without_blocks
from benchmarks.harness import jobs

TERMINALS: Final = 7
SAMPLE: Final = 16
"""Rows of a predictor for targets without noise, as a coordinator resolves it."""

VARIABLE: Final = "x"
TARGET: Final = "y"


def problem_of(x: FloatArray, values: FloatArray) -> Problem:
    """Return the regression problem of `values` (R,) on the one variable `x` (R,), exact to the last digit."""
    target = Target(TARGET, TARGET, np.ascontiguousarray(values), 0.0, float(values.std()) or 1.0)
    return Problem((VARIABLE,), np.ascontiguousarray(x[np.newaxis, :]), target)


def configured(preset: Preset, seed: int, operators: Sequence[str], target_error: float, **evolution: Any) -> JobConfig:
    """Return a preset for one variable without noise, resolved; `evolution` replaces fields of its evolution."""
    budget = {"target_error": target_error}
    config = jobs.configured(seed, budget=budget, operators=operators, preset=preset, **evolution)
    space = config.space.model_copy(update={"terminals": config.space.terminals or TERMINALS})
    predictors = config.predictors.model_copy(update={"rows": config.predictors.rows or SAMPLE})
    return config.model_copy(update={"space": space, "predictors": predictors})


@dataclass(frozen=True)
class Stride:
    """What came of advancing one island a little.

    `evaluations` are the point evaluations of all islands so far, `generations` those of the island that advanced,
    `additions` what has improved its front since its last stride.
    """

    evaluations: int
    generations: int
    additions: tuple[FrontEntry, ...]


class Archipelago:
    """The islands of one equation, which take turns."""

    def __init__(self, problem: Problem, config: JobConfig) -> None:
        """Begin at epoch 0."""
        self.islands = [Island(problem, config, number) for number in range(config.evolution.islands)]
        self._config = config
        self._evaluations = [island.spent for island in self.islands]

    def strides(self, generations: int) -> Iterator[Stride]:
        """Advance every island in turn by `generations`, without end, and yield after each turn.

        After an epoch the solutions are reshuffled. An island that met the target waits for the end of the epoch.
        """
        while True:
            yield from self._epoch(generations)
            reshuffle_without_blocks(self.islands)

    def _epoch(self, generations: int) -> Iterator[Stride]:
        seen = [0] * len(self.islands)
        past = self.islands[0].epoch * self._config.migration.generations
        busy = list(range(len(self.islands)))
        while busy:
            for number in tuple(busy):
                island = self.islands[number]
                if island.advance(generations):
                    busy.remove(number)
                self._evaluations[number] = island.spent
                additions = island.additions(seen[number])
                seen[number] += len(additions)
                yield Stride(sum(self._evaluations), past + island.generation, additions)
