"""A Slurm of one node, and the job on it: by sbatch, and by one srun."""

import os
import re
import socket
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, free_port, wait_until

PROGRAMS = {"sbatch": "slurm-wlm", "slurmctld": "slurm-wlm", "slurmd": "slurm-wlm", "munged": "munge"}
SETTINGS = """\
ClusterName=rehearsal
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
TOGETHER = f"{ROOT}/deploy/slurm/together"


@dataclass(frozen=True)
class Slurm:
    """A Slurm of one node; calling it runs a program of Slurm and returns what it prints."""

    machine: Machine
    folder: Path
    environment: tuple[str, ...]

    title = "Slurm"

    def in_folder(self, results: Path) -> "Slurm":
        """Return the same Slurm, whose jobs keep their files in this folder."""
        return replace(self, environment=(*self.environment, f"ATOLL_DIR={results}"))

    def __call__(self, *words: str) -> str:
        return self.machine.run(*self.environment, *words).stdout.strip()

    @property
    def adapt_options(self) -> tuple[str, ...]:
        """Options of ``coordinator adapt``; the output of a job is in ``folder``."""
        return ("--batch", "slurm", f"--sbatch=--output={self.folder}/%j.out --time=60")

    def jobs(self) -> dict[str, bool]:
        """Return whether each job runs, by its id."""
        lines = self("squeue", "--noheader", "--format=%A %T").splitlines()
        return {number: state == "RUNNING" for number, state in (line.split() for line in lines)}

    def kill(self, number: str) -> None:
        """End a job as when its node is lost."""
        self("scancel", "--signal=KILL", "--full", number)

    def output(self, number: str) -> str:
        """Return what a job printed."""
        return (self.folder / f"{number}.out").read_text("utf-8")


def start_slurm(machine: Machine, name: str) -> Slurm:
    """Start a Slurm that keeps its files in a folder of this name, for programs of the checkout.

    Raises:
        NotPossibleError: Slurm is not installed, or this is not root.
    """
    if os.geteuid() != 0:
        raise NotPossibleError("a node of Slurm runs jobs as their users, which needs root")
    machine.need(PROGRAMS)
    folder = machine.work / f"{name}-{machine.id}"
    path = f"PATH={Path(job.PROGRAM).parent}:{os.environ['PATH']}"
    slurm = Slurm(machine, folder, ("env", f"SLURM_CONF={folder}/slurm.conf", path))
    _start_daemons(slurm)
    return slurm


def _start_daemons(slurm: Slurm) -> None:
    machine, folder, environment = slurm.machine, slurm.folder, slurm.environment
    host = socket.gethostname().split(".")[0]
    for each in (folder, folder / "state", folder / "spool"):
        each.mkdir()
    (folder / "munge.key").write_bytes(os.urandom(1024))
    (folder / "munge.key").chmod(0o600)
    places = {"folder": folder, "host": host, "controller_port": free_port(), "node_port": free_port()}
    cores = len(os.sched_getaffinity(0))
    (folder / "slurm.conf").write_text(SETTINGS.format(**places, cores=cores), "utf-8")
    files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    options = (f"--{key}={folder}/munge.{end}" for key, end in files.items())
    machine.start("munged", "munged", "--foreground", "--force", *options)
    wait_until("munged listens", (folder / "munge.socket").exists)
    machine.start("slurmctld", *environment, "slurmctld", "-D", "-i")
    machine.start("slurmd", *environment, "slurmd", "-D", "-N", host)
    asking = (*environment, "sinfo", "-h", "-o", "%T")
    wait_until("the node is idle", lambda: machine.run(*asking, check=False).stdout.strip() == "idle")


def rehearse_slurm(machine: Machine) -> str:
    """Run the job by sbatch and by srun; return what was done."""
    slurm = start_slurm(machine, "slurm")
    return f"{_run_batch(slurm)}; {_run_together(slurm)}"


def _run_batch(started: Slurm) -> str:
    """Submit the job with sbatch, end it as when time runs out, and continue it."""
    machine, folder, cores = started.machine, started.folder, len(os.sched_getaffinity(0))
    results, tls = folder / "atoll", folder / "atoll" / "tls"
    slurm = started.in_folder(results)

    def submit() -> str:
        options = ("--nodes=1", f"--cpus-per-task={cores}", "--time=60", f"--output={folder}/%j.out")
        return slurm("sbatch", "--parsable", *options, f"{ROOT}/deploy/slurm/atoll.sbatch", str(job.DATA), *job.OPTIONS)

    def wait_for_end(number: str) -> str:
        """Return what a job printed when it has ended; raises FailedError unless it completed."""

        def state() -> str:
            return "".join(re.findall(r"JobState=(\w+)", slurm("scontrol", "show", "job", number)))

        wait_until(f"job {number} ended", lambda: state() not in ("PENDING", "RUNNING", "COMPLETING"), job.LIMIT_S)
        said = slurm.output(number)
        if state() != "COMPLETED":
            raise FailedError(f"job {number} of Slurm is {state()}:\n{said[-2000:]}")
        return said

    first, file = submit(), results / "address"
    wait_until("a coordinator has an address", lambda: file.exists() and bool(file.read_text("utf-8")), job.LIMIT_S)
    certificates = (f"--tls-ca={tls}/authority.pem", f"--tls-cert={tls}/certificate.pem", f"--tls-key={tls}/key.key")
    job.wait_until_under_way(machine, cores, file.read_text("utf-8").split()[-1], *certificates)
    slurm("scancel", "--batch", "--signal=TERM", first)  # as --signal=B:TERM@120 does when the time limit is near
    if "time is nearly over" not in (said := wait_for_end(first)):
        raise FailedError(f"atoll.sbatch did not say that its time is nearly over, but: {said}")
    logs = [file.read_text("utf-8") for file in results.glob("worker-*.log")]
    if not logs or not all("this worker ends" in log for log in logs):
        raise FailedError("workers were killed at the end of their time, though they should have handed over")
    if (results / "result").exists():
        raise FailedError("the job that was cut off has a result already")
    wait_for_end(submit())
    job.check_digest(machine, results / "result")
    return f"atoll.sbatch on {cores} cores stopped, submitted again and finished, digest equal to the checkout's"


def _run_together(started_slurm: Slurm) -> str:
    """Run coordinator and workers as two tasks of one srun, cancel it, go on, and kill a task."""
    results = started_slurm.folder / "together"
    slurm, machine = started_slurm.in_folder(results), started_slurm.machine
    options = ("--ntasks=2", "--cpus-per-task=1", "--overcommit", "--time=60")

    def start() -> "tuple[subprocess.Popen[bytes], int]":
        """Start both tasks, wait until both compute; return srun and the epoch that the store had at first."""
        words = (*slurm.environment, "srun", *options, TOGETHER, str(job.DATA), *job.OPTIONS)
        started = machine.start("srun", *words)
        wait_until("the job of Slurm runs", lambda: any(slurm.jobs().values()))
        address = results / f"address-{next(iter(slurm.jobs()))}-0"
        wait_until("a coordinator has an address", lambda: address.exists() and bool(address.read_text("utf-8")))
        names = {"ca": "authority", "cert": "certificate", "key": "key"}
        certificates = (f"--tls-{key}={results}/tls/me/{name}.pem" for key, name in names.items())
        where = (address.read_text("utf-8").split()[0], *certificates)
        views = job.ask(machine, "jobs", *where)
        at_first = min((each["epoch"] for view in views for each in view["variables"]), default=0)
        job.wait_until_under_way(machine, 2, *where)
        return started, at_first

    cancelled, _ = start()
    slurm("scancel", *slurm.jobs())  # signals all processes, as when the time limit is reached
    wait_until("srun and its job ended after scancel", lambda: cancelled.poll() is not None and not slurm.jobs())
    if (results / "result").exists():
        raise FailedError("the job that was cancelled has a result already")
    started, at_first = start()
    if at_first < job.EARLY // 2:
        raise FailedError(f"the job did not go on from its checkpoint, but from epoch {at_first}")
    machine.kill("SLURM_PROCID=1")
    started.wait(job.LIMIT_S)
    job.check_digest(machine, results / "result")
    wait_until("no process of a task is left", lambda: not machine.processes("", "SLURM_PROCID=0"))
    return (
        f"two tasks of one srun, cancelled and started again at epoch {at_first}, the second task killed, digest equal "
        f"to the checkout's, exit code of srun {started.returncode}"
    )
