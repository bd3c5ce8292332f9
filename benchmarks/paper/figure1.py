"""Figure 1 of the paper: do fitness predictors keep solutions small?

``python -m benchmarks.paper.figure1 --picture figure1.png --out figure1.json`` runs the preset ``paper``, or another
``--reading``, one island of 64 solutions, in two arms that differ only in what measures them: coevolved predictors, or
all rows. Equal seeds, so that both arms begin with the same random solutions.

Left panel: live nodes of the solution of least error on all rows, over the generations, for y = e^(x/2) sin 2x.

Right panel: bloat, which is the live nodes of the first exact solution minus the nodes of the target, on random targets
(`benchmarks.paper.random_targets`), only where both arms converged: error below 1e-6 of the target's deviation at each
of 1,000 fresh points. A run on a target ends when it converges, or after all generations.

Rows are drawn uniformly from [0, 10] (left) and [-3, 3] (right), anew for each seed and target; the operators are
+ - * / sin cos exp. Islands are not reshuffled, as there is one; epochs and offers to a front change nothing.
"""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from atoll.terminal.output import note, say, table
from benchmarks.harness.command_line import option, program, run_options, whole
from benchmarks.harness.parallel import canvas, in_parallel, save
from benchmarks.harness.record import Record
from benchmarks.paper.archipelago import SAMPLE
from benchmarks.paper.figure1_runs import (
    ARMS,
    FUNCTION,
    Arm,
    Mean,
    Run,
    Task,
    bloats,
    by_size,
    curves,
    difference,
    pairs,
    run,
)


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
            errors = [mean.error or 0.0 for mean in means]
            right.errorbar(
                list(sizes), [each.mean for each in means], errors, marker="o", capsize=3, color=f"C{number}", label=arm
            )
            right.axhline(bloats(both)[number].mean, linestyle="--", linewidth=1.0, color=f"C{number}")
        title = f"bloat on {len(both)} random targets that both found"
        right.set(title=title, xlabel="nodes of the target", ylabel="nodes of the solution minus target's")
        right.legend()
    save(picture, path)


def _band(panel: Any, looks: list[int], means: Sequence[Mean], label: str) -> None:
    middle, errors = np.array([mean.mean for mean in means]), np.array([each.error or 0.0 for each in means])
    panel.plot(looks, middle, label=label)
    panel.fill_between(looks, middle - errors, middle + errors, alpha=0.3)


def tasks(options: Namespace) -> list[Task]:
    """Return all runs: those on the function by seed, then one on each target, both arms in turn."""
    chosen = options.seeds if options.seeds is not None else range(options.runs)
    common = (options.targets, options.generations, options.rows, options.reading)
    functions = [Task(arm, seed, None, *common) for seed in chosen for arm in ARMS]
    return functions + [Task(arm, 0, number, *common) for number in range(options.targets) for arm in ARMS]


def figures_of(functions: Sequence[Run], on_targets: Sequence[Run]) -> dict[str, Any]:
    """Return the figures for the file, those of single runs included."""
    both = pairs(on_targets)
    return {
        "looks": list(functions[0].looks) if functions else [],
        "sizes": {arm: [asdict(mean) for mean in means] for arm, means in curves(functions).items()},
        "targets": len(on_targets) // len(ARMS),
        "converged_in_both": len(both),
        "bloat": [asdict(each) for each in bloats(both)] if both else [],
        "bloat_difference": asdict(_difference(both)) if both else None,
        "bloat_by_size": {size: [asdict(each) for each in means] for size, means in by_size(both).items()},
        "runs": [asdict(each) for each in (*functions, *on_targets)],
    }


def show(functions: Sequence[Run], on_targets: Sequence[Run]) -> None:
    """Print what the panels show, in numbers."""
    if functions:
        rows = [_size_row(arm, [run for run in functions if run.task.arm == arm]) for arm in ARMS]
        say(table((FUNCTION, "runs", "converged", "size at 1/4", "1/2", "end", "point evaluations"), rows))
        ends = difference(*([run.sizes[-1] for run in functions if run.task.arm == arm] for arm in ARMS))
        say(f"difference at the end, predictors minus all rows: {_shown(ends)}\n")
    if on_targets:
        both = pairs(on_targets)
        say(table(("random targets", "runs", "converged", "bloat where both converged"), _bloat_rows(on_targets, both)))
        if both:
            shown = _shown(_difference(both))
            say(f"both converged on {len(both)}; difference of bloat, predictors minus all rows: {shown}\n")


def _size_row(arm: Arm, runs: Sequence[Run]) -> tuple[str, ...]:
    means = curves(runs)[arm]
    marks = (len(means) // 4 - 1, len(means) // 2 - 1, len(means) - 1)
    converged = sum(run.converged is not None for run in runs)
    evaluations = f"{sum(run.evaluations for run in runs):.3g}"
    return (arm, str(len(runs)), str(converged), *(_shown(means[max(mark, 0)]) for mark in marks), evaluations)


def _bloat_rows(runs: Sequence[Run], both: Sequence[tuple[Run, Run]]) -> list[tuple[str, ...]]:
    means: tuple[Mean | None, Mean | None] = bloats(both) if both else (None, None)
    groups = [[run for run in runs if run.task.arm == arm] for arm in ARMS]
    return [
        (arm, str(len(group)), str(sum(run.converged is not None for run in group)), _shown(its) if its else "-")
        for arm, group, its in zip(ARMS, groups, means, strict=True)
    ]


def _difference(both: Sequence[tuple[Run, Run]]) -> Mean:
    return difference([one.bloat for one, _ in both], [other.bloat for _, other in both])


def _shown(its: Mean) -> str:
    return f"{its.mean:.2f}" if its.error is None else f"{its.mean:.2f} ± {its.error:.2f}"


@program(
    "benchmarks.paper.figure1",
    __doc__,
    option("--runs", type=whole, default=100, help="runs of each arm on the function (%(default)s)"),
    option("--targets", type=whole, default=500, help="random targets (%(default)s)"),
    option("--generations", type=whole, default=6000, help="of a run, at most (%(default)s)"),
    option("--rows", type=whole, default=200, help="points of a target (%(default)s)"),
    option("--reading", default="paper", help="of the paper, see benchmarks.paper.readings (%(default)s)"),
    *run_options(),
)
def main(options: Namespace) -> int:
    """Run both arms, print the numbers, draw the panels; return 0."""
    if options.rows <= 2 * SAMPLE:
        main.parser.error(f"--rows {options.rows} is too few for predictors of {SAMPLE}: give more than {2 * SAMPLE}")
    figures = Record("figure1", options.words, options.out)
    asked = tasks(options)
    runs: list[Run] = []
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


if __name__ == "__main__":
    sys.exit(main())
