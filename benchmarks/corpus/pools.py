"""What searches of the corpus handed on, kept in files: refining repeated alone, by another revision, say.

A pool is kept by a coordinator of `benchmarks.harness.service` that writes down what it would have refined. Files are
pickles: made and read on one machine.
"""

import os
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from atoll.terminal.output import note
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import LawsByGroup, Pools
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.result import Account, VariableOutcome, build_result
from atoll_coordinator.service.tasks.background import RefiningFailed
from atoll_coordinator.service.tasks.task_controller import TaskController
from atoll_coordinator.tasks.preparing import Prepared
from atoll_coordinator.tasks.refining import Searched
from atoll_core.config import JobConfig
from atoll_core.errors import UsageError
from atoll_core.wire.values import decode_value
from benchmarks.corpus.cases import Case, Key, make_case
from benchmarks.corpus.outcomes import Outcome, judge_job
from benchmarks.harness.campaign import attempt
from benchmarks.harness.journal import Journal
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.service import searching
from benchmarks.harness.stopwatch import Stopwatch

FILE: Final = "BENCHMARK_POOL"
"""Variable of the environment: where a coordinator keeps the pool of the job it has refined last."""

COORDINATOR: Final = """
import sys
from atoll.cli.main import main
from atoll_coordinator.service.tasks.task_controller import TaskController
from atoll_island_worker.processes import end_with_parent
from benchmarks.corpus.pools import keep
end_with_parent(int(sys.argv[1]))
TaskController.refine = keep
sys.exit(main(sys.argv[2:]))
"""
"""A program of the coordinator's package that keeps pools and refines nothing."""


@dataclass(frozen=True, eq=False)
class KeptPool:
    """What refining is given. `key` is that of the job, None until the search has ended."""

    preparation: Preparation
    config: JobConfig
    pools: Pools
    laws: LawsByGroup | None
    key: Key | None = None


def keep(controller: TaskController, searched: Searched, config: JobConfig, seconds: float | None, now: float) -> None:
    """Keep what refining would be given in the file that the environment names; in place of `TaskController.refine`."""
    del seconds, now
    prepared = decode_value(controller.encoded(searched.job), Prepared)
    kept = KeptPool(prepared.preparation, config, searched.pools, prepared.laws)
    Path(os.environ[FILE]).write_bytes(pickle.dumps(kept))
    controller.post(RefiningFailed(searched.job, Refinement()))


def file_of(folder: Path, key: Key) -> Path:
    """Return the file of the pool of a job."""
    return folder / f"{key.title.replace(' ', '_').replace(':', '')}.pickle"


def refine_kept(key: Key, folder: Path, max_time: float | None = None) -> Outcome:
    """Refine the kept pool of a job, and judge what comes of it.

    Raises UsageError where no pool is kept.
    """
    file = file_of(folder, key)
    if not file.exists():
        raise UsageError(f"{file} does not exist; make it with --keep-pools {folder} and the same options")
    kept: KeptPool = pickle.loads(file.read_bytes())
    stopwatch, begun, used = Stopwatch(), time.monotonic(), time.process_time()
    made = refine_all(kept.preparation, kept.config, kept.pools, Deadline(max_time), kept.laws)
    stopwatch.seconds["refining"] = time.monotonic() - begun
    stopwatch.processor["refining"] = time.process_time() - used
    outcomes = [
        VariableOutcome(name, pool.front, 0, refined=made.equations.get(name), runners_up=pool.runners_up)
        for name, pool in kept.pools.items()
    ]
    account = Account("done", stopwatch.seconds["refining"], 0.0)
    result = build_result(key.title, kept.config, kept.preparation, outcomes, account, made)
    return judge_job(key, make_case(key), result.model_dump(mode="json"), stopwatch, config=kept.config)


def keep_pools(keys: Sequence[Key], folder: Path, workers: int, configured: Callable[[Key, Case], JobConfig]) -> None:
    """Search those of `keys` of which `folder` has no pool, and keep what the searches hand on."""
    folder.mkdir(parents=True, exist_ok=True)
    last = folder / "last"
    os.environ[FILE] = str(last)
    missing = [key for key in keys if not file_of(folder, key).exists()]
    with searching(workers, coordinator=COORDINATOR) as searches:
        for number, key in enumerate(missing, start=1):
            case = make_case(key)
            last.unlink(missing_ok=True)
            done = attempt(searches, key.title, case.table, configured(key, case), Stopwatch())
            if done.failure is None and last.exists():
                kept = replace(pickle.loads(last.read_bytes()), key=key)
                file_of(folder, key).write_bytes(pickle.dumps(kept))
            note(f"{number} of {len(missing)}: {key.title}: {done.failure or f'{done.seconds:.1f} s'}")


def refine_all_kept(
    keys: Sequence[Key],
    journal: Journal[Outcome],
    refine: Callable[[Key], Outcome],
    workers: int,
    line: Callable[[Outcome], str],
) -> list[Outcome]:
    """Refine the pools of `keys` that the journal does not have in `workers` processes; return the outcomes of all."""
    missing = [key for key in keys if key not in journal.outcomes]
    for number, outcome in enumerate(in_parallel(refine, missing, workers), start=1):
        journal.add(outcome)
        note(f"{number} of {len(missing)}: {line(outcome)}")
    return [journal.outcomes[key] for key in keys if key in journal.outcomes]
