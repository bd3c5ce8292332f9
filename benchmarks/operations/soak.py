"""An hour of jobs that arrive and workers that come and go: memory and open files must stay as they are.

``python -m benchmarks.operations.soak --minutes 60`` starts a coordinator and two workers that stay, each a process of
its own, over real zenoh. Every few seconds a client connects anew, submits a short job, follows it and goes; one in six
is cancelled, one in ten has data that cannot be used. A third worker joins, is stopped, ends or is killed by turns.
Memory (RSS), open files and threads of those that stay are sampled; what was sampled in the first fifth of the time,
while caches fill, is left out. Returns 1 when a series rises (`benchmarks.operations.trend`) or a job ends otherwise
than it must, else 0.
"""

import sys
import time
from argparse import Namespace
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from atoll.client.client import Client, connected
from atoll.terminal.output import note, say, table
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from benchmarks.harness.accounts import PROCESSES, status
from benchmarks.harness.command_line import OUT, option, positive, program
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import COORDINATOR, Machines, running
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.operations.trend import Trend, trend

SAMPLE_S: Final = 5.0
SAY_S: Final = 60.0
SETTLED_SHARE: Final = 0.2
CONNECT_S: Final = 30.0
JOB_LIMIT_S: Final = 300.0
SEEDS: Final = 3
GUEST: Final = "w2"
STAYING: Final = (COORDINATOR, "w0", "w1")
MEGABYTE: Final = 1024.0 * 1024.0


@dataclass(frozen=True)
class Sample:
    """What a process uses. `memory` in MB."""

    name: str
    at_s: float
    memory: float
    files: int
    threads: int


@dataclass
class Soak:
    """Jobs, guests and samples."""

    machines: Machines
    every_s: float
    seed: int
    samples: list[Sample] = field(default_factory=list)
    jobs: Counter[str] = field(default_factory=Counter)
    guests: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._stream = Stream(stream_key(self.seed, "", -1, 0, "soak"))
        self._digests: dict[int, str] = {}
        self._began = self._sampled = self._said = time.monotonic()

    def run(self, seconds: float) -> None:
        """Let it happen for so long."""
        number = 0
        while time.monotonic() - self._began < seconds:
            self._guest()
            with connected(self.machines.address, CONNECT_S) as client:
                self._job(client, number)
            self._rest()
            number += 1

    def _job(self, client: Client, number: int) -> None:
        """Submit a job of one of three kinds and see that it ends as it must."""
        draw, seed = self._stream.below(30), self._stream.below(SEEDS)
        expected = "cancelled" if draw < 5 else "failed" if draw < 8 else "done"
        sampled = trajectories("lotka_volterra")
        data = table_of(sampled).to_bytes() if expected != "failed" else b"nothing that could be read"
        config = short_job(seed, endless=expected == "cancelled")
        job = f"soak-{number}"
        client.submit(job, "a job of the soak", config, client.upload(data))
        if expected == "cancelled":
            self._pause(client, 1.0 + 2.0 * self._stream.uniform())
            client.cancel(job)
        view = self._follow(client, job)
        self.jobs[view.state] += 1
        if view.state != expected:
            self.wrong.append(f"{job} is {view.state}, {expected} was expected: {view.reason}")
        elif expected == "done":
            digest = str(client.result(job)["digest"])
            if self._digests.setdefault(seed, digest) != digest:
                self.wrong.append(f"{job} has another digest than the same job had before")

    def _follow(self, client: Client, job: str) -> JobView:
        end = time.monotonic() + JOB_LIMIT_S
        while (view := client.status(job)).state not in FINAL_STATES:
            if time.monotonic() > end:
                raise AtollError(f"{job} has not ended within {JOB_LIMIT_S:.0f} s: {view.state}, {view.reason}")
            self._pause(client, 0.2)
        return view

    def _guest(self) -> None:
        """Have the guest come, go, or be struck; every few rounds."""
        draw = self._stream.below(12)
        if not self.machines.is_running(GUEST):
            if draw < 6:
                self.guests["joined"] += 1
                self.machines.start(GUEST)
        elif draw < 2:
            self.guests["ended"] += 1
            self.machines.end(GUEST)
        elif draw < 4:
            self.guests["killed"] += 1
            self.machines.kill(GUEST)
        elif draw < 5:
            self.guests["stopped"] += 1
            self.machines.stop(GUEST)
        else:
            self.machines.resume(GUEST)

    def _pause(self, client: Client, seconds: float) -> None:
        client.pause(seconds)
        self._sample()

    def _rest(self) -> None:
        end = time.monotonic() + self.every_s * (0.5 + self._stream.uniform())
        while time.monotonic() < end:
            time.sleep(0.5)
            self._sample()

    def _sample(self) -> None:
        now = time.monotonic()
        if now - self._sampled < SAMPLE_S:
            return
        self._sampled = now
        self.samples += [measured(name, self.machines.pid(name), now - self._began) for name in STAYING]
        if now - self._said >= SAY_S:
            self._said = now
            last = ", ".join(f"{sample.name} {sample.memory:.0f} MB" for sample in self.samples[-len(STAYING) :])
            note(f"{(now - self._began) / 60.0:.0f} min: {self.jobs.total()} jobs, {last}")

    def trends(self) -> dict[tuple[str, str], Trend]:
        """Return the trend of each process's memory, files and threads after the first fifth of the time."""
        settled_s = SETTLED_SHARE * max((sample.at_s for sample in self.samples), default=0.0)
        trends = {}
        for name in STAYING:
            series = [sample for sample in self.samples if sample.name == name and sample.at_s >= settled_s]
            if len(series) >= 3:
                times = [sample.at_s for sample in series]
                for what in ("memory", "files", "threads"):
                    trends[name, what] = trend(times, [float(getattr(sample, what)) for sample in series])
        return trends

    def show(self) -> bool:
        """Print what came of it; return whether all is well."""
        trends = self.trends()
        rows = [(*key, *_row(line)) for key, line in trends.items()]
        say(table(("process", "what", "mean", "an hour", ""), rows))
        lines = [
            f"{self.jobs.total()} jobs: {_counted(self.jobs)}; the guest: {_counted(self.guests)}; load {load():.1f}",
            *self.wrong,
        ]
        say("\n".join(["", *lines]))
        return not self.wrong and all(trend.is_flat for trend in trends.values())


def measured(name: str, pid: int, at_s: float) -> Sample:
    """Return what a process uses now, by the system's account of it (Linux)."""
    files = sum(1 for _ in (PROCESSES / str(pid) / "fd").iterdir())
    return Sample(name, at_s, status(pid, "VmRSS") / MEGABYTE, files, status(pid, "Threads"))


def short_job(seed: int, endless: bool) -> JobConfig:
    """Return a job of a few epochs, or one that goes on until it is cancelled."""
    budget = {**UNENDING, "max_epochs": 10**6 if endless else 3}
    return configured(seed, budget=budget, islands=3, population=16)


def _row(line: Trend) -> tuple[str, str, str]:
    slope, error = 3600.0 * line.slope, 3600.0 * line.error
    return f"{line.mean:.1f}", f"{slope:+.2f} ± {error:.2f}", "flat" if line.is_flat else "RISES"


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in sorted(counts.items())) or "nothing"


@program(
    "soak",
    __doc__,
    option("--minutes", type=positive, default=60.0, help="how long (%(default)g)"),
    option("--every", type=positive, default=8.0, metavar="SECONDS", help="between jobs (%(default)g)"),
    option("--seed", type=int, default=0, help="of what happens (%(default)s)"),
    option("--keep", type=Path, metavar="DIR", help="folder that keeps the store and the logs"),
    OUT,
    prog="soak",
)
def main(options: Namespace) -> int:
    """Run from the command line."""
    with running(2, keep=options.keep, guests=(GUEST,)) as (machines, _):
        soak = Soak(machines, options.every, options.seed)
        try:
            soak.run(60.0 * options.minutes)
        finally:
            is_well = soak.show()
            samples = [asdict(sample) for sample in soak.samples]
            record = Record("soak", options.words, options.out)
            record.write(samples=samples, jobs=dict(soak.jobs), wrong=soak.wrong)
    return int(not is_well)


if __name__ == "__main__":
    sys.exit(main())
