"""docker-compose.yml by hand: its commands and environments in containers of the image, one of which is killed."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import yaml

from deploy.rehearsal import job
from deploy.rehearsal.image import Container, require_image
from deploy.rehearsal.machine import ROOT, FailedError, Machine, free_port, wait_until

ATOLL_USER = 10001
PORT = 7447


def rehearse_containers(machine: Machine) -> str:
    """Run the job on a coordinator and two workers, kill one and add another; return what was done."""
    require_image(machine)
    site = _Site(machine)
    try:
        return site.rehearse()
    finally:
        machine.end_all()
        for each in site.containers:
            each.remove()


class _Site:
    """The services of docker-compose.yml, on a port that is free here."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._port = free_port()
        self._address = f"tcp/127.0.0.1:{self._port}"
        text = (ROOT / "docker-compose.yml").read_text("utf-8")
        self._services = yaml.safe_load(text.replace(str(PORT), str(self._port)))["services"]
        self.containers: list[Container] = []
        self._state = _folder(machine.work / "state")
        self._data = _folder(machine.work / "data")
        shutil.copy(job.DATA, self._data)

    def rehearse(self) -> str:
        coordinator, serving = self._start("coordinator", "coordinator", {self._state: "/state"})
        check = self._services["coordinator"]["healthcheck"]["test"][1:]
        environment = self._services["coordinator"]["environment"]
        wait_until(
            f"the health check `{' '.join(check)}` succeeds",
            lambda: coordinator.execute(check, environment=environment).returncode == 0,
        )
        first, _ = self._start("worker", "worker-1")
        second, finishing = self._start("worker", "worker-2")
        submitting = self._submit()
        wait_until("both workers compute", lambda: job.is_under_way(self._machine, 2, self._address), job.LIMIT_S)
        before = job.computing(self._machine, self._address)
        killed = first.kill()
        third, added = self._start("worker", "worker-3")
        wait_until("the added worker computes", lambda: self._has_replaced(before), job.LIMIT_S)
        if submitting.wait(job.LIMIT_S) != 0:
            raise FailedError(f"coordinator submit ended with {submitting.returncode}; see {self._machine.logs}")
        (told,) = job.ask(self._machine, "jobs", self._address)
        job.check_digest(self._machine, job.digest_of(self._data / "out" / "result.json"))
        for container, process in ((second, finishing), (third, added), (coordinator, serving)):
            container.stop()
            _expect_end(container.name, process)
        lost, expected = told["counters"]["deaths"], len(told["variables"])
        if lost != expected:
            raise FailedError(
                f"{lost} losses of a worker were counted, but {expected} were expected: 1 for each variable"
            )
        return f"worker with {killed} processes killed, another added, digest equal to the checkout's"

    def _start(
        self, service: str, name: str, volumes: dict[Path, str] | None = None
    ) -> tuple[Container, subprocess.Popen[bytes]]:
        its: dict[str, Any] = self._services[service]
        container = Container(self._machine, name, hosts=("coordinator",))
        self.containers.append(container)
        return container, container.start(its["command"], environment=its["environment"], volumes=volumes or {})

    def _submit(self) -> subprocess.Popen[bytes]:
        container = Container(self._machine, "client", hosts=("coordinator",))
        self.containers.append(container)
        command = ["coordinator", "submit", f"/data/{job.DATA.name}", *job.OPTIONS, "--out", "/data/out"]
        environment = self._services["worker"]["environment"]
        return container.start(command, environment=environment, volumes={self._data: "/data"})

    def _has_replaced(self, before: list[str]) -> bool:
        now = job.computing(self._machine, self._address)
        return len(now) == 2 and set(now) != set(before)


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
