"""The scripts of deploy/slurm: the job by sbatch, by one srun and by mpirun."""

import os
import re
import subprocess
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, wait_until
from deploy.rehearsal.slurm import Slurm, start_slurm

TOGETHER = f"{ROOT}/deploy/slurm/together"


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


def rehearse_mpirun(machine: Machine) -> str:
    """Run coordinator and workers as two tasks of mpirun, kill a task, and go on; return what was done."""
    machine.need({"mpirun": "openmpi-bin"})
    if "Open MPI" not in (version := machine.run("mpirun", "--version").stdout):
        raise NotPossibleError(f"this mpirun is not that of Open MPI: {version.strip()}")
    results = machine.work / f"mpirun-{machine.id}"
    path = f"PATH={Path(job.PROGRAM).parent}:{os.environ['PATH']}"
    root = ("--allow-run-as-root",) if os.geteuid() == 0 else ()
    words = ("env", path, f"ATOLL_DIR={results}", "mpirun", *root, "--oversubscribe", "-n", "2", TOGETHER)

    def start() -> "tuple[subprocess.Popen[bytes], int]":
        before = {*results.glob("address-*")}
        started = machine.start("mpirun", *words, str(job.DATA), *job.OPTIONS)
        wait_until("a coordinator has an address", lambda: bool({*results.glob("address-*")} - before))
        (address,) = {*results.glob("address-*")} - before
        return started, _wait_for_tasks(machine, results, address)

    killed, _ = start()
    machine.kill("OMPI_COMM_WORLD_RANK=1")
    wait_until("mpirun ended after the loss of a task", lambda: killed.poll() is not None)
    wait_until("no process of a task is left", lambda: not machine.processes("", "OMPI_COMM_WORLD_RANK=0"))
    if (results / "result").exists():
        raise FailedError("the job whose task was killed has a result already")
    started, at_first = start()
    if started.wait(job.LIMIT_S) != 0:
        raise FailedError(f"mpirun ended with {started.returncode}; see {machine.logs}")
    _check_continued(at_first)
    job.check_digest(machine, results / "result")
    return f"two tasks of mpirun, one killed, started again at epoch {at_first}, digest equal to the checkout's"


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
        return started, _wait_for_tasks(machine, results, address)

    cancelled, _ = start()
    slurm("scancel", *slurm.jobs())  # signals all processes, as when the time limit is reached
    wait_until("srun and its job ended after scancel", lambda: cancelled.poll() is not None and not slurm.jobs())
    if (results / "result").exists():
        raise FailedError("the job that was cancelled has a result already")
    started, at_first = start()
    _check_continued(at_first)
    machine.kill("SLURM_PROCID=1")
    started.wait(job.LIMIT_S)
    job.check_digest(machine, results / "result")
    wait_until("no process of a task is left", lambda: not machine.processes("", "SLURM_PROCID=0"))
    return (
        f"two tasks of one srun, cancelled and started again at epoch {at_first}, the second task killed, digest equal "
        f"to the checkout's, exit code of srun {started.returncode}"
    )


def _wait_for_tasks(machine: Machine, results: Path, address: Path) -> int:
    """Wait until the workers of two tasks compute; return the epoch that the store had at first."""
    wait_until("a coordinator has an address", lambda: address.exists() and bool(address.read_text("utf-8")))
    names = {"ca": "authority", "cert": "certificate", "key": "key"}
    certificates = (f"--tls-{key}={results}/tls/me/{name}.pem" for key, name in names.items())
    where = (address.read_text("utf-8").split()[0], *certificates)
    views = job.ask(machine, "jobs", *where)
    at_first = min((each["epoch"] for view in views for each in view["variables"]), default=0)
    job.wait_until_under_way(machine, 2, *where)
    return at_first


def _check_continued(at_first: int) -> None:
    """Raise FailedError if a job that was started again had lost its checkpoint."""
    if at_first < job.EARLY // 2:
        raise FailedError(f"the job did not go on from its checkpoint, but from epoch {at_first}")
