"""The job on what deploy/ starts, struck meanwhile: containers of the image, a Slurm of one node, systemd's units."""

import os
import re
import shutil
import socket
import subprocess
from pathlib import Path
from typing import Any

import yaml

from deploy.rehearsal import job
from deploy.rehearsal.image import Container, require_image
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, find_program, free_port, wait_until

ATOLL_USER = 10001
PORT = 7447
UNITS = ROOT / "deploy" / "systemd"
COORDINATOR, WORKERS = "atoll-coordinator.service", "atoll-island-worker@lab.service"
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
    site = _Site(machine)
    try:
        return site.rehearse()
    finally:
        machine.end_all()
        for container in site.containers:
            container.remove()


class _Site:
    """The services of docker-compose.yml, on a port that is free here."""

    def __init__(self, machine: Machine) -> None:
        self._machine, port = machine, free_port()
        self._address = f"tcp/127.0.0.1:{port}"
        text = (ROOT / "docker-compose.yml").read_text("utf-8")
        self._services: dict[str, dict[str, Any]] = yaml.safe_load(text.replace(str(PORT), str(port)))["services"]
        self.containers: list[Container] = []

    def rehearse(self) -> str:
        machine, where = self._machine, self._address
        state, data = _folder(machine.work / "state"), _folder(machine.work / "data")
        shutil.copy(job.DATA, data)
        coordinator, serving = self._start("coordinator", "coordinator", {state: "/state"})
        check = self._services["coordinator"]["healthcheck"]["test"][1:]
        environment = self._services["coordinator"]["environment"]
        wait_until(
            f"the health check `{' '.join(check)}` succeeds",
            lambda: coordinator.execute(check, environment=environment).returncode == 0,
        )
        first, _ = self._start("worker", "worker-1")
        second, finishing = self._start("worker", "worker-2")
        command = ["coordinator", "submit", f"/data/{job.DATA.name}", *job.OPTIONS, "--out", "/data/out"]
        _, submitting = self._start("worker", "client", {data: "/data"}, command)
        before = job.wait_until_under_way(machine, 2, where)
        killed = first.kill()
        third, added = self._start("worker", "worker-3")
        wait_until(
            "the added worker computes",
            lambda: len(now := job.computing(machine, where)) == 2 and {*now} != {*before}, job.LIMIT_S,
        )  # fmt: skip
        job.check_submitted(machine, submitting, data / "out")
        (told,) = job.ask(machine, "jobs", where)
        for container, process in ((second, finishing), (third, added), (coordinator, serving)):
            container.stop()
            _expect_end(container.name, process)
        lost, expected = told["counters"]["deaths"], len(told["variables"])
        if lost != expected:
            raise FailedError(f"{lost} losses of a worker were counted, but {expected} expected: 1 for each variable")
        return f"worker with {killed} processes killed, another added, digest equal to the checkout's"

    def _start(
        self, service: str, name: str, volumes: dict[Path, str] | None = None, command: list[str] | None = None
    ) -> tuple[Container, subprocess.Popen[bytes]]:
        """Start a service's command, or another in its environment, in a container of its own."""
        described = self._services[service]
        container = Container(self._machine, name, hosts=("coordinator",))
        self.containers.append(container)
        words = command or described["command"]
        return container, container.start(words, environment=described["environment"], volumes=volumes or {})


def _folder(folder: Path) -> Path:
    """Make an empty folder that the image's user may write."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    os.chown(folder, ATOLL_USER, ATOLL_USER)
    return folder


def _expect_end(name: str, process: subprocess.Popen[bytes]) -> None:
    """Wait for a container after SIGTERM; raises FailedError unless it ends with 0."""
    try:
        code = process.wait(60)
    except subprocess.TimeoutExpired:
        raise FailedError(f"{name} did not end within 60 s of SIGTERM") from None
    if code != 0:
        raise FailedError(f"{name} ended with {code} after SIGTERM, but 0 was expected")


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
        done = f"atoll.sbatch on {self._cores} cores cut off, submitted again and finished"
        return f"{done}, digest equal to the checkout's"

    def _start_daemons(self) -> None:
        folder, host = self._folder, socket.gethostname().split(".")[0]
        (folder / "munge.key").write_bytes(os.urandom(1024))
        (folder / "munge.key").chmod(0o600)
        places = {"folder": folder, "host": host, "controller_port": free_port(), "node_port": free_port()}
        (folder / "slurm.conf").write_text(SETTINGS.format(**places, cores=self._cores), "utf-8")
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


def rehearse_systemd(machine: Machine) -> str:
    """Boot the image with the units, kill the workers and stop everything; return what was done."""
    try:
        require_image(machine)
        machine.need({"systemd-nspawn": "systemd-container", "nsenter": "util-linux"})
    except NotPossibleError as reason:
        return f"{_verify(machine)}; not started, since {reason}"
    box = _Box(machine)
    try:
        return box.rehearse()
    finally:
        machine.end_all()
        box.container.remove()


def _verify(machine: Machine) -> str:
    if not find_program("systemd-analyze"):
        raise NotPossibleError("neither systemd-nspawn nor systemd-analyze is here")
    folder = machine.work / "units"
    folder.mkdir(exist_ok=True)
    for file in UNITS.iterdir():
        (folder / file.name).write_text(re.sub(r"/opt/atoll/bin/\S+", "/bin/true", file.read_text("utf-8")), "utf-8")
    for unit in (COORDINATOR, WORKERS):
        said = machine.run("systemd-analyze", "verify", str(folder / unit)).stderr
        if str(folder) in said:
            raise FailedError(said.strip())
    return "units verified by systemd-analyze"


class _Box:
    """The image with a systemd of its own, which shares this machine's network."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._address = f"tcp/127.0.0.1:{free_port()}"
        self.container = Container(machine, "systemd")
        self._booted: subprocess.Popen[bytes] | None = None

    def rehearse(self) -> str:
        root = self.container.root()
        self._prepare(root)
        self._boot(root)
        wait_until("the coordinator's unit answers", self._answers)
        out = self._machine.work / f"systemd-{self._machine.id}"
        submitting = self._machine.start(
            "systemd-client", job.program("coordinator"), "submit", str(job.DATA), *job.OPTIONS,
            "--connect", self._address, "--out", str(out),
        )  # fmt: skip
        cores = len(os.sched_getaffinity(0))
        before = job.wait_until_under_way(self._machine, cores, self._address)
        self._systemctl("kill", "--signal=KILL", WORKERS)
        wait_until(
            "systemd started the workers again",
            lambda: len(now := job.computing(self._machine, self._address)) == cores and not {*now} & {*before},
        )
        job.check_submitted(self._machine, submitting, out)
        for unit in (WORKERS, COORDINATOR):
            self._systemctl("stop", unit)
            self._expect(unit, "Result", "success")
        self._systemctl("poweroff")
        assert self._booted is not None
        self._booted.wait(60)
        return "both units started, workers killed and started again, digest equal to the checkout's, units stopped"

    def _prepare(self, root: Path) -> None:
        """Install systemd, the units and their settings into the files of the container."""
        packages = "systemd systemd-sysv dbus"
        self._chroot(root, f"apt-get update && apt-get install --yes --no-install-recommends {packages}")
        for file in UNITS.iterdir():
            shutil.copy(file, root / "etc" / "systemd" / "system")
        settings = root / "etc" / "atoll"
        settings.mkdir(exist_ok=True)
        kind = (root / "var" / "cache" / "atoll" / "kinds").read_text("utf-8").split()[0]
        kernels = f"NUMBA_CPU_NAME={kind}\nNUMBA_CPU_FEATURES=\n"
        (settings / "coordinator.env").write_text(f"ATOLL_LISTEN={self._address}\n{kernels}", "utf-8")
        (settings / "lab.env").write_text(f"ATOLL_CONNECT={self._address}\n{kernels}", "utf-8")
        self._chroot(root, f"systemctl enable {COORDINATOR} {WORKERS}")

    def _chroot(self, root: Path, script: str) -> None:
        """Run a script as root inside; systemd-nspawn gives it /proc, /dev and the names of hosts."""
        self._machine.run(
            *self._nspawn(root), "--pipe", "sh", "-c", script,
            environment={"DEBIAN_FRONTEND": "noninteractive"}, timeout=600,
        )  # fmt: skip

    def _nspawn(self, root: Path) -> tuple[str, ...]:
        options = ("--quiet", "--register=no", "--keep-unit", f"--machine=atoll-{self._machine.id}")
        return ("systemd-nspawn", f"--directory={root}", *options)

    def _boot(self, root: Path) -> None:
        self._booted = self._machine.start("systemd", *self._nspawn(root), "--boot", "--console=pipe")
        wait_until("systemd is up", self._is_up)

    def _is_up(self) -> bool:
        assert self._booted is not None
        if self._booted.poll() is not None:
            raise FailedError(f"systemd-nspawn ended with {self._booted.returncode}; see {self._machine.logs}")
        return bool(self._leader()) and self._systemctl("is-system-running", check=False) in ("running", "degraded")

    def _leader(self) -> str:
        """Return the number of the systemd inside, as this machine sees it."""
        assert self._booted is not None
        pid = self._booted.pid
        file = Path(f"/proc/{pid}/task/{pid}/children")
        return file.read_text("utf-8").split()[0] if file.exists() and file.read_text("utf-8").strip() else ""

    def _systemctl(self, *words: str, check: bool = True) -> str:
        enter = ("nsenter", "--target", self._leader(), "--mount", "--uts", "--ipc", "--pid", "--root")
        return self._machine.run(*enter, "systemctl", *words, check=check).stdout.strip()

    def _answers(self) -> bool:
        done = self._machine.run(job.program("coordinator"), "ping", "--connect", self._address, check=False)
        return done.returncode == 0

    def _expect(self, unit: str, name: str, expected: str) -> None:
        found = self._systemctl("show", "--value", f"--property={name}", unit)
        if found != expected:
            raise FailedError(f"{unit} has {name}={found}, but {expected} was expected")
