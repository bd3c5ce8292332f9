"""The units of deploy/systemd, under a systemd in namespaces of its own or, where that cannot be, verified."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.image import Container, require_image
from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError, find_program, free_port, wait_until

UNITS = ROOT / "deploy" / "systemd"
COORDINATOR, WORKERS = "atoll-coordinator.service", "atoll-island-worker@lab.service"


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
        wait_until("workers compute", lambda: job.is_under_way(self._machine, cores, self._address), job.LIMIT_S)
        before = job.computing(self._machine, self._address)
        self._systemctl("kill", "--signal=KILL", WORKERS)
        wait_until(
            "systemd started the workers again",
            lambda: len(now := job.computing(self._machine, self._address)) == cores and not {*now} & {*before},
        )
        if submitting.wait(job.LIMIT_S) != 0:
            raise FailedError(f"coordinator submit ended with {submitting.returncode}; see {self._machine.logs}")
        job.check_digest(self._machine, job.digest_of(out / "result.json"))
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
