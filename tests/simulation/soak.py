"""Many schedules of faults and guests, on all cores, and the story of a single one.

``python -m tests.simulation.soak --schedules 10000`` plays the schedules of seeds 0 to 9999 in child processes, each
with another PYTHONHASHSEED, and prints what struck how often and which seeds failed. One schedule in a hundred has real
islands. ``--seed 123`` plays one and tells its story; ``--seed 123 --shrink`` leaves out what is not needed for it to
fail. Returns 1 when any schedule fails, else 0.
"""

import argparse
import json
import logging
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note, say
from tests.simulation.harness.fault_schedule import Schedule, schedule_of
from tests.simulation.harness.participants import STUBS, Cast
from tests.simulation.harness.schedule_run import Outcome, ScheduleRun
from tests.simulation.harness.shrink import shrunk

ROOT: Final = Path(__file__).resolve().parents[2]
CHUNK: Final = 200
"""Schedules per child process."""

REAL_EVERY: Final = 100
CHUNK_LIMIT_S: Final = 3600.0


@dataclass
class Tally:
    """What came of many schedules."""

    schedules: int = 0
    real: int = 0
    jobs: int = 0
    guests: int = 0
    cancelled: int = 0
    cpu_s: float = 0.0
    virtual_s: float = 0.0
    struck: Counter[str] = field(default_factory=Counter)
    faults: Counter[int] = field(default_factory=Counter)
    failed: dict[int, str] = field(default_factory=dict)
    histories: dict[int, str] = field(default_factory=dict)

    def take(self, outcome: Outcome, cpu_s: float) -> None:
        schedule = outcome.schedule
        self.schedules += 1
        self.real += is_real(schedule.seed)
        self.jobs += len(schedule.jobs)
        self.guests += len(schedule.guests)
        self.cancelled += sum(job.cancel_s is not None for job in schedule.jobs)
        self.cpu_s += cpu_s
        self.virtual_s += outcome.seconds
        self.struck += outcome.struck
        self.faults[outcome.struck.total()] += 1
        if outcome.wrong:
            self.failed[schedule.seed] = outcome.wrong[0][:300]

    def add(self, other: "Tally") -> None:
        for name in ("schedules", "real", "jobs", "guests", "cancelled", "cpu_s", "virtual_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.struck += other.struck
        self.faults += other.faults
        self.failed |= other.failed
        for seed, history in other.histories.items():
            if self.histories.setdefault(seed, history) != history:
                self.failed[seed] = "its history is another one with another PYTHONHASHSEED"

    def to_json(self) -> str:
        return json.dumps({**vars(self), "struck": dict(self.struck), "faults": list(self.faults.items())})

    @classmethod
    def from_json(cls, text: str) -> "Tally":
        read: dict[str, Any] = json.loads(text)
        by_seed = {name: {int(seed): text for seed, text in read[name].items()} for name in ("failed", "histories")}
        return cls(**{**read, **by_seed, "struck": Counter(read["struck"]), "faults": Counter(dict(read["faults"]))})

    def __str__(self) -> str:
        schedules = max(self.schedules, 1)
        lines = [
            f"{self.schedules} schedules ({self.real} with real islands), {self.jobs} jobs of which {self.cancelled} "
            f"to be cancelled, {self.guests} guests: {len(self.failed)} failed",
            f"{self.struck.total()} faults, {self.struck.total() / schedules:.1f} a schedule; "
            f"{self.cpu_s / schedules:.3f} s of CPU and {self.virtual_s / schedules:.0f} s of virtual time a schedule",
            "faults a schedule: " + ", ".join(f"{count}: {self.faults[count]}" for count in sorted(self.faults)),
            *(f"{count:8d}  {kind}" for kind, count in self.struck.most_common()),
            *(f"seed {seed} failed: {self.failed[seed]}" for seed in sorted(self.failed)),
        ]
        return "\n".join(lines)


def is_real(seed: int) -> bool:
    """Tell whether the schedule of a seed is played with real islands."""
    return seed % REAL_EVERY == REAL_EVERY - 1


def cast_of(seed: int) -> Cast:
    """Return what the islands of a schedule are made of."""
    if not is_real(seed):
        return STUBS
    from tests.simulation.test_real_islands import CONFIG, RealCompute, prepare

    return Cast(RealCompute, prepare, lambda job: (CONFIG.model_copy(update={"seed": job % 3}), "x,y"))


def play(schedule: Schedule) -> Outcome:
    """Play one schedule."""
    return ScheduleRun(schedule, cast_of(schedule.seed)).play()


def tally_of(seeds: Sequence[int]) -> Tally:
    """Play the schedules of these seeds, one after the other."""
    tally = Tally()
    for seed in seeds:
        began = time.process_time()
        outcome = play(schedule_of(seed))
        tally.take(outcome, time.process_time() - began)
        if seed in (seeds[0], seeds[-1]):
            tally.histories[seed] = outcome.history
    return tally


def in_child(first: int, last: int) -> Tally:
    """Play schedules in a process of its own, whose PYTHONHASHSEED depends on the first."""
    words = ["-m", "tests.simulation.soak", "--child", "--first", str(first), "--schedules", str(last - first)]
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]  # so that children run the code of this process
    environment = {**os.environ, "PYTHONHASHSEED": str(first % 2**32), "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, timeout=CHUNK_LIMIT_S, check=True,
    )  # fmt: skip
    return Tally.from_json(done.stdout)


def chunks(first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield the seeds of the children; neighbours share one, so that its histories can be compared."""
    for begin in range(first, last, CHUNK):  # the last one of each is the first of the next
        yield begin, min(begin + CHUNK + 1, last)


def soak(first: int, last: int, processes: int) -> Tally:
    """Play the schedules of seeds `first` to `last` (excluded) in children; tell on the way which fail."""
    total = Tally()
    with ThreadPoolExecutor(processes) as pool:
        for chunk in pool.map(lambda chunk: in_child(*chunk), chunks(first, last)):
            known = set(total.failed)
            total.add(chunk)
            for seed in sorted(set(total.failed) - known):
                note(f"seed {seed} failed: {total.failed[seed]}")
            note(f"{total.schedules} schedules, {len(total.failed)} failed")
    return total


def tell(schedule: Schedule, is_shrunk: bool) -> bool:
    """Print the story of a schedule; return whether it fails."""
    if is_shrunk:
        schedule = shrunk(schedule, play)
    outcome = play(schedule)
    end = "What must not happen:" if outcome.wrong else "Nothing went wrong."
    say("\n".join([schedule.story(), "", "What happened:", *outcome.story, "", end, *outcome.wrong]))
    return bool(outcome.wrong)


def main(words: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="soak", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--schedules", type=int, default=1000, help="how many (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (%(default)s)")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="at a time (%(default)s)")
    parser.add_argument("--seed", type=int, help="play this one and tell its story")
    parser.add_argument("--shrink", action="store_true", help="leave out of that one what it does not need to fail")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    logging.disable(logging.CRITICAL)
    if options.seed is not None:
        return int(tell(schedule_of(options.seed), options.shrink))
    last = options.first + options.schedules
    if options.child:
        say(tally_of(range(options.first, last)).to_json())
        return 0
    tally = soak(options.first, last, options.processes)
    say(str(tally))
    return int(bool(tally.failed))


if __name__ == "__main__":
    sys.exit(main())
