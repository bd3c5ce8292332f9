"""Figure 1 of the paper: do fitness predictors keep solutions small?

``python -m benchmarks.figure1 --picture figure1.png --out figure1.json`` runs the preset ``paper``, one island of 64
solutions, in two arms that differ only in what measures them: coevolved predictors, or all rows. Equal seeds, so that
both arms begin with the same random solutions.

Left panel: live nodes of the solution of least error on all rows, over the generations, for y = e^(x/2) sin 2x.

Right panel: bloat, which is the live nodes of the first exact solution minus the nodes of the target, on random targets
(`benchmarks.random_targets`), only where both arms converged: error below 1e-6 of the target's deviation at each of
1,000 fresh points. A run on a target ends when it converges, or after all generations.

Rows are drawn uniformly from [0, 10] (left) and [-3, 3] (right), anew for each seed and target; the operators are
+ - * / sin cos exp. Islands are not reshuffled, as there is one; epochs and offers to a front change nothing.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from benchmarks.archipelago import configured, problem_of
from benchmarks.evaluation import evaluate
from benchmarks.population import Population, population
from benchmarks.random_targets import random_targets
from benchmarks.reporting import plain_errors
from benchmarks.runs import Figures, add_options, canvas, in_parallel, positive, save
from common.config import JobConfig
from common.dataset import FloatArray
from common.expression.parse import from_infix
from common.expression.program import Program
from common.expression.text import to_infix
from common.seeding import Stream, stream_key
from coordinator.cli.output import note, say, table
from island_worker.evolution.island import Island

Arm = Literal["predictors", "all rows"]
ARMS: Final[tuple[Arm, Arm]] = ("predictors", "all rows")

OPERATORS: Final = ("+", "-", "*", "/", "sin", "cos", "exp")
FUNCTION: Final = "exp(x/2)*sin(2*x)"
BETWEEN: Final = (0.0, 10.0)
BETWEEN_OF_TARGETS: Final = (-3.0, 3.0)
FRESH: Final = 1000
CONVERGED: Final = 1e-6
"""Largest error at fresh points over the target's deviation."""

NEVER: Final = 1e-300
"""A normalized error that no island meets, so that none ends by itself."""

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
    values, fresh_values = evaluate(truth, [x]), evaluate(truth, [fresh])
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
    config = configured("paper", task.seed, OPERATORS, NEVER, islands=1, refit_interval=EPOCH)
    predictors = config.predictors.model_copy(update={"enabled": task.arm == "predictors"})
    migration = config.migration.model_copy(update={"generations": EPOCH})
    return config.model_copy(update={"predictors": predictors, "migration": migration})


def looks_until(generations: int, is_early: bool) -> list[int]:
    """Return the generations at which a run is looked at: ends of epochs, and more often at first if `is_early`."""
    early = range(EARLY, min(SOON, generations) + 1, EARLY) if is_early else ()
    return sorted({*early, *range(EPOCH, generations + 1, EPOCH)})


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
        errors = np.abs(evaluate(its.program(best), [x]) - values)
    return bool((errors < CONVERGED * values.std()).all())


@dataclass(frozen=True)
class Mean:
    """A mean over runs with its standard error."""

    number: int
    mean: float
    error: float


def mean(values: Sequence[float]) -> Mean:
    """Return the mean of at least one value; the error of a single one is unknown, NaN being written as such."""
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
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
    return {size: _bloats([pair for pair in both if pair[0].target_size == size]) for size in sizes}


def _bloats(both: Sequence[tuple[Run, Run]]) -> tuple[Mean, Mean]:
    return mean([one.bloat for one, _ in both]), mean([other.bloat for _, other in both])


def draw(path: Path, functions: Sequence[Run], both: Sequence[tuple[Run, Run]]) -> None:
    """Draw the two panels."""
    picture = canvas(10.0, 4.0)
    left, right = picture.subplots(1, 2)
    if functions:
        for arm, means in curves(functions).items():
            _band(left, list(functions[0].looks), means, arm)
        left.set(title="$e^{x/2}\\,\\sin 2x$", xlabel="generations", ylabel="live nodes of the best solution")
        left.legend()
    if both:
        sizes = by_size(both)
        for number, arm in enumerate(ARMS):
            means = [pair[number] for pair in sizes.values()]
            errors = [0.0 if math.isnan(each.error) else each.error for each in means]
            right.errorbar(
                list(sizes), [each.mean for each in means], errors, marker="o", capsize=3, color=f"C{number}", label=arm
            )
            right.axhline(_bloats(both)[number].mean, linestyle="--", linewidth=1.0, color=f"C{number}")
        title = f"bloat on {len(both)} random targets that both found"
        right.set(title=title, xlabel="nodes of the target", ylabel="nodes of the solution minus target's")
        right.legend()
    save(picture, path)


def _band(panel: Any, looks: list[int], means: Sequence[Mean], label: str) -> None:
    middle, errors = (np.array([getattr(each, name) for each in means]) for name in ("mean", "error"))
    panel.plot(looks, middle, label=label)
    panel.fill_between(looks, middle - errors, middle + errors, alpha=0.3)


def tasks(options: argparse.Namespace) -> list[Task]:
    """Return all runs: those on the function by seed, then one on each target, both arms in turn."""
    chosen = options.seeds if options.seeds is not None else range(options.runs)
    common = (options.targets, options.generations, options.rows)
    functions = [Task(arm, seed, None, *common) for seed in chosen for arm in ARMS]
    return functions + [Task(arm, 0, number, *common) for number in range(options.targets) for arm in ARMS]


def figures_of(functions: Sequence[Run], on_targets: Sequence[Run]) -> dict[str, Any]:
    """Return the figures for the file, those of single runs included."""
    both = pairs(on_targets)
    return {
        "looks": list(functions[0].looks) if functions else [],
        "sizes": {arm: [asdict(each) for each in means] for arm, means in curves(functions).items()},
        "targets": len(on_targets) // len(ARMS),
        "converged_in_both": len(both),
        "bloat": [asdict(each) for each in _bloats(both)] if both else [],
        "bloat_difference": asdict(mean([one.bloat - other.bloat for one, other in both])) if both else None,
        "bloat_by_size": {size: [asdict(each) for each in means] for size, means in by_size(both).items()},
        "runs": [asdict(each) for each in (*functions, *on_targets)],
    }


def show(functions: Sequence[Run], on_targets: Sequence[Run]) -> None:
    """Print what the panels show, in numbers."""
    if functions:
        rows = [_size_row(arm, [run for run in functions if run.task.arm == arm]) for arm in ARMS]
        say(table((FUNCTION, "runs", "converged", "size at 1/4", "1/2", "end", "point evaluations"), rows))
        ends = _paired([run.sizes[-1] for run in functions if run.task.arm == arm] for arm in ARMS)
        say(f"difference at the end, predictors minus all rows: {ends}\n")
    if on_targets:
        both = pairs(on_targets)
        say(table(("random targets", "runs", "converged", "bloat where both converged"), _bloat_rows(on_targets, both)))
        if both:
            differences = _paired(([one.bloat for one, _ in both], [other.bloat for _, other in both]))
            say(f"both converged on {len(both)}; difference of bloat, predictors minus all rows: {differences}\n")


def _size_row(arm: Arm, runs: Sequence[Run]) -> tuple[str, ...]:
    means = curves(runs)[arm]
    marks = (len(means) // 4 - 1, len(means) // 2 - 1, len(means) - 1)
    converged = sum(run.converged is not None for run in runs)
    evaluations = f"{sum(run.evaluations for run in runs):.3g}"
    return (arm, str(len(runs)), str(converged), *(_shown(means[max(mark, 0)]) for mark in marks), evaluations)


def _bloat_rows(runs: Sequence[Run], both: Sequence[tuple[Run, Run]]) -> list[tuple[str, ...]]:
    means = _bloats(both) if both else (None, None)
    groups = [[run for run in runs if run.task.arm == arm] for arm in ARMS]
    return [
        (arm, str(len(group)), str(sum(run.converged is not None for run in group)), _shown(its) if its else "-")
        for arm, group, its in zip(ARMS, groups, means, strict=True)
    ]


def _paired(groups: Any) -> str:
    one, other = groups
    return _shown(mean([a - b for a, b in zip(one, other, strict=True)]))


def _shown(its: Mean) -> str:
    return f"{its.mean:.2f} ± {its.error:.2f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both arms, print the numbers, draw the panels; return 0."""
    options = _parser().parse_args(arguments)
    figures = Figures("figure1", sys.argv[1:] if arguments is None else arguments, options.out)
    asked = tasks(options)
    runs: list[Run] = []
    with plain_errors("benchmarks.figure1"):
        if options.picture:
            canvas(1.0, 1.0)
        for each in in_parallel(run, asked, options.workers):
            runs.append(each)
            if len(runs) % max(1, len(asked) // 20) == 0:
                note(f"{len(runs)} of {len(asked)} runs in {figures.seconds():.0f} s")
        runs.sort(key=lambda one: asked.index(one.task))
        functions = [each for each in runs if each.task.target is None]
        on_targets = [each for each in runs if each.task.target is not None]
        figures.write(**figures_of(functions, on_targets))
        if options.picture:
            draw(options.picture, functions, pairs(on_targets))
    show(functions, on_targets)
    say(f"{len(asked)} runs in {figures.seconds():.0f} s on {options.workers} processes")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.figure1", description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=positive, default=100, help="runs of each arm on the function (%(default)s)")
    parser.add_argument("--targets", type=positive, default=500, help="random targets (%(default)s)")
    parser.add_argument("--generations", type=positive, default=6000, help="of a run, at most (%(default)s)")
    parser.add_argument("--rows", type=positive, default=200, help="points of a target (%(default)s)")
    add_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
