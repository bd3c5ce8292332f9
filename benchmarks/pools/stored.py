"""The outcomes of searches, in files: refining can be repeated from them by any revision.

A pool is kept by a coordinator of `benchmarks.harness.service` that writes the fronts and runners-up into a file
where it would have refined them. Tables are not kept: they are generated or read again.
"""

import base64
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Pool, Pools
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result
from atoll_coordinator.service.tasks.background import RefiningFailed
from atoll_coordinator.service.tasks.task_controller import TaskController
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_coordinator.tasks.refining import Searched
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.campaign import attempt
from benchmarks.harness.service import searching
from benchmarks.harness.stopwatch import Stopwatch

FILE: Final = "BENCHMARK_POOL"
"""Variable of the environment: the file to which a coordinator writes the pool of each job that it would refine."""

COORDINATOR: Final = """
import sys
from atoll.cli.main import main
from atoll_coordinator.service.tasks.task_controller import TaskController
from atoll_island_worker.processes import end_with_parent
from benchmarks.pools.stored import keep
end_with_parent(int(sys.argv[1]))
TaskController.refine = keep
sys.exit(main(sys.argv[2:]))
"""
"""A coordinator that keeps pools and refines nothing."""

Request = Callable[[], tuple[Table, JobConfig]]
"""Draws or reads the table of a job, with its configuration."""


@dataclass(frozen=True)
class Refined:
    """The result.json of a pool that was refined again, and the processor seconds of preparing and of refining."""

    result: dict[str, Any]
    preparing_s: float
    refining_s: float
    wall_s: float


def file_of(folder: Path, title: str) -> Path:
    """Return the file of the pool of a job, named by its title."""
    kept = "".join(letter if letter.isalnum() or letter in ".-" else "_" for letter in title)
    return folder / f"{kept}.json"


def keep(controller: TaskController, searched: Searched, config: JobConfig, seconds: float | None, now: float) -> None:
    """Write the pools to the file that the environment names; in place of `TaskController.refine`."""
    del config, seconds, now
    text = {name: {"front": _rows(pool.front), "runners_up": _rows(pool.runners_up)}
            for name, pool in searched.pools.items()}  # fmt: skip
    path = Path(os.environ[FILE])
    written = path.with_suffix(".writing")
    written.write_text(json.dumps(text, separators=(",", ":")) + "\n", "utf-8")
    written.replace(path)
    controller.post(RefiningFailed(searched.job, Refinement()))


def _rows(entries: Sequence[FrontEntry]) -> list[list[Any]]:
    return [
        [one.complexity, one.error, one.mse, one.epoch, one.generation, one.island,
         base64.b64encode(one.program).decode()]
        for one in entries
    ]  # fmt: skip


def read_pools(path: Path) -> Pools:
    """Return the pools of a job by variable.

    Raises:
        UsageError: No pool is kept there.
    """
    try:
        text: Mapping[str, Mapping[str, list[list[Any]]]] = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); make it with `benchmarks.pools keep`") from error
    return {name: Pool(_entries(one["front"]), _entries(one["runners_up"])) for name, one in text.items()}


def _entries(rows: Sequence[list[Any]]) -> tuple[FrontEntry, ...]:
    return tuple(
        FrontEntry(complexity, error, mse, epoch, generation, island, base64.b64decode(program))
        for complexity, error, mse, epoch, generation, island, program in rows
    )


def refine_stored(title: str, table: Table, config: JobConfig, pools: Pools, max_time: float | None = None) -> Refined:
    """Prepare a table, refine its pools in this process, and return the result.

    Raises:
        DataError: The table cannot be used.
        UsageError: The options of the job contradict each other.
    """
    begun, used = time.monotonic(), time.process_time()
    prepared, _ = prepare_job(table.to_bytes(), config)
    ready = time.process_time()
    made = refine_all(prepared.preparation, prepared.config, pools, Deadline(max_time), prepared.laws)
    outcomes = [VariableOutcome(name, pool.front, 0, runners_up=pool.runners_up) for name, pool in pools.items()]
    outcomes += [VariableOutcome(name, (entry,), 0, why=KNOWN) for name, entry in prepared.known.items()]
    ended, seconds = time.process_time(), time.monotonic() - begun
    result = build_result(title, prepared.config, prepared.preparation, outcomes, Account("done", seconds, 0.0), made)
    return Refined(result.model_dump(mode="json"), ready - used, ended - ready, seconds)


def keep_pools(requests: Mapping[str, Request], folder: Path, workers: int) -> None:
    """Search the jobs, by title, of which `folder` has no pool, and keep the outcomes of the searches."""
    folder.mkdir(parents=True, exist_ok=True)
    last = folder.absolute() / "last.pool"
    os.environ[FILE] = str(last)
    missing = [title for title in requests if not file_of(folder, title).exists()]
    with searching(workers, coordinator=COORDINATOR) as searches:
        for number, title in enumerate(missing, start=1):
            table, config = requests[title]()
            last.unlink(missing_ok=True)
            done = attempt(searches, title, table, config, Stopwatch())
            if done.failure is None and last.exists():
                last.replace(file_of(folder, title))
            note(f"{number} of {len(missing)}: {title}: {done.failure or f'{done.seconds:.1f} s'}")
