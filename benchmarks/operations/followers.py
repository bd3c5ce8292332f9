"""What a coordinator takes to tell many followers of one busy job what changes.

Followers are real clients with connections of their own, many of them in each of a few processes; a worker searches a
job without an end. The coordinator's processor time is measured without followers and with them.
"""

import contextlib
import json
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Final

from atoll.client.client import connected
from atoll.client.follower import Subscription
from atoll.terminal.output import note, say
from atoll_core.errors import AtollError
from benchmarks.harness.accounts import processor_seconds, status
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, COORDINATOR, Machines, running, wait_until
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.harness.tables import Columns
from benchmarks.operations.scale import ENDLESS

GOAL: Final = 0.1
"""Cores that 200 followers may cost."""

JOB: Final = "followed"
EACH: Final = 50
"""Followers of one process."""

READY_LIMIT_S: Final = 300.0


@dataclass(frozen=True)
class Told:
    """What the coordinator took, in cores, and what each follower heard in a second, in the mean."""

    followers: int
    cores: float
    loop: float
    resident: int
    changes: float
    questions: float


class Host:
    """Many followers in this process; prints what they have heard each second, as JSON."""

    def __init__(self, address: str, number: int) -> None:
        self.changes = self.questions = self.here = 0
        self._lock = threading.Lock()
        for _ in range(number):
            threading.Thread(target=self._follow, args=(address,), daemon=True).start()

    def _follow(self, address: str) -> None:
        with connected(address, READY_LIMIT_S) as client:
            follow = client.follow

            def counted(job: str | None, after: int | None, sequence: int) -> object:
                self._count(questions=1)
                return follow(job, after, sequence)

            client.follow = counted  # type: ignore[method-assign,assignment]
            subscription = Subscription(client, JOB)
            subscription.wait(READY_LIMIT_S)
            self._count(here=1)
            while True:
                with contextlib.suppress(AtollError):
                    self._count(changes=subscription.wait(60.0) is not None)

    def _count(self, changes: int = 0, questions: int = 0, here: int = 0) -> None:
        with self._lock:
            self.changes += changes
            self.questions += questions
            self.here += here

    def run(self) -> None:
        """Print for ever."""
        while True:
            line = {"here": self.here, "changes": self.changes, "questions": self.questions}
            print(json.dumps(line), flush=True)
            time.sleep(0.5)


class Hosts:
    """Processes of followers, and the last line of each."""

    def __init__(self, machines: Machines, number: int) -> None:
        self._lines: dict[int, dict[str, int]] = {}
        for first in range(0, number, EACH):
            words = ["--host", machines.address, "--followers", str(min(EACH, number - first))]
            command = [sys.executable, "-m", "benchmarks.operations.followers", *words]
            process = machines.start_program(f"followers{first}", command)
            threading.Thread(target=self._read, args=(first, process), daemon=True).start()

    def _read(self, index: int, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines[index] = json.loads(line)

    def total(self, name: str) -> int:
        """Return what all of them have counted."""
        return sum(line[name] for line in self._lines.values())


@contextlib.contextmanager
def busy() -> Iterator[tuple[Machines, object]]:
    """Run a coordinator and a worker that searches a job without an end."""
    with running(1) as (machines, client):
        digest = client.upload(table_of(trajectories("lotka_volterra")).to_bytes())
        client.submit(JOB, JOB, configured(0, budget=ENDLESS), digest)
        late = "the job was not under way"
        wait_until(client, lambda: any(one.epoch for one in client.status(JOB).variables), late, READY_LIMIT_S)
        yield machines, client


def measured(machines: Machines, hosts: Hosts, followers: int, seconds: float) -> Told:
    """Return what the coordinator takes while nothing else happens than the search and its following."""
    pid = machines.pid(COORDINATOR)
    before = processor_seconds(pid), processor_seconds(pid, pid), hosts.total("changes"), hosts.total("questions")
    began = time.monotonic()
    time.sleep(seconds)
    seconds = time.monotonic() - began
    after = processor_seconds(pid), processor_seconds(pid, pid), hosts.total("changes"), hosts.total("questions")
    cores, loop, changes, questions = ((last - first) / seconds for first, last in zip(before, after, strict=True))
    each = max(1, followers)
    return Told(followers, cores, loop, status(pid, "VmRSS"), changes / each, questions / each)


@program(
    "benchmarks.operations.followers",
    __doc__,
    option("--followers", type=whole, default=200, help="how many follow the job (%(default)s)"),
    option("--seconds", type=positive, default=20.0, help="length of each of two measurements (%(default)g)"),
    option("--host", metavar="ADDRESS", help="be one of the processes of followers"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 where the followers cost more than `GOAL`, else 0."""
    if options.host:
        Host(options.host, options.followers).run()
    record = Record("followers", options.words, options.out)
    with busy() as (machines, _):
        none = measured(machines, Hosts(machines, 0), 0, options.seconds)
        hosts = Hosts(machines, options.followers)
        end = time.monotonic() + READY_LIMIT_S
        while hosts.total("here") < options.followers:
            machines.check()
            if time.monotonic() > end:
                raise AtollError(f"{hosts.total('here')} of {options.followers} followers were there in time")
            time.sleep(0.5)
        note(f"{options.followers} followers are there")
        time.sleep(CONNECT_LIMIT_S / 10)
        all_ = measured(machines, hosts, options.followers, options.seconds)
    say(
        Columns(
            "followers={followers} | cores={cores:.3f} | of which loop={loop:.3f} | MB in memory={resident:B.0f} | "
            "changes/s each={changes:.2f} | questions/s each={questions:.3f}"
        ).table([none, all_])
    )
    cost = all_.cores - none.cores
    say(f"\n{options.followers} followers cost {cost:.3f} of a core (goal {GOAL:g}); load {load():.1f}")
    record.write(told=[asdict(none), asdict(all_)], cost=cost)
    return 0 if cost <= GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
