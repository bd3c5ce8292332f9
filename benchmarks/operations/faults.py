"""Real faults: programs are killed and stopped, lines cut, at moments drawn from a seed; the answer must stay the same.

``python -m benchmarks.operations.faults --jobs 20 --strikes 100`` starts a coordinator on a store and workers, each a
process of its own, over real zenoh. Each job is searched once in peace; then again while strikes fall, one after the
other, each after the searches have recovered from the one before. Who was killed is started again, who was stopped goes
on, lines are mended after a while that is drawn as well (a worker stopped for longer than its lease comes back from the
dead).

The time lost by a strike is how long the search of any equation stood still after it, less what an epoch usually takes.
The time lost by a job is its duration less that of the calm one. ``--own-router`` puts a router in front of the
coordinator; ``--networks`` gives each worker a network that can be cut (root). Returns 1 when a job does not end as the
calm one did, else 0.
"""

import statistics
import sys
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final, TypeVar

from atoll.client.client import Client
from atoll.terminal.output import note, say, table
from atoll_coordinator.result.result import Result
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from benchmarks.harness.command_line import OUT, option, program, whole, workers
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Machines, can_have_networks, running
from benchmarks.harness.systems import TABLE_III, table_of, trajectories
from benchmarks.operations.strikes import LASTING_S, Blow, Kind, Standing, Strikes, kinds_of, rows

A = TypeVar("A")

LOOK_S: Final = 0.05
GLANCE_S: Final = 0.6
"""How long an answer is waited for after a strike."""

RECOVERY_LIMIT_S: Final = 120.0
"""Longer than any lease: a search that stands still so long is stuck."""

PAUSE_S: Final = (0.3, 2.0)
"""Between the recovery from a strike and the next one."""


@dataclass
class Calm:
    """A job in peace."""

    digest: str
    seconds: float
    epoch_s: float


@dataclass
class Struck:
    """A job under strikes. `seconds` includes what was lost."""

    job: str
    seed: int
    state: str
    is_equal: bool
    seconds: float
    calm_s: float
    strikes: int

    @property
    def lost_s(self) -> float:
        """Seconds lost by each strike, on average."""
        return (self.seconds - self.calm_s) / max(1, self.strikes)


@dataclass
class Campaign:
    """Jobs and strikes, one after the other."""

    machines: Machines
    client: Client
    strikes: Strikes
    config: JobConfig
    system: str
    blows: list[Blow] = field(default_factory=list)
    jobs: list[Struck] = field(default_factory=list)
    calm: dict[int, Calm] = field(default_factory=dict)

    def run(self, jobs: int, strikes: int) -> None:
        """Have so many jobs struck so often in all, the same number each."""
        self._table = self.client.upload(table_of(trajectories(self.system)).to_bytes())
        for number in range(jobs):
            self._calm(number)
            share = (strikes * (number + 1)) // jobs - len(self.blows)
            self._struck(number, share)

    def _calm(self, seed: int) -> None:
        job, began = self._submit(f"calm-{seed}", seed), self.client.now()
        view = self._follow(job)
        result = Result.of(self.client.result(job))
        epochs = max(variable.epoch for variable in view.variables)
        self.calm[seed] = Calm(str(result.digest), self.client.now() - began, (result.search_seconds or 0.0) / epochs)

    def _struck(self, seed: int, strikes: int) -> None:
        job, began = self._submit(f"struck-{seed}", seed), self.client.now()
        before, calm = len(self.blows), self.calm[seed]
        self._await(job, lambda view: any(variable.epoch > 0 for variable in view.variables))
        while len(self.blows) - before < strikes and not self._is_over(job):
            self.client.pause(self.strikes.between(*PAUSE_S))
            self._strike(job, calm, began)
        view = self._follow(job)
        is_equal = view.state == "done" and self._patiently(lambda: self.client.result(job))["digest"] == calm.digest
        seconds = self.client.now() - began
        done = Struck(job, seed, view.state, is_equal, seconds, calm.seconds, len(self.blows) - before)
        self.jobs.append(done)
        note(
            f"{job}: {view.state}, {'same digest' if is_equal else 'ANOTHER DIGEST'}, {seconds:.1f} s "
            f"(calm {calm.seconds:.1f} s), {done.strikes} strikes"
        )

    def _strike(self, job: str, calm: Calm, began: float) -> None:
        """Strike once; wait until the searches have recovered, and everybody is back."""
        standing = self._look(job)
        if not standing.epochs or len(standing.over) == len(standing.epochs):
            return
        strike, at_s = self.strikes.next(), self.client.now()
        strike.carry_out(self.machines)
        recovered, is_undone = None, False
        while recovered is None or not is_undone:
            now = self.client.now() - at_s
            if not is_undone and now >= strike.for_s:
                strike.undo(self.machines)
                is_undone = True
            if recovered is None and (is_undone or strike.who in self.machines.workers):
                recovered = self._recovered(job, standing, at_s)
            if now > RECOVERY_LIMIT_S:
                raise AtollError(f"{job} has stood still for {now:.0f} s after {strike}")
            self.client.pause(LOOK_S)
        lost = max(0.0, recovered - calm.epoch_s)
        self.blows.append(Blow(strike.kind, strike.who, strike.for_s, job, at_s - began, lost))
        note(f"  {at_s - began:6.1f} s: {strike.kind} {strike.who} for {strike.for_s:.1f} s; {lost:.2f} s lost")

    def _recovered(self, job: str, standing: Standing, at_s: float) -> float | None:
        """Return the seconds since the strike, if all searches have got further since."""
        with suppress(UnreachableError):
            if standing.is_passed_by(Standing.of(self.client.status(job, GLANCE_S))):
                return self.client.now() - at_s
        return None

    def _submit(self, name: str, seed: int) -> str:
        config = self.config.model_copy(update={"seed": seed})
        self.client.submit(name, f"{self.system}, seed {seed}", config, self._table)
        return name

    def _look(self, job: str) -> Standing:
        return Standing.of(self._patiently(lambda: self.client.status(job)))

    def _is_over(self, job: str) -> bool:
        return self._patiently(lambda: self.client.status(job)).state in FINAL_STATES

    def _follow(self, job: str) -> JobView:
        return self._await(job, lambda view: False)

    def _await(self, job: str, condition: Callable[[JobView], bool]) -> JobView:
        """Wait until the job's view fulfils a condition, or the job has ended."""
        while True:
            view = self._patiently(lambda: self.client.status(job))
            if view.state in FINAL_STATES or condition(view):
                return view
            self.client.pause(LOOK_S)

    def _patiently(self, ask: Callable[[], A]) -> A:
        """Ask until the coordinator answers, which it does when it is back."""
        end = self.client.now() + RECOVERY_LIMIT_S
        while True:
            try:
                return ask()
            except UnreachableError:
                if self.client.now() > end:
                    raise

    def show(self) -> None:
        """Print what came of it."""
        say(table(("strike", "number", "median lost s", "worst lost s", "longest s"), rows(self.blows)))
        equal = sum(job.is_equal for job in self.jobs)
        per_strike = [job.lost_s for job in self.jobs if job.strikes]
        lines = [
            f"{len(self.blows)} strikes on {len(self.jobs)} jobs: {equal} of {len(self.jobs)} with the calm digest"
        ]
        if per_strike:
            lines.append(
                f"by the duration of jobs: median {statistics.median(per_strike):.2f} s lost by a strike, worst job "
                f"{max(per_strike):.2f} s"
            )
        lines.append(
            f"calm jobs took {statistics.median(calm.seconds for calm in self.calm.values()):.1f} s; load {load():.1f}"
        )
        say("\n".join(["", *lines]))


def _kinds(options: Namespace) -> tuple[Kind, ...]:
    if options.networks and not can_have_networks():
        raise UsageError("--networks needs Linux, root and iproute2's network namespaces; leave it out")
    left_out = [*([] if options.own_router else ["router"]), *([] if options.networks else ["cut"])]
    usual = [kind for kind in LASTING_S if not any(word in kind for word in left_out)]
    kinds = kinds_of(options.kinds.split(",") if options.kinds else usual)
    if any("router" in kind for kind in kinds) and not options.own_router:
        raise UsageError("a router can be struck with --own-router only: else it is the coordinator's")
    if "cut-worker" in kinds and not options.networks:
        raise UsageError("a worker can be cut off with --networks only")
    return kinds


@program(
    "faults",
    __doc__,
    option("--jobs", type=whole, default=4, help="how many (%(default)s)"),
    option("--strikes", type=whole, default=20, help="how many in all (%(default)s)"),
    workers(what="processes"),
    option("--kinds", metavar="LIST", help=f"of {', '.join(LASTING_S)} (all that can be)"),
    option("--own-router", action="store_true", help="a router of its own, between coordinator and workers"),
    option("--networks", action="store_true", help="give each worker a network that can be cut (root)"),
    option("--system", choices=TABLE_III, default="lotka_volterra", help="what is searched (%(default)s)"),
    option("--epochs", type=whole, default=60, help="length of each search (%(default)s)"),
    option("--islands", type=whole, default=4, help="for each equation (%(default)s)"),
    option("--seed", type=int, default=0, help="of the strikes (%(default)s)"),
    option("--keep", type=Path, metavar="DIR", help="folder that keeps the store and the logs"),
    OUT,
    prog="faults",
)
def main(options: Namespace) -> int:
    """Run from the command line."""
    kinds = _kinds(options)
    place = running(options.workers, options.keep, has_own_router=options.own_router, has_networks=options.networks)
    with place as (machines, client):
        strikes = Strikes(options.seed, kinds, machines.workers)
        config = configured(budget={**UNENDING, "max_epochs": options.epochs}, islands=options.islands)
        campaign = Campaign(machines, client, strikes, config, options.system)
        try:
            campaign.run(options.jobs, options.strikes)
        finally:
            if campaign.blows:
                campaign.show()
                Record("faults", options.words, options.out).write(
                    blows=[asdict(blow) for blow in campaign.blows],
                    jobs=[asdict(job) for job in campaign.jobs],
                    calm={str(seed): asdict(calm) for seed, calm in campaign.calm.items()},
                )
    return int(not all(job.is_equal for job in campaign.jobs))


if __name__ == "__main__":
    sys.exit(main())
