"""How often do 95 % intervals contain the truth? ``python -m benchmarks.corpus.intervals``.

Tables of single systems are measured with errors of several kinds; equations of the right form are fitted to them, and
what comes of that is what comes of any selected model. There is no search. For each kind of error and number of
trajectories: the share of intervals that contain the truth; the error of estimates over their standard errors (root
mean square), which is 1 where these are right; and how many constants are shown outside of their own interval.
"""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from atoll.terminal.output import say
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.inference.conclusion import summarize
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.joint_search import ModellingTask, SelectedModel
from atoll_core.config import PRESETS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest
from benchmarks.corpus.families import NAMED
from benchmarks.corpus.qualities import measure, quality
from benchmarks.corpus.systems import CorpusSystem, named_system, solution
from benchmarks.harness.command_line import option, program, seeds_of, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.record import Record
from benchmarks.harness.systems import Sampled, table_of
from benchmarks.harness.tables import grouped, markdown, share
from benchmarks.judging.coverage import Covered, covered

ROWS: Final = {1: 200, 4: 100}
"""Of a trajectory, by the number of trajectories."""

SPREAD: Final = 1.25
"""True constants are those of the named system times or over at most this, so that they are no simple numbers."""

SYSTEMS: Final = ("logistic", "lotka_volterra", "van_der_pol", "pendulum")
QUALITIES: Final = ("noise-0.01", "proportional-0.01", "ar1-0.01")
NORMAL_95: Final = 1.959964
FIT_STEPS: Final = 40


@dataclass(frozen=True, order=True)
class Key:
    """One table."""

    quality: str
    trajectories: int
    system: str
    seed: int


@dataclass(frozen=True)
class Estimated:
    """The constants of one table that have intervals; none where the right form could not be fitted or recognised."""

    key: Key
    constants: tuple[Covered, ...]


def estimate(key: Key) -> Estimated:
    """Return the constants of the equations of the right form, fitted to one table."""
    system = drawn_system(key)
    table, clean = measured(key, system)
    refinement, names = _concluded(system, table)
    if refinement is None:
        return Estimated(key, ())
    found: list[Covered] = []
    for name, text in system.truths.items():
        truth = values_of(from_infix(text, tuple(clean)), np.array([*clean.values()]))
        its = refinement.equations[name]
        judged = covered(to_infix(its.program, names), list(map(asdict, its.constants)), clean, truth)
        found += [each for each in judged or () if each.has_interval]
    return Estimated(key, tuple(found))


def drawn_system(key: Key) -> CorpusSystem:
    """Return the system of a table, its constants and the fixed initial state varied by the seed."""
    rng = np.random.default_rng([key.seed, len(key.system), 4])
    its = named_system(key.system)
    factors = SPREAD ** rng.uniform(-1.0, 1.0, len(its.constants))
    return replace(its, constants={name: value * float(factor) for (name, value), factor in
                                   zip(its.constants.items(), factors, strict=True)})  # fmt: skip


def measured(key: Key, system: CorpusSystem) -> tuple[Table, dict[str, FloatArray]]:
    """Return the table of a key, and the values (R,) without errors by state."""
    rng = np.random.default_rng([key.seed, len(key.system), key.trajectories, 5])
    starts = [*system.starts, *(system.draw_start(rng) for _ in range(key.trajectories - 1))]
    times = [np.linspace(0.0, system.duration, ROWS[key.trajectories])] * key.trajectories
    clean = [solution(system.field(), start, when) for start, when in zip(starts, times, strict=True)]
    values = measure(quality(key.quality), system, starts, times, clean, rng)
    columns = dict(zip(system.states, np.concatenate(clean).T, strict=True))
    return table_of(Sampled(system.states, tuple(times), tuple(values))), columns


def _concluded(system: CorpusSystem, table: Table) -> tuple[Refinement | None, Sequence[str]]:
    """Return what is said of the true equations, their constants fitted, and the names of the variables."""
    config = PRESETS["default"]
    preparation = prepare(table, config)
    assert preparation.recording is not None
    names = preparation.dataset.names
    programs = [shortest(from_infix(text, names)) for text in system.truths.values()]
    candidates = {name: CandidateSet(guesses=(each,)) for name, each in zip(system.states, programs, strict=True)}
    task = ModellingTask(preparation.dataset, preparation.recording, config, candidates)
    comparison = task.compare(task.measurements(task.variables), task.variables)
    model = comparison.fit_model(programs, FIT_STEPS)
    if model is None:
        return None, names
    lists = [[program] for program in programs]
    return summarize(SelectedModel(task, comparison, comparison.calibrate(model), lists)), names


def table(estimated: Sequence[Estimated], by: Sequence[str]) -> str:
    """Return a row for each combination of the fields `by` of keys, as Markdown."""
    in_order = sorted(estimated, key=lambda each: each.key)
    groups = grouped(in_order, lambda each: tuple(str(getattr(each.key, field)) for field in by))
    heads = (*by, "tables", "not fitted", "intervals that contain the truth", "error / standard error",
             "shown outside")  # fmt: skip
    return markdown(heads, [(*name, *_row(those)) for name, those in groups.items()])


def _row(estimated: Sequence[Estimated]) -> tuple[str, ...]:
    constants = [constant for its in estimated for constant in its.constants]
    scores = [NORMAL_95 * _half_widths(each) for each in constants]
    outside = sum(not (each.low or 0.0) <= each.value <= (each.high or 0.0) for each in constants)
    return (
        str(len(estimated)),
        str(sum(not its.constants for its in estimated)),
        share(sum(each.is_covered for each in constants), len(constants)),
        f"{np.sqrt(np.mean(np.square(scores))):.2f}" if scores else "-",
        str(outside),
    )


def _half_widths(its: Covered) -> float:
    assert its.low is not None
    assert its.high is not None
    middle, half = 0.5 * (its.low + its.high), 0.5 * (its.high - its.low)
    return (middle - its.truth) / half if half > 0.0 else 0.0


@program(
    "benchmarks.corpus.intervals",
    __doc__,
    option("--systems", nargs="+", choices=tuple(NAMED), default=SYSTEMS),
    option("--qualities", nargs="+", default=QUALITIES, help=f"default: {' '.join(QUALITIES)}"),
    option("--trajectories", type=int, choices=ROWS, nargs="+", default=tuple(ROWS), help="default: 1 4"),
    seeds_of("0-9", "such as 1000-1024 (0-9)"),
    workers(what="processes"),
    option("--json", type=Path, metavar="FILE", help="file for all figures"),
    description=__doc__.split("?")[0],
)
def main(options: Namespace) -> int:
    """Fit all tables and print the shares."""
    keys = [
        Key(kind, trajectories, system, seed)
        for seed in options.seeds
        for system in options.systems
        for kind in options.qualities
        for trajectories in options.trajectories
    ]
    record = Record("corpus.intervals", options.words, options.json)
    done: list[Estimated] = []
    for each in in_parallel(estimate, keys, options.workers):
        done.append(each)
        record.write(tables=[asdict(its) for its in done])
    say(table(done, ("quality", "trajectories")) + "\n")
    say(table(done, ("quality", "trajectories", "system")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
