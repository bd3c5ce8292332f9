"""The image: built with buildah, which needs no daemon; containers of it are processes of this machine."""

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from deploy.rehearsal.machine import MARK, ROOT, Machine, NotPossibleError, command_line, wait_until

COPIED = (
    *("pyproject.toml", "README.md", "LICENSE", "common", "coordinator", "island_worker"),
    *("deploy/Dockerfile", "deploy/entrypoint.sh"),
)
"""What an image is made of: the files that the Dockerfile copies, and itself."""
BASE = "localhost/debian-python"
SUITE = "bookworm"
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
_PIP_SETTINGS = ("index-url", "extra-index-url", "trusted-host", "proxy", "timeout")


def build_image(machine: Machine) -> str:
    """Build deploy/Dockerfile; return what was done."""
    require_buildah(machine)
    base = machine.base or _make_base(machine)
    arguments = [f"--build-arg=BASE={base}", f"--build-arg=KERNELS={machine.kernels}"]
    mounts = [f"--volume={settings}:{place}:ro" for settings, place in _pip_settings(machine).items()]
    buildah(
        machine, "bud", "--isolation", "chroot", "--format", "docker", *arguments, *mounts,
        "--file", str(ROOT / "deploy" / "Dockerfile"), "--tag", image_name(machine), str(ROOT), timeout=3600,
    )  # fmt: skip
    kinds = machine.kernels or "all kinds of processor"
    return f"deploy/Dockerfile builds on {base}, with kernels for {kinds}"


def image_name(machine: Machine) -> str:
    """Return the name of the image, in which the sources, the base and the kernels have their part."""
    files = [file for name in COPIED for file in (ROOT / name, *(ROOT / name).rglob("*")) if file.is_file()]
    digest = hashlib.sha256(f"{machine.base} {machine.kernels}".encode())
    for file in sorted(file for file in files if "__pycache__" not in file.parts):
        digest.update(f"{file.relative_to(ROOT)}\n".encode() + file.read_bytes())
    return f"localhost/atoll-rehearsal:{digest.hexdigest()[:16]}"


def has_image(machine: Machine, name: str) -> bool:
    return buildah(machine, "inspect", "--type", "image", name, check=False).returncode == 0


def require_image(machine: Machine) -> None:
    """Build the image unless it is there; raises NotPossibleError."""
    require_buildah(machine)
    if not has_image(machine, image_name(machine)):
        build_image(machine)


def require_buildah(machine: Machine) -> None:
    if os.geteuid() != 0:
        raise NotPossibleError("buildah with chroot isolation needs root")
    machine.need({"buildah": "buildah"})


def buildah(
    machine: Machine, *words: str, timeout: float = 300, check: bool = True
) -> subprocess.CompletedProcess[str]:
    """Run buildah on a store of images of our own."""
    return machine.run(*_buildah(machine), *words, timeout=timeout, check=check, environment={"TMPDIR": _tmp(machine)})


def _buildah(machine: Machine) -> tuple[str, ...]:
    return ("buildah", "--root", str(machine.work / "images"), "--runroot", str(machine.work / "images-run"))


def _tmp(machine: Machine) -> str:
    folder = machine.work / "tmp"
    folder.mkdir(exist_ok=True)
    return str(folder)


def _make_base(machine: Machine) -> str:
    """Make an image of Debian with its Python and return its name; no registry of images is needed."""
    if has_image(machine, BASE):
        return BASE
    machine.need({"debootstrap": "debootstrap"})
    folder = machine.work / "base"
    if not (folder / "etc" / "pip.conf").exists():
        packages = "ca-certificates,python3,python3-venv"
        machine.run("debootstrap", "--variant=minbase", f"--include={packages}", SUITE, str(folder), timeout=1800)
        (folder / "etc" / "pip.conf").touch()
    container = buildah(machine, "from", "scratch").stdout.strip()
    buildah(machine, "add", "--quiet", container, str(folder), "/")
    buildah(machine, "commit", "--quiet", "--rm", container, BASE)
    machine.run("rm", "-rf", str(folder))
    return BASE


def _pip_settings(machine: Machine) -> dict[str, str]:
    """Return which files of this machine are mounted where during the build, so that pip finds its index as here.

    None of it becomes part of the image.
    """
    listed = machine.run(sys.executable, "-m", "pip", "config", "list").stdout
    settings = dict(re.findall(r"^[^.\n]*\.([\w-]+)='(.*)'$", listed, re.MULTILINE))
    lines = [
        f"{name} = {settings[name]}" for name in _PIP_SETTINGS if name in settings and "file:" not in settings[name]
    ]
    mounts = {}
    if Path(CERTIFICATES).exists():
        mounts[CERTIFICATES] = CERTIFICATES
        lines.append(f"cert = {CERTIFICATES}")
    file = machine.work / "pip.conf"
    file.write_text("\n".join(["[global]", *lines, ""]), "utf-8")
    return {**mounts, str(file): "/etc/pip.conf"}


class Container:
    """One container of the image, started, asked and ended as a container engine does it."""

    def __init__(self, machine: Machine, name: str, *, hosts: tuple[str, ...] = ()) -> None:
        self._machine, self.name, self._full_name = machine, name, f"{machine.id}-{name}"
        self._tmp = {"TMPDIR": _tmp(machine)}
        names = [f"--add-host={host}:127.0.0.1" for host in hosts]
        image = image_name(machine)
        buildah(machine, "from", "--pull-never", "--name", self._full_name, *names, image)
        config = json.loads(buildah(machine, "inspect", "--type", "image", image).stdout)["Docker"]["config"]
        self._entrypoint: list[str] = config["Entrypoint"]

    def start(
        self, command: list[str], *, environment: Mapping[str, str], volumes: Mapping[Path, str]
    ) -> subprocess.Popen[bytes]:
        """Start a command behind the image's entry point, without capabilities."""
        words = self._run(environment, volumes)
        return self._machine.start(self.name, *words, "--", *self._entrypoint, *command, environment=self._tmp)

    def execute(self, command: list[str], *, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        """Run a command beside the entry point, as a health check is run."""
        return self._machine.run(*self._run(environment, {}), "--", *command, check=False, environment=self._tmp)

    def _run(self, environment: Mapping[str, str], volumes: Mapping[Path, str]) -> list[str]:
        words = [*_buildah(self._machine), "run", "--isolation", "chroot", "--cap-drop", "ALL"]
        words += [f"--env={key}={value}" for key, value in environment.items()]
        words += [f"--env={MARK}={self._machine.mark(self.name)}"]
        return [*words, *(f"--volume={outside}:{inside}" for outside, inside in volumes.items()), self._full_name]

    def _inside(self) -> list[int]:
        """Return the container's own processes, without those of buildah."""
        pids = self._machine.processes(self.name)
        return [pid for pid in pids if (words := command_line(pid)) and not words[0].startswith("buildah")]

    def stop(self) -> None:
        """Send SIGTERM to the first process, as ``docker stop`` does."""
        for pid in self._inside():
            if "tini" in command_line(pid)[0]:
                os.kill(pid, signal.SIGTERM)

    def kill(self) -> int:
        """Send SIGKILL to all processes, as a lost machine would; return how many there were."""
        pids = self._inside()
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        wait_until(f"{self.name} ended after SIGKILL", lambda: not self._inside(), 30)
        return len(pids)

    def root(self) -> Path:
        """Mount the container's files and return where."""
        return Path(buildah(self._machine, "mount", self._full_name).stdout.strip())

    def remove(self) -> None:
        buildah(self._machine, "umount", self._full_name, check=False)
        buildah(self._machine, "rm", self._full_name, check=False)
