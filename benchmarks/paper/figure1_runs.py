"""Runs of Figure 1: one island, looked at from time to time, and what the sizes of its best solution come to."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

import numpy as np

from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.seeding import Stream, stream_key
from atoll_island_worker.evolution.island import Island
from benchmarks.paper.archipelago import problem_of
from benchmarks.paper.population import Population, population
from benchmarks.paper.random_targets import random_targets
from benchmarks.paper.readings_runs import config_of

Arm = Literal["predictors", "all rows"]
ARMS: Final[tuple[Arm, Arm]] = ("predictors", "all rows")

OPERATORS: Final = ("+", "-", "*", "/", "sin", "cos", "exp")
FUNCTION: Final = "exp(x/2)*sin(2*x)"
BETWEEN: Final = (0.0, 10.0)
BETWEEN_OF_TARGETS: Final = (-3.0, 3.0)
FRESH: Final = 1000
CONVERGED: Final = 1e-6
"""Largest error at fresh points over the target's deviation."""

EPOCH: Final = 100
EARLY: Final = 20
"""Generations between two looks at a run on a target, up to `SOON`; `EPOCH` from then on."""

SOON: Final = 200


@dataclass(frozen=True)
class Task:
    """One run: on target number `target` of `targets`, or on `FUNCTION` when None."""

    arm: Arm
    seed: int
    target: int | None
    targets: int
    generations: int
    rows: int
    reading: str = "paper"


@dataclass(frozen=True)
class Run:
    """Sizes of the best solution at the `looks`; the generation at which it was exact at fresh points first, if ever.

    `target_size` counts the nodes of a random target; for `FUNCTION`, it is that of the expression as written.
    """

    task: Task
    looks: tuple[int, ...]
    sizes: tuple[int, ...]
    target_size: int
    converged: int | None
    evaluations: int
    found: str | None

    @property
    def bloat(self) -> int:
        """The last size minus the target's."""
        return self.sizes[-1] - self.target_size


def run(task: Task) -> Run:
    """Evolve one island and look at its best solution from time to time. Pure: the task decides everything."""
    truth = from_infix(FUNCTION, ("x",)) if task.target is None else _targets(task.targets)[task.target]
    x, fresh = _points(task, "points", task.rows), _points(task, "fresh points", FRESH)
    values, fresh_values = values_of(truth, x[np.newaxis]), values_of(truth, fresh[np.newaxis])
    island = Island(problem_of(x, values), _config(task), 0)
    looks, sizes, converged, found = [], [], None, None
    for generation in looks_until(task.generations, task.target is not None):
        _advance(island, generation)
        its = population(island)
        best = int(its.losses(x, values).argmin())
        looks.append(generation)
        sizes.append(int(its.sizes()[best]))
        if converged is None and _is_exact(its, best, fresh, fresh_values):
            converged, found = generation, to_infix(its.program(best), ("x",), digits=6)
            if task.target is not None:
                break
    spent = sum(island.outcome().evaluations.values())
    return Run(task, tuple(looks), tuple(sizes), len(truth), converged, spent, found)


@cache
def _targets(number: int) -> list[Program]:
    return random_targets(number, OPERATORS, np.linspace(*BETWEEN_OF_TARGETS, FRESH))


def _points(task: Task, purpose: str, count: int) -> FloatArray:
    """Return points that depend on seed and target, not on the arm."""
    low, high = BETWEEN if task.target is None else BETWEEN_OF_TARGETS
    stream = Stream(stream_key(task.seed, f"target {task.target}", -1, 0, purpose))
    return np.array([low + (high - low) * stream.uniform() for _ in range(count)])


def _config(task: Task) -> JobConfig:
    config = config_of(task.reading, task.seed, OPERATORS, islands=1, refit_interval=EPOCH)
    predictors = config.predictors.model_copy(update={"enabled": task.arm == "predictors"})
    migration = config.migration.model_copy(update={"generations": EPOCH})
    return config.model_copy(update={"predictors": predictors, "migration": migration})


def looks_until(generations: int, is_early: bool) -> list[int]:
    """Return the generations at which a run is looked at: ends of epochs, its own, and at first more if `is_early`."""
    early = range(EARLY, min(SOON, generations) + 1, EARLY) if is_early else ()
    return sorted({*early, *range(EPOCH, generations, EPOCH), generations})


def _advance(island: Island, generation: int) -> None:
    """Advance to that generation, counted from the first; the next epoch begins when there is more to do."""
    done = island.epoch * EPOCH + island.outcome().generations
    while done < generation:
        if done and done % EPOCH == 0:
            island.immigrate(island.emigrants())
        step = min(generation - done, EPOCH - done % EPOCH)
        island.advance(step)
        done += step


def _is_exact(its: Population, best: int, x: FloatArray, values: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        errors = np.abs(values_of(its.program(best), x[np.newaxis]) - values)
    return bool((errors < CONVERGED * values.std()).all())


@dataclass(frozen=True)
class Mean:
    """A mean over runs with its standard error, which a single run does not have."""

    number: int
    mean: float
    error: float | None


def mean(values: Sequence[float]) -> Mean:
    """Return the mean of at least one value."""
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else None
    return Mean(len(values), float(np.mean(values)), error)


def pairs(runs: Sequence[Run]) -> list[tuple[Run, Run]]:
    """Return, of runs on random targets, those of both arms on one target where both converged, in `ARMS`' order."""
    by_task = {(run.task.target, run.task.seed, run.task.arm): run for run in runs if run.converged is not None}
    keys = sorted({key[:2] for key in by_task if key[0] is not None})
    both = [(by_task.get((*key, ARMS[0])), by_task.get((*key, ARMS[1]))) for key in keys]
    return [(one, other) for one, other in both if one is not None and other is not None]


def curves(runs: Sequence[Run]) -> dict[Arm, list[Mean]]:
    """Return, of runs on `FUNCTION`, the mean size at each look by arm."""
    return {
        arm: [mean(sizes) for sizes in zip(*(run.sizes for run in runs if run.task.arm == arm), strict=True)]
        for arm in ARMS
    }


def by_size(both: Sequence[tuple[Run, Run]]) -> dict[int, tuple[Mean, Mean]]:
    """Return the mean bloat of both arms by size of the target."""
    sizes = sorted({one.target_size for one, _ in both})
    return {size: bloats([pair for pair in both if pair[0].target_size == size]) for size in sizes}


def bloats(both: Sequence[tuple[Run, Run]]) -> tuple[Mean, Mean]:
    return mean([one.bloat for one, _ in both]), mean([other.bloat for _, other in both])


def difference(ones: Iterable[int], others: Iterable[int]) -> Mean:
    """Return the mean of the differences of pairs."""
    return mean([one - other for one, other in zip(ones, others, strict=True)])
