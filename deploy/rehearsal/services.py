"""The job on what deploy/ starts, struck meanwhile: containers of the image, a Slurm of one node, systemd's units."""

import contextlib
import os
import re
import shutil
import socket
import subprocess
import urllib.request
from dataclasses import dataclass
from pathlib import Path

import yaml

from deploy.rehearsal import job
from deploy.rehearsal.image import Container, require_image
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, free_port, wait_until

ATOLL_USER = 10001
PORT = 7447
PAGE_PORT = 7480
UNITS = ROOT / "deploy" / "systemd"
COORDINATOR, WORKERS, PAGE = "atoll-coordinator.service", "atoll-island-worker@lab.service", "atoll-web.service"
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


def rehearse_containers(machine: Machine) -> str:
    """Run the job on a coordinator and two workers, kill one and add another; return what was done."""
    require_image(machine)
    port = free_port()
    address = f"tcp/127.0.0.1:{port}"
    compose = (ROOT / "docker-compose.yml").read_text("utf-8").replace(str(PORT), str(port))
    services = yaml.safe_load(compose)["services"]

    def start(
        service: str, name: str, command: list[str] | None = None, **volumes: Path
    ) -> tuple[Container, subprocess.Popen[bytes]]:
        """Start a service's command, or another in its environment, in a container of its own."""
        described, container = services[service], Container(machine, name)
        places = {f"/{place}": folder for place, folder in volumes.items()}
        return container, container.start(command or described["command"], described["environment"], places)

    data = _folder(machine.work / "data")
    shutil.copy(job.DATA, data)
    coordinator, _ = start("coordinator", "coordinator", state=_folder(machine.work / "state"))
    check = services["coordinator"]["healthcheck"]["test"][1:]
    checking = coordinator.words(check, services["coordinator"]["environment"])
    wait_until(
        f"the health check `{' '.join(check)}` succeeds", lambda: machine.run(*checking, check=False).returncode == 0
    )
    page, _ = start("page", "page")
    wait_until("the page answers", lambda: _page_answers(PAGE_PORT))
    first, _ = start("worker", "worker-1")
    second, _ = start("worker", "worker-2")
    command = ["coordinator", "submit", f"/data/{job.DATA.name}", *job.OPTIONS, "--out", "/data/out"]
    _, submitting = start("worker", "client", command, data=data)
    before = job.wait_until_under_way(machine, 2, address)
    killed = first.kill()
    third, _ = start("worker", "worker-3")
    wait_until(
        "the added worker computes",
        lambda: len(now := job.computing(machine, address)) == 2 and now != before,
        job.LIMIT_S,
    )
    job.check_submitted(machine, submitting, data / "out")
    (told,) = job.ask(machine, "jobs", address)
    for container in (second, third, page, coordinator):
        container.stop()
    lost, expected = told["counters"]["deaths"], len(told["variables"])
    if lost != expected:
        raise FailedError(f"{lost} losses of a worker were counted, but {expected} expected: 1 for each variable")
    return f"the page answered, worker with {killed} processes killed, another added, digest equal to the checkout's"


def _page_answers(port: int) -> bool:
    """Tell whether the page answers on this machine, with which the containers share their network."""
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/health", timeout=5):
        return True
    return False


def _folder(folder: Path) -> Path:
    """Make an empty folder that the image's user may write."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    os.chown(folder, ATOLL_USER, ATOLL_USER)
    return folder


def rehearse_slurm(machine: Machine) -> str:
    """Submit the job with sbatch, end it as when time runs out, and continue it; return what was done."""
    if os.geteuid() != 0:
        raise NotPossibleError("a node of Slurm runs jobs as their users, which needs root")
    machine.need(PROGRAMS)
    cores = len(os.sched_getaffinity(0))
    folder = machine.work / f"slurm-{machine.id}"
    results, tls = folder / "atoll", folder / "atoll" / "tls"
    slurm = _slurm(machine, folder, cores, ATOLL_DIR=results)

    def submit() -> str:
        options = ("--nodes=1", f"--cpus-per-task={cores}", "--time=60", f"--output={folder}/%j.out")
        return slurm("sbatch", "--parsable", *options, f"{ROOT}/deploy/slurm/atoll.sbatch", str(job.DATA), *job.OPTIONS)

    def wait_for_end(number: str) -> str:
        """Return what a job printed when it has ended; raises FailedError unless it completed."""

        def state() -> str:
            return "".join(re.findall(r"JobState=(\w+)", slurm("scontrol", "show", "job", number)))

        wait_until(f"job {number} ended", lambda: state() not in ("PENDING", "RUNNING", "COMPLETING"), job.LIMIT_S)
        said = (folder / f"{number}.out").read_text("utf-8")
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
    return f"atoll.sbatch on {cores} cores cut off, submitted again and finished, digest equal to the checkout's"


def rehearse_adapt(machine: Machine) -> str:
    """Have ``coordinator adapt`` start workers in jobs of Slurm, kill one and drain them; return what was done."""
    if os.geteuid() != 0:
        raise NotPossibleError("a node of Slurm runs jobs as their users, which needs root")
    machine.need(PROGRAMS)
    folder, cores = machine.work / f"adapt-{machine.id}", len(os.sched_getaffinity(0))
    slurm = _slurm(machine, folder, cores)
    address = f"tcp/127.0.0.1:{free_port()}"

    def running() -> list[str]:
        return slurm("squeue", "--noheader", "--states=RUNNING", "--format=%A").split()

    machine.start("adapt-coordinator", job.PROGRAM, "serve", "--listen", address, "--state", str(folder / "store"))
    ping = (job.PROGRAM, "ping", "--connect", address)
    wait_until("the coordinator answers", lambda: machine.run(*ping, check=False).returncode == 0)
    bounds = ("--minimum", "0", "--maximum", str(cores), "--cores", "1", "--idle", "20s", "--interval", "1s")
    outputs = f"--sbatch=--output={folder}/%j.out --time=60"
    adapting = machine.start("adapt", *slurm.environment, job.PROGRAM, "adapt", "--connect", address, *bounds, outputs)
    submit = (job.PROGRAM, "submit", str(job.DATA), *job.OPTIONS, "--connect", address, "--out", str(folder / "out"))
    submitting = machine.start("adapt-client", *submit)
    before = job.wait_until_under_way(machine, cores, address)
    killed = running()[0]
    slurm("scancel", "--signal=KILL", "--full", killed)  # as when its node is lost
    wait_until(
        "another job of Slurm has taken the place of the one that was killed",
        lambda: len(now := job.computing(machine, address)) == cores and now != before,
        job.LIMIT_S,
    )
    drained = running()
    job.check_submitted(machine, submitting, folder / "out")
    wait_until("all jobs of Slurm have been drained", lambda: not slurm("squeue", "--noheader"), job.LIMIT_S)
    for number in drained:
        said = (folder / f"{number}.out").read_text("utf-8")
        if "this worker ends" not in said:
            raise FailedError(f"job {number} of Slurm was not let go by the coordinator, but said: {said[-2000:]}")
    if adapting.poll() is not None:
        raise FailedError(f"coordinator adapt ended with {adapting.returncode}; see {machine.logs}")
    return (
        f"adapt kept {cores} jobs of Slurm, replaced one that was killed, digest equal to the checkout's, then drained "
        f"all {len(drained)}"
    )


@dataclass(frozen=True)
class _Slurm:
    """A Slurm of one node; calling it runs a program of Slurm and returns what that prints."""

    machine: Machine
    environment: tuple[str, ...]

    def __call__(self, *words: str) -> str:
        return self.machine.run(*self.environment, *words).stdout.strip()


def _slurm(machine: Machine, folder: Path, cores: int, **settings: Path) -> _Slurm:
    """Start a Slurm that keeps its files in `folder`, for programs of the checkout with these settings."""
    path = f"PATH={Path(job.PROGRAM).parent}:{os.environ['PATH']}"
    given = (f"{name}={value}" for name, value in settings.items())
    slurm = _Slurm(machine, ("env", f"SLURM_CONF={folder}/slurm.conf", *given, path))
    _start_slurm(machine, folder, cores, slurm.environment)
    return slurm


def _start_slurm(machine: Machine, folder: Path, cores: int, environment: tuple[str, ...]) -> None:
    """Start the daemons of a Slurm of one node that keeps its files in `folder`."""
    host = socket.gethostname().split(".")[0]
    for each in (folder, folder / "state", folder / "spool"):
        each.mkdir()
    (folder / "munge.key").write_bytes(os.urandom(1024))
    (folder / "munge.key").chmod(0o600)
    places = {"folder": folder, "host": host, "controller_port": free_port(), "node_port": free_port()}
    (folder / "slurm.conf").write_text(SETTINGS.format(**places, cores=cores), "utf-8")
    files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    options = (f"--{key}={folder}/munge.{end}" for key, end in files.items())
    machine.start("munged", "munged", "--foreground", "--force", *options)
    wait_until("munged listens", (folder / "munge.socket").exists)
    machine.start("slurmctld", *environment, "slurmctld", "-D", "-i")
    machine.start("slurmd", *environment, "slurmd", "-D", "-N", host)
    asking = (*environment, "sinfo", "-h", "-o", "%T")
    wait_until("the node is idle", lambda: machine.run(*asking, check=False).stdout.strip() == "idle")


def rehearse_systemd(machine: Machine) -> str:
    """Boot the image with the units, kill the workers and stop everything; return what was done."""
    try:
        require_image(machine)
        machine.need({"systemd-nspawn": "systemd-container", "nsenter": "util-linux"})
    except NotPossibleError as reason:
        return f"{_verify(machine)}; not started, since {reason}"
    address, out = f"tcp/127.0.0.1:{free_port()}", machine.work / f"systemd-{machine.id}"
    booted = _boot(machine, address)

    def systemctl(*words: str, check: bool = True) -> str:
        """Return what systemctl says inside; "" before the systemd there has begun."""
        if booted.poll() is not None:
            raise FailedError(f"systemd-nspawn ended with {booted.returncode}; see {machine.logs}")
        leader = Path(f"/proc/{booted.pid}/task/{booted.pid}/children").read_text("utf-8").split()[:1]
        enter = ("nsenter", *(f"--target={pid}" for pid in leader), "--mount", "--uts", "--ipc", "--pid", "--root")
        return machine.run(*enter, "systemctl", *words, check=check).stdout.strip() if leader else ""

    ping = (job.PROGRAM, "ping", "--connect", address)
    submit = (job.PROGRAM, "submit", str(job.DATA), *job.OPTIONS, "--connect", address, "--out", str(out))
    wait_until("systemd is up", lambda: systemctl("is-system-running", check=False) in ("running", "degraded"))
    wait_until("the coordinator's unit answers", lambda: machine.run(*ping, check=False).returncode == 0)
    submitting = machine.start("systemd-client", *submit)
    cores = len(os.sched_getaffinity(0))
    before = job.wait_until_under_way(machine, cores, address)
    systemctl("kill", "--signal=KILL", WORKERS)
    wait_until(
        "systemd started the workers again",
        lambda: len(now := job.computing(machine, address)) == cores and not now & before,
    )
    job.check_submitted(machine, submitting, out)
    wait_until("the page answers", lambda: _page_answers(PAGE_PORT))
    for unit in (PAGE, WORKERS, COORDINATOR):
        systemctl("stop", unit)
        result = systemctl("show", "--value", "--property=Result", unit)
        if result != "success":
            raise FailedError(f"{unit} has Result={result}, but success was expected")
    systemctl("poweroff")
    booted.wait(60)
    return (
        "all units started, the page answered, workers killed and started again, digest equal to the checkout's, units "
        "stopped"
    )


def _boot(machine: Machine, address: str) -> subprocess.Popen[bytes]:
    """Boot a container of the image with a systemd of its own and the units; it shares this machine's network."""
    root = Container(machine, "systemd").root()
    options = ("--quiet", "--register=no", "--keep-unit", f"--machine=atoll-{machine.id}")
    nspawn = ("systemd-nspawn", f"--directory={root}", *options)
    packages = "systemd systemd-sysv dbus"
    install = f"DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends {packages}"
    machine.run(*nspawn, "--pipe", "sh", "-c", f"apt-get update && {install}", timeout=600)
    shutil.copytree(UNITS, root / "etc" / "systemd" / "system", dirs_exist_ok=True)
    settings = root / "etc" / "atoll"
    settings.mkdir(exist_ok=True)
    kind = (root / "var" / "cache" / "atoll" / "kinds").read_text("utf-8").split()[0]
    for name, variable in (("coordinator", "ATOLL_LISTEN"), ("lab", "ATOLL_CONNECT"), ("web", "ATOLL_CONNECT")):
        text = f"{variable}={address}\nNUMBA_CPU_NAME={kind}\nNUMBA_CPU_FEATURES=\n"
        (settings / f"{name}.env").write_text(text, "utf-8")
    machine.run(*nspawn, "--pipe", "systemctl", "enable", COORDINATOR, WORKERS, PAGE)
    return machine.start("systemd", *nspawn, "--boot", "--console=pipe")


def _verify(machine: Machine) -> str:
    if not shutil.which("systemd-analyze"):
        raise NotPossibleError("neither systemd-nspawn nor systemd-analyze is here")
    folder = machine.work / "units"
    folder.mkdir(exist_ok=True)
    for file in UNITS.iterdir():
        (folder / file.name).write_text(re.sub(r"/opt/atoll/bin/\S+", "/bin/true", file.read_text("utf-8")), "utf-8")
    for unit in (COORDINATOR, WORKERS, PAGE):
        said = machine.run("systemd-analyze", "verify", str(folder / unit)).stderr
        if str(folder) in said:
            raise FailedError(said.strip())
    return "units verified by systemd-analyze"
