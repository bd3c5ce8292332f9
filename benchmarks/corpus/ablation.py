"""What a hand-set number decides: jobs of the corpus are refined again with another value of it.

``python -m benchmarks.corpus.ablation FOLDER --record`` searches some thirty tuning jobs (seeds below 1000) by the real
path and keeps what refining was given in FOLDER. ``python -m benchmarks.corpus.ablation FOLDER --out base.json``
refines them with the settings as they are, and with ``--change regression.beam=1 --against base.json`` with others:
``stage.field=value``, or ``module:NAME=value`` of a number elsewhere; several after one
``--change`` are changed together. With settings of the preparation, tables are prepared anew and the search is not.
"""

import ast
import json
import math
import pickle
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.refinement import Pools
from atoll_coordinator.model.result.result import Account, VariableOutcome, build_result
from atoll_coordinator.service.background.job_tasks import refinement_failed
from atoll_coordinator.service.background.runner import TaskRunner
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.corpus.campaign import configuration
from benchmarks.corpus.cases import Case, Key, make_case
from benchmarks.corpus.outcomes import judge_job
from benchmarks.corpus.systems import CorpusSystem
from benchmarks.harness.command_line import option, program, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.service import TIED_COORDINATOR, searching
from benchmarks.noise import data as noise

_QUALITIES: Final = (
    "exact", "rk45-1e-3", "rk45-1e-6", "lsoda-1e-7", "noise-0.001", "noise-0.01", "noise-0.05", "ar1-0.01",
    "proportional-0.01", "digits-4",
)  # fmt: skip
_PAPER: Final = {"glider": 0.0, "predator_prey": 0.01, "bar_magnets": 0.05, "shear_flow": 0.01}
"""Systems of Table III and the noise that they are measured with."""

_LABELS: Final = {
    "glider": 0.01, "bacterial_respiration": 0.01, "predator_prey": 0.1, "bar_magnets": 0.1, "shear_flow": 0.01,
    "lotka_volterra": 0.1,
}  # fmt: skip
"""The same of which the derivative of the first state is given, and its noise over its root mean square."""
_LABEL: Final = "label"
_LABEL_ROWS: Final = 300

JOBS: Final = (
    *(Key("random", 1, 4, "even", quality, 40 + place) for place, quality in enumerate(_QUALITIES)),
    *(Key("random", 2, 4, "even", quality, 60 + place) for place, quality in enumerate(_QUALITIES)),
    Key("logistic", 1, 1, "even", "rk45-1e-6", 40),
    Key("linear", 2, 1, "even", "lsoda-1e-7", 40),
    Key("lotka_volterra", 2, 1, "even", "rk45-1e-3", 40),
    Key("van_der_pol", 2, 1, "even", "lsoda-1e-7", 40),
    Key("pendulum", 2, 1, "even", "noise-0.01", 40),
    Key("random", 1, 1, "sparse", "noise-0.01", 50),
    *(Key(f"paper {name}", 2, 4, "even", f"noise-{level:g}", 40) for name, level in _PAPER.items()),
    *(Key(f"labels {name}", 1, 4, "even", f"noise-{level:g}", 40) for name, level in _LABELS.items()),
)

_EPOCHS: Final = 30
_PREPARING: Final = ("checks", "smoothing", "robustness", "interpolation", "quantisation", "rows")
_RECORDING: Final = "from benchmarks.corpus.ablation import record_refinings\nrecord_refinings({folder!r})\n"


@dataclass(frozen=True, eq=False)
class Recorded:
    """What refining one job was given, and the table that it comes from."""

    preparation: Preparation
    config: JobConfig
    pools: Pools


@dataclass(frozen=True)
class Task:
    """One job to be refined with settings changed: `changes` has values by name."""

    folder: Path
    number: int
    changes: Mapping[str, Any]


@dataclass(frozen=True)
class Replay:
    """How one job came out: forms, verdicts and R2 of fresh trajectories by equation, and processor seconds."""

    number: int
    forms: tuple[str, ...]
    grades: tuple[str | None, ...]
    r2: tuple[float | None, ...]
    expressions: tuple[str | None, ...]
    seconds: float


def ablation_case(key: Key) -> Case:
    """Return the data of a job, those of the paper's systems by the noise benchmark."""
    kind, _, name = key.system.partition(" ")
    if not name:
        return make_case(key)
    level = float(key.quality.partition("-")[2])
    its = noise.case(noise.Key("atoll", "plain", name, 0.0 if kind == "labels" else level, key.seed))
    if kind == "labels":
        return _labelled(key, its, level)
    system = CorpusSystem(key.system, its.truths, {}, (), 10.0)
    return Case(system, its.table, its.clean, (its.fresh,), dict.fromkeys(its.truths, math.inf), its.data)


def _labelled(key: Key, its: noise.Case, level: float) -> Case:
    """Return some of the rows with the derivative of the first state, to which noise is added, in place of times."""
    name, truth = next(iter(its.truths.items()))
    rng = np.random.default_rng(key.seed)
    values = its.slope(name)
    rows = rng.permutation(np.flatnonzero(np.isfinite(values)))[:_LABEL_ROWS]
    labels = values[rows] + level * float(np.sqrt(np.mean(values[rows] ** 2))) * rng.standard_normal(len(rows))
    clean = {each: column[rows] for each, column in its.clean.items()}
    columns = np.ascontiguousarray([*clean.values(), labels])
    lines = np.arange(len(rows), dtype=np.int64)
    names = (*clean, _LABEL)
    measured = Table(names, ("",) * len(names), columns, (0,), ("labels",), np.zeros_like(lines), lines + 2)
    system = CorpusSystem(key.system, {_LABEL: truth}, {}, (), 10.0)
    return Case(system, measured, clean, (), {_LABEL: math.inf}, {"target": _LABEL})


def record(folder: Path, workers: int) -> None:
    """Search all jobs that `folder` lacks, and keep what their refining was given, each in a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [number for number in range(len(JOBS)) if not _path(folder, number).exists()]
    program = _RECORDING.format(folder=str(folder.resolve())) + TIED_COORDINATOR
    with searching(workers, program=program) as searches:
        for number in missing:
            case = ablation_case(JOBS[number])
            config = configuration(JOBS[number], case, None, {"max_epochs": _EPOCHS})
            searches.solve(JOBS[number].title, case.table, config, prefix=f"job-{number:03}")
            (kept,) = folder.glob(f"job-{number:03}-*.pickle")
            kept.rename(_path(folder, number))
            note(f"{JOBS[number].title} is kept")


def record_refinings(folder: str) -> None:
    """Have the coordinator of this process keep what each refining is given in `folder`, by job, and not refine."""

    def refine(self: TaskRunner, job: str, prepared: Prepared, pools: Pools, seconds: float | None = None) -> None:
        del seconds
        kept = Recorded(prepared.preparation, prepared.config, pools)
        Path(folder, f"{job}.pickle").write_bytes(pickle.dumps(kept))
        self._post(refinement_failed(job, "it was only recorded", ""))

    TaskRunner.refine = refine  # type: ignore[method-assign]


def _path(folder: Path, number: int) -> Path:
    return folder / f"{number:03}.pickle"


@contextmanager
def changed(changes: Mapping[str, Any]) -> Iterator[None]:
    """Change numbers by their names for as long as the block lasts.

    Raises:
        UsageError: there is no number of that name.
    """
    owners = {name: _owner(name) for name in changes}
    before = {name: getattr(*its) for name, its in owners.items()}
    try:
        for name, value in changes.items():
            object.__setattr__(*owners[name], value)
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(*owners[name], value)


def _owner(name: str) -> tuple[object, str]:
    """Return the object that has the number, and its name there."""
    module, _, constant = name.rpartition(":")
    if module:
        return import_module(module), constant
    stage, _, field = name.rpartition(".")
    its = getattr(SETTINGS, stage, None) if stage else SETTINGS
    if its is not None and hasattr(its, field):
        return its, field
    raise UsageError(f"{name!r} is no setting; name one such as regression.beam")


def replay(task: Task) -> Replay:
    """Refine one job with the settings changed."""
    from atoll_coordinator.model.pipeline import refine_all

    key = JOBS[task.number]
    case = ablation_case(key)
    its: Recorded = pickle.loads(_path(task.folder, task.number).read_bytes())
    with changed(task.changes):
        begun = time.process_time()
        is_prepared = not any(name.split(".")[0] in _PREPARING for name in task.changes)
        preparation = its.preparation if is_prepared else prepare(_copy(case.table), configuration(key, case, None, {}))
        refinement = refine_all(preparation, its.config, its.pools)
        seconds = time.process_time() - begun
        outcomes = [
            VariableOutcome(name, pool.front, 1, refined=refinement.equations.get(name), runners_up=pool.runners_up)
            for name, pool in its.pools.items()
        ]
        answer = build_result(
            "ablation", its.config, preparation, outcomes, Account("done", 0.0, 0.0), refinement
        ).as_dict()
    judged = judge_job(key, case, answer).equations
    return Replay(
        task.number,
        tuple(each.form for each in judged),
        tuple(each.grade for each in judged),
        tuple(None if each.r2 is None else float(each.r2) for each in judged),
        tuple(each.expression for each in judged),
        seconds,
    )


def _copy(measured: Table) -> Table:
    return Table.from_bytes(measured.to_bytes())


def replay_all(folder: Path, changes: Mapping[str, Any], workers: int) -> list[Replay]:
    """Refine all jobs that `folder` holds with the settings changed, in order."""
    tasks = [Task(folder, number, changes) for number in range(len(JOBS)) if _path(folder, number).exists()]
    return sorted(in_parallel(replay, tasks, workers), key=lambda each: each.number)


def summary(name: str, found: Sequence[Replay]) -> tuple[str, ...]:
    """Return the cells of one row: forms right, verdicts that are good or exact and how many of them hold, seconds."""
    forms = [form for each in found for form in each.forms]
    trusted = [
        (grade, form, r2)
        for each in found
        for grade, form, r2 in zip(each.grades, each.forms, each.r2, strict=True)
        if grade in ("good", "exact")
    ]
    holds = sum(form == "right" or (grade == "good" and r2 is not None and r2 > 0.9) for grade, form, r2 in trusted)
    right, seconds = forms.count("right"), sum(each.seconds for each in found)
    return name, f"{right} of {len(forms)}", f"{holds} of {len(trusted)}", f"{seconds:.0f}"


def differences(base: Sequence[Replay], found: Sequence[Replay]) -> Iterator[str]:
    """Yield a line for each equation that came out otherwise in form or verdict."""
    before = {each.number: each for each in base}
    for each in found:
        old = before.get(each.number)
        if old is None or (old.forms, old.grades) == (each.forms, each.grades):
            continue
        for place, form in enumerate(each.forms):
            was, now = (old.forms[place], old.grades[place]), (form, each.grades[place])
            if was != now:
                title, text, other = JOBS[each.number].title, old.expressions[place], each.expressions[place]
                yield f"  {title}: {was[0]} {was[1]} -> {now[0]} {now[1]}: {text} -> {other}"


def _change(word: str) -> tuple[str, Any]:
    name, _, value = word.partition("=")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError) as error:
        raise UsageError(f"{word!r} was given; write a name, = and a number or a tuple") from error


def _read(path: Path) -> list[Replay]:
    return [
        Replay(
            its["number"], tuple(its["forms"]), tuple(its["grades"]), tuple(its["r2"]), tuple(its["expressions"]),
            its["seconds"],
        )
        for its in json.loads(path.read_text("utf-8"))
    ]  # fmt: skip


@program(
    "benchmarks.corpus.ablation",
    __doc__,
    option("folder", type=Path, help="where the recorded jobs are"),
    option("--record", action="store_true", help="search the jobs that the folder lacks, and keep them"),
    option("--change", nargs="+", action="append", metavar="NAME=VALUE", help="see above; may be repeated"),
    option("--against", type=Path, metavar="FILE", help="outcomes to compare with, written by --out"),
    option("--out", type=Path, metavar="FILE", help="file for the outcomes of the last change"),
    workers(1, "processes"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    if options.record:
        record(options.folder, options.workers)
        return 0
    base = [] if options.against is None else _read(options.against)
    rows = [summary("as it was", base)] if base else []
    for words in options.change or [[]]:
        changes = dict(_change(word) for word in words)
        found = replay_all(options.folder, changes, options.workers)
        rows.append(summary(" ".join(words) or "as it is", found))
        say("\n".join([" | ".join(rows[-1]), *differences(base, found)]))
        if options.out is not None:
            options.out.write_text(json.dumps([vars(each) for each in found]))
    say(table(("change", "forms right", "verdicts that hold", "cpu s"), rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
