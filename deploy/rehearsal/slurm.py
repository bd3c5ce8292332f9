"""deploy/slurm/atoll.sbatch on a Slurm of one node: its controller, node and authentication are started for it."""

import os
import re
import socket
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, find_program, free_port, wait_until

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


def rehearse_slurm(machine: Machine) -> str:
    """Submit the job with sbatch, end it as when time runs out, and continue it; return what was done."""
    if os.geteuid() != 0:
        raise NotPossibleError("a node of Slurm runs jobs as their users, which needs root")
    machine.need(PROGRAMS)
    try:
        return _Slurm(machine).rehearse()
    finally:
        machine.end_all()


class _Slurm:
    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._cores = len(os.sched_getaffinity(0))
        self._folder = machine.work / f"slurm-{machine.id}"
        self._results = self._folder / "atoll"
        for each in (self._folder, self._folder / "state", self._folder / "spool"):
            each.mkdir()
        self._environment = {
            "SLURM_CONF": str(self._folder / "slurm.conf"),
            "ATOLL_DIR": str(self._results),
            "PATH": f"{Path(job.program('coordinator')).parent}:{os.environ['PATH']}",
        }

    def rehearse(self) -> str:
        self._start_daemons()
        first = self._submit()
        wait_until(f"workers on {self._cores} cores compute", self._is_under_way, job.LIMIT_S)
        # What --signal=B:TERM@120 does when the time limit is near.
        self._slurm("scancel", "--batch", "--signal=TERM", first)
        said = self._wait_for_end(first)
        if "time is nearly over" not in said:
            raise FailedError(f"atoll.sbatch did not say that its time is nearly over, but: {said}")
        logs = [file.read_text("utf-8") for file in self._results.glob("worker-*.log")]
        if not logs or not all("this worker ends" in log for log in logs):
            raise FailedError("workers were killed at the end of their time, though they should have handed over")
        if (self._results / "result").exists():
            raise FailedError("the job that was cut off has a result already")
        self._wait_for_end(self._submit())
        job.check_digest(self._machine, job.digest_of(self._results / "result" / "result.json"))
        return (
            f"atoll.sbatch on {self._cores} cores cut off, submitted again and finished, digest equal to the checkout's"
        )

    def _start_daemons(self) -> None:
        folder, host = self._folder, socket.gethostname().split(".")[0]
        (folder / "munge.key").write_bytes(os.urandom(1024))
        (folder / "munge.key").chmod(0o600)
        (folder / "slurm.conf").write_text(
            SETTINGS.format(
                folder=folder, host=host, cores=self._cores, controller_port=free_port(), node_port=free_port()
            ),
            "utf-8",
        )
        files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
        self._start(
            "munged", "--foreground", "--force", *(f"--{key}={folder}/munge.{end}" for key, end in files.items())
        )
        wait_until("munged listens", (folder / "munge.socket").exists)
        self._start("slurmctld", "-D", "-i")
        self._start("slurmd", "-D", "-N", host)
        wait_until("the node is idle", lambda: self._slurm("sinfo", "-h", "-o", "%T", check=False) == "idle")

    def _start(self, program: str, *options: str) -> None:
        self._machine.start(program, find_program(program) or program, *options, environment=self._environment)

    def _slurm(self, *words: str, check: bool = True) -> str:
        return self._machine.run(*words, environment=self._environment, check=check, cwd=self._folder).stdout.strip()

    def _submit(self) -> str:
        options = ("--nodes=1", f"--cpus-per-task={self._cores}", "--time=60", f"--output={self._folder}/%j.out")
        script = str(ROOT / "deploy" / "slurm" / "atoll.sbatch")
        return self._slurm("sbatch", "--parsable", *options, script, str(job.DATA), *job.OPTIONS)

    def _is_under_way(self) -> bool:
        file = self._results / "address"
        lines = file.read_text("utf-8").split() if file.exists() else []
        tls = self._results / "tls"
        files = [f"--tls-ca={tls}/authority.pem", f"--tls-cert={tls}/certificate.pem", f"--tls-key={tls}/key.key"]
        return bool(lines) and job.is_under_way(self._machine, self._cores, lines[-1], *files)

    def _wait_for_end(self, number: str) -> str:
        """Return what a job printed when it has ended; raises FailedError unless it completed."""

        def state() -> str:
            return "".join(re.findall(r"JobState=(\w+)", self._slurm("scontrol", "show", "job", number)))

        wait_until(f"job {number} ended", lambda: state() not in ("PENDING", "RUNNING", "COMPLETING"), job.LIMIT_S)
        said = (self._folder / f"{number}.out").read_text("utf-8")
        if state() != "COMPLETED":
            raise FailedError(f"job {number} of Slurm is {state()}:\n{said[-2000:]}")
        return said
