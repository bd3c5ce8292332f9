"""``coordinator adapt`` on a batch system of one node: workers are started, killed, replaced, drained."""

import os
from pathlib import Path
from typing import Protocol

from deploy.rehearsal import job
from deploy.rehearsal.grid_engine import start_grid_engine
from deploy.rehearsal.machine import FailedError, Machine, free_port, wait_until
from deploy.rehearsal.slurm import start_slurm


class BatchCluster(Protocol):
    """A batch system of one node that runs."""

    @property
    def title(self) -> str: ...
    @property
    def folder(self) -> Path: ...
    @property
    def environment(self) -> tuple[str, ...]: ...
    @property
    def adapt_options(self) -> tuple[str, ...]: ...
    def jobs(self) -> dict[str, bool]: ...
    def kill(self, number: str) -> None: ...
    def output(self, number: str) -> str: ...


def rehearse_adapt(machine: Machine) -> str:
    """Have ``coordinator adapt`` start workers in jobs of Slurm, one core each; return what was done."""
    return _rehearse(machine, start_slurm(machine, "adapt"), 1)


def rehearse_sge(machine: Machine) -> str:
    """Have ``coordinator adapt`` start workers in jobs of Grid Engine that take the node; return what was done."""
    return _rehearse(machine, start_grid_engine(machine, "sge"), len(os.sched_getaffinity(0)))


def _rehearse(machine: Machine, cluster: BatchCluster, cores: int) -> str:
    """Keep one job with so many `cores` more than there is room for, kill one that runs and drain them all."""
    room = len(os.sched_getaffinity(0)) // cores
    address = f"tcp/127.0.0.1:{free_port()}"

    def running() -> list[str]:
        return [number for number, runs in cluster.jobs().items() if runs]

    store = str(cluster.folder / "store")
    machine.start("adapt-coordinator", job.PROGRAM, "serve", "--listen", address, "--state", store)
    ping = (job.PROGRAM, "ping", "--connect", address)
    wait_until("the coordinator answers", lambda: machine.run(*ping, check=False).returncode == 0)
    bounds = ("--minimum", "0", "--maximum", str(room + 1), "--cores", str(cores), "--idle", "20s", "--interval", "1s")
    words = (job.PROGRAM, "adapt", "--connect", address, *bounds, *cluster.adapt_options)
    adapting = machine.start("adapt", *cluster.environment, *words)
    out = cluster.folder / "out"
    submit = (job.PROGRAM, "submit", str(job.DATA), *job.OPTIONS, "--connect", address, "--out", str(out))
    submitting = machine.start("adapt-client", *submit)
    before = job.wait_until_under_way(machine, room * cores, address)
    wait_until("one more job waits", lambda: len(cluster.jobs()) == room + 1)
    killed = running()[0]
    cluster.kill(killed)
    wait_until(
        f"another job of {cluster.title} has taken the place of the one that was killed",
        lambda: len(now := job.computing(machine, address)) == room * cores and now != before,
        job.LIMIT_S,
    )
    wait_until("one more job waits again", lambda: len(cluster.jobs()) == room + 1)
    kept = running()
    job.check_submitted(machine, submitting, out)
    wait_until(f"no job of {cluster.title} is left", lambda: not cluster.jobs(), job.LIMIT_S)
    for number in kept:
        if "this worker ends" not in (said := cluster.output(number)):
            raise FailedError(f"job {number} of {cluster.title} was not drained, but said: {said[-2000:]}")
    if adapting.poll() is not None:
        raise FailedError(f"coordinator adapt ended with {adapting.returncode}; see {machine.logs}")
    return (
        f"adapt kept {room + 1} jobs of {cluster.title}, of which one waited, replaced one that was killed, digest "
        f"equal to the checkout's, then took the waiting one back and drained the rest"
    )
