"""A Slurm of one node, with all of its files in a folder of its own."""

import os
import socket
from dataclasses import dataclass, replace
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.machine import Machine, NotPossibleError, free_port, wait_until

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
