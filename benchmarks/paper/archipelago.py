"""All islands of one equation in this process, advanced in small strides: for benchmarks that count every evaluation.

No bus and no coordinator; what is found is the same function of the seed as in a service, since an island does not
know who advances it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.config import PRESETS, JobConfig, Preset
from atoll_core.data.dataset import FloatArray, Problem, Target
from atoll_core.search.pareto import FrontEntry
from atoll_island_worker.evolution.island import Island, reshuffle

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
    config = PRESETS[preset]
    changes: dict[str, Mapping[str, Any]] = {
        "space": {"operators": tuple(operators), "terminals": config.space.terminals or TERMINALS},
        "predictors": {"rows": config.predictors.rows or SAMPLE},
        "budget": {"target_error": target_error},
        "evolution": evolution,
    }
    update = {name: getattr(config, name).model_copy(update=fields) for name, fields in changes.items()}
    return config.model_copy(update={"seed": seed, **update})


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

    def __init__(self, problem: Problem, config: JobConfig, states: Sequence[bytes] | None = None) -> None:
        """Begin at epoch 0, or where the islands' `states`, as `states` returned them, begin."""
        numbers = range(config.evolution.islands)
        if states is None:
            self.islands = [Island(problem, config, number) for number in numbers]
        else:
            self.islands = [Island.from_bytes(states[number], problem, config, number) for number in numbers]
        self._config = config
        self._evaluations = [island.spent for island in self.islands]
        self.deviation = problem.target.standard_deviation

    def states(self) -> list[bytes]:
        """Return the islands as bytes, between two epochs."""
        return [island.to_bytes() for island in self.islands]

    def strides(self, generations: int, between: Callable[[], None] = lambda: None) -> Iterator[Stride]:
        """Advance every island in turn by `generations`, without end, and yield after each turn.

        After an epoch the solutions are reshuffled, and `between` is called. An island that met the target waits for
        the end of the epoch.
        """
        while True:
            yield from self._epoch(generations)
            reshuffle(self.islands)
            between()

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
