"""The job on containers of the image and on systemd's units; workers are killed meanwhile."""

import contextlib
import os
import re
import shutil
import subprocess
import urllib.request
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
