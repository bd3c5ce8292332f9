"""Preparing on simulated workers: its processor seconds, and the speed-up that more workers would give.

Batches are computed here, one after another, and their processor seconds are measured. Simulated workers take the
batches of each call in order, the next batch as soon as one is free; everything else runs on one of them. Messages take
no time in this simulation.
"""

import hashlib
import time
from argparse import Namespace
from collections.abc import Sequence
from typing import Final

from atoll.terminal.output import note, say, table
from atoll_coordinator.model import pipeline  # noqa: F401  # fills the table of functions
from atoll_coordinator.model.batches import FUNCTIONS
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_core.wire.values import encode_value
from benchmarks.many.campaign import case, keys

WORKERS: Final = (2, 4, 8)


class MeasuredBatches:
    """Computes batches in their order, and keeps the processor seconds of each call's batches."""

    workers = 0
    threads = 1

    def __init__(self) -> None:
        self.calls: list[list[float]] = []

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """See `atoll_coordinator.model.batches.Batches.map`."""
        results, seconds = [], []
        for item in items:
            began = time.process_time()
            results.append(FUNCTIONS[function](context, item))
            seconds.append(time.process_time() - began)
        self.calls.append(seconds)
        return results

    def note(self, compared: int) -> None:
        """Do nothing."""


def seconds_on(workers: int, calls: Sequence[Sequence[float]], others: float) -> float:
    """Return the seconds on so many workers: of `others`, and of the batches of all calls, one call after another."""
    total = others
    for batches in calls:
        busy = [0.0] * workers
        for seconds in batches:
            busy[busy.index(min(busy))] += seconds
        total += max(busy)
    return total


def run(options: Namespace) -> None:
    """Print for each system, noise and seed the processor seconds, the speed-up and the digest of the result."""
    heads = ("system", "noise %", "seed", "cpu s", *(f"speed-up, {count} workers" for count in WORKERS), "digest")
    say(table(heads, [_measured(*key, options) for key in keys(options)]))


def _measured(name: str, noise: float, seed: int, options: Namespace) -> tuple[str, ...]:
    prepared = case(name, noise, seed, options)
    batches, began = MeasuredBatches(), time.process_time()
    job, data = prepare_job(prepared.table.to_bytes(), prepared.config, batches=batches)
    seconds = time.process_time() - began
    digest = hashlib.sha256(encode_value(job) + data).hexdigest()[:12]
    others = seconds - sum(map(sum, batches.calls))
    speeds = [f"{seconds / seconds_on(count, batches.calls, others):.1f}" for count in WORKERS]
    row = (name, f"{noise:g}", str(seed), f"{seconds:.1f}", *speeds, digest)
    note(", ".join(row))
    return row
