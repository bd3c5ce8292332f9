"""``python -m benchmarks.stochastic.proposals``: how often ``--stochastic`` is proposed without being asked for.

Tables of processes and of deterministic systems with errors of measurement are prepared as those of a job without
``--stochastic``, and judged as its result is: what a simulated model leaves, or what was measured where there is no
model. Instead of a search, models are the true drift (a process), or the true equations, and the same 5 % too slow.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.inference.random_walk import stochastic_remarks
from atoll_coordinator.model.refinement import Simulated, Simulation
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from benchmarks.harness.command_line import program, seeds_of
from benchmarks.harness.systems import TABLE_III, Sampled, table_of, trajectories
from benchmarks.stochastic.processes import PROCESSES, Process, simulate
from benchmarks.stochastic.processes import table as table_of_paths

LEVELS: Final = (0.0, 0.01, 0.05, 0.2)
SMALL: Final = 10
"""Small steps in each step by which a drift is integrated."""
ROWS: Final = 2_400
"""Steps of a process in all."""
SLOWER: Final = 0.95


def _counts(found: Sequence[Sequence[bool]]) -> tuple[str, ...]:
    return (str(len(found)), *(str(sum(proposed)) for proposed in zip(*found, strict=True)))


def _of_process(process: Process, seed: int) -> Iterator[bool]:
    """Yield whether the option is proposed without a model, and with the drift as a model."""
    paths = simulate(process, seed, ROWS)
    given = table_of_paths(process, paths)
    yield _is_proposed(given, None)
    yield _is_proposed(given, [_drifted(process, path) for path in paths])


def _of_system(system: str, level: float, seed: int) -> Iterator[bool]:
    """Yield the same of a system: without a model, with its own, and with one that is too slow."""
    step, duration = 0.02, 20.0
    noisy = trajectories(system, step, seed, level, duration)
    clean = trajectories(system, step, seed, 0.0, duration)
    yield _is_proposed(table_of(noisy), None)
    yield _is_proposed(table_of(noisy), [value.T for value in clean.values])
    yield _is_proposed(table_of(noisy), _slowed(clean))


def _slowed(clean: Sampled) -> list[FloatArray]:
    return [
        np.array([np.interp(SLOWER * times, times, column) for column in values.T])
        for times, values in zip(clean.times, clean.values, strict=True)
    ]


def _drifted(process: Process, path: FloatArray) -> FloatArray:
    """Return where the drift alone leads from the beginning of a path (S, R)."""
    rates = process.function(process.drift.values())
    states, found = path[:, 0].tolist(), [path[:, 0].tolist()]
    for _ in range(path.shape[1] - 1):
        for _ in range(SMALL):
            velocity = rates(*states)
            states = [state + process.step / SMALL * rate for state, rate in zip(states, velocity, strict=True)]
        found.append(states)
    return np.array(found).T


def _is_proposed(given: Table, model: Sequence[FloatArray] | None) -> bool:
    recording = prepare(given, JobConfig()).recording
    assert recording is not None
    if model is None:
        return bool(stochastic_remarks(recording, None))
    simulated = tuple(
        Simulated(whole.name, whole.held_out, whole.times, whole.measured, values, None, (None,) * len(values))
        for whole, values in zip(recording.trajectories, model, strict=True)
    )
    return bool(stochastic_remarks(recording, Simulation(recording.states, simulated, 1.96)))


@program("benchmarks.stochastic.proposals", __doc__, seeds_of("0-9", "such as 0-4 (0-9)"), description=__doc__)
def main(options: Namespace) -> None:
    """Run what the command line asks for."""
    rows = []
    for name, process in PROCESSES.items():
        found = [[*_of_process(process, seed)] for seed in options.seeds]
        rows.append((name, "0" if not process.noise else str(process.noise), *_counts(found), ""))
        note("  ".join(rows[-1]))
    for system in TABLE_III:
        for level in LEVELS:
            found = [[*_of_system(system, level, seed)] for seed in options.seeds]
            rows.append((system, f"{100.0 * level:.0f} %", *_counts(found)))
            note("  ".join(rows[-1]))
    say(table(("table", "errors", "tables", "no model", "true model", "model 5 % too slow"), rows))


if __name__ == "__main__":
    sys.exit(main())
