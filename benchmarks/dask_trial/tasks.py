"""Real pieces of Atoll's work as a cluster engine would carry them: a table is prepared, systems are fitted in batches.

Each is a function of its arguments alone. Results are compared by a digest of their bits.
"""

import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.table import Table
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest
from benchmarks.harness.jobs import configured
from benchmarks.noise.data import Case, Key, case

SYSTEM: Final = "lotka_volterra"
NOISE: Final = 0.05
BATCH: Final = 4
"""Systems in a batch: about 0.1 s of a processor."""

_OPERATORS: Final = ("+", "-", "*", "/", "sin", "cos")


@dataclass(frozen=True, eq=False)
class Batch:
    """Systems to fit to one table: the programs of each, as bytes, in the order of the states."""

    seed: int
    systems: tuple[tuple[bytes, ...], ...]


def nothing(argument: object = None) -> None:
    """Do nothing with an argument that had to travel."""


def table_of(seed: int) -> bytes:
    """Return the table of one draw of trajectories and noise, as it is uploaded."""
    return _case(seed).table.to_bytes()


def _case(seed: int) -> Case:
    return case(Key("", SYSTEM, NOISE, seed))


def prepared(table: bytes) -> Preparation:
    """Prepare a table, as the service does."""
    return prepare(Table.from_bytes(table), configured())


def batches(seed: int) -> list[Batch]:
    """Return the true system with every neighbour of one of its equations in that one's place, in batches."""
    made = _case(seed)
    truth = [shortest(from_infix(text, made.names)) for text in made.truths.values()]
    codes = [BY_NAME[name].code for name in _OPERATORS]
    systems = [
        tuple(program.to_bytes() for program in (*truth[:place], other, *truth[place + 1 :]))
        for place in range(len(truth))
        for other in neighbours(truth[place], range(len(truth)), codes)
    ]
    return [Batch(seed, tuple(systems[first : first + BATCH])) for first in range(0, len(systems), BATCH)]


def fitted(preparation: Preparation, batch: Batch) -> str:
    """Fit the systems of a batch as refining does; return the digest of their descriptions and constants."""
    recording = preparation.recording
    assert recording is not None
    measurements = measurements_of(recording, range(len(recording.states)))
    tolerance = SETTINGS.selection.tolerated_noise * float(measurements.relative_noise.min())
    comparison = ModelComparison(MultipleShooting(measurements, tolerance), preparation.dataset.names)
    programs = ([Program.from_bytes(one, len(system)) for one in system] for system in batch.systems)
    return digest(_bits(comparison.fit_model(system)) for system in programs)


def _bits(model: FittedModel | None) -> bytes:
    if model is None:
        return b"none"
    constants: bytes = model.fit.system.values.tobytes()
    return float(model.nats).hex().encode() + constants


def digest(parts: Iterable[bytes]) -> str:
    """Return the digest of parts in their order."""
    whole = hashlib.sha256()
    for part in parts:
        whole.update(part)
    return whole.hexdigest()[:16]


def together(digests: Sequence[str]) -> str:
    """Return the digest of the results of many tasks, in the order of the tasks."""
    return digest(one.encode() for one in digests)


def count_into(file: str, seconds: float) -> None:
    """Write the time into a file ten times a second: tells how long a task that was cancelled goes on."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        Path(file).write_text(f"{time.monotonic():.3f}", "utf-8")
        time.sleep(0.1)
