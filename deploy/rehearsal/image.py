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

from deploy.rehearsal.machine import MARK, ROOT, FailedError, Machine, NotPossibleError, command_line, wait_until

COPIED = (
    "pyproject.toml hatch_build.py README.md LICENSE common coordinator island_worker "
    "deploy/Dockerfile deploy/entrypoint.sh"
)
"""What an image is made of: the files that the Dockerfile copies, and itself."""
BASE = "localhost/debian-python"
SUITE = "bookworm"
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
PIP_SETTINGS = re.compile(r"^[^.\n]*\.(index-url|extra-index-url|trusted-host|proxy|timeout)='(.*)'$", re.M)


def build_image(machine: Machine) -> str:
    """Build deploy/Dockerfile; return what was done."""
    require_buildah(machine)
    base = machine.base or _make_base(machine)
    arguments = [f"--build-arg=BASE={base}", f"--build-arg=KERNELS={machine.kernels}", *_pip_settings(machine)]
    arguments += [f"--file={ROOT}/deploy/Dockerfile", f"--tag={image_name(machine)}", str(ROOT)]
    buildah(machine, "bud", "--isolation=chroot", "--format=docker", *arguments, timeout=3600)
    kinds = machine.kernels or "all kinds of processor"
    return f"deploy/Dockerfile builds on {base}, with kernels for {kinds}"


def image_name(machine: Machine) -> str:
    """Return the name of the image, in which the sources, the base and the kernels have their part."""
    digest = hashlib.sha256(f"{machine.base} {machine.kernels}".encode())
    for name in COPIED.split():
        for file in sorted([ROOT / name, *(ROOT / name).rglob("*")]):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(ROOT)}\n".encode() + file.read_bytes())
    return f"localhost/atoll-rehearsal:{digest.hexdigest()[:16]}"


def require_image(machine: Machine) -> None:
    """Build the image unless it is there; raises NotPossibleError."""
    require_buildah(machine)
    if not _has_image(machine, image_name(machine)):
        build_image(machine)


def require_buildah(machine: Machine) -> None:
    """Make sure that buildah can be used; raises NotPossibleError."""
    if os.geteuid() != 0:
        raise NotPossibleError("buildah with chroot isolation needs root")
    machine.need({"buildah": "buildah"})


def buildah(
    machine: Machine, *words: str, timeout: float = 300, check: bool = True
) -> subprocess.CompletedProcess[str]:
    """Run buildah on a store of images of our own."""
    return machine.run(*_buildah(machine), *words, timeout=timeout, check=check)


def remove_containers(machine: Machine) -> None:
    """Remove the containers of this rehearsal, whose processes have ended."""
    if (machine.work / "images").exists():
        listed = buildah(machine, "containers", "--format", "{{.ContainerName}}", check=False).stdout.split()
        for name in [name for name in listed if name.startswith(f"{machine.id}-")]:
            buildah(machine, "umount", name, check=False)
            buildah(machine, "rm", name, check=False)


def _buildah(machine: Machine) -> tuple[str, ...]:
    tmp, images = machine.work / "tmp", machine.work / "images"
    tmp.mkdir(exist_ok=True)
    return "env", f"TMPDIR={tmp}", "buildah", f"--root={images}", f"--runroot={images}-run"


def _has_image(machine: Machine, name: str) -> bool:
    return buildah(machine, "inspect", "--type", "image", name, check=False).returncode == 0


def _make_base(machine: Machine) -> str:
    """Make an image of Debian with its Python and return its name; no registry of images is needed."""
    if _has_image(machine, BASE):
        return BASE
    machine.need({"debootstrap": "debootstrap"})
    folder = machine.work / "base"
    machine.run("rm", "-rf", str(folder))
    packages = "ca-certificates,python3,python3-venv"
    machine.run("debootstrap", "--variant=minbase", f"--include={packages}", SUITE, str(folder), timeout=1800)
    (folder / "etc" / "pip.conf").touch()
    container = buildah(machine, "from", "scratch").stdout.strip()
    buildah(machine, "add", "--quiet", container, str(folder), "/")
    buildah(machine, "commit", "--quiet", "--rm", container, BASE)
    machine.run("rm", "-rf", str(folder))
    return BASE


def _pip_settings(machine: Machine) -> list[str]:
    """Return options that mount files during the build, so that pip finds its index as on this machine.

    None of it becomes part of the image.
    """
    listed = PIP_SETTINGS.findall(machine.run(sys.executable, "-m", "pip", "config", "list").stdout)
    settings = {name: value for name, value in dict(listed).items() if "file:" not in value}
    file = machine.work / "pip.conf"
    mounts = [f"--volume={file}:/etc/pip.conf:ro"]
    if Path(CERTIFICATES).exists():
        settings["cert"] = CERTIFICATES
        mounts.append(f"--volume={CERTIFICATES}:{CERTIFICATES}:ro")
    file.write_text("\n".join(["[global]", *(f"{name} = {value}" for name, value in settings.items()), ""]), "utf-8")
    return mounts


class Container:
    """One container of the image, started, asked and ended as a container engine does it."""

    def __init__(self, machine: Machine, name: str) -> None:
        self._machine, self._name, self._full_name = machine, name, f"{machine.id}-{name}"
        names = (f"--name={self._full_name}", "--add-host=coordinator:127.0.0.1")
        buildah(machine, "from", "--pull-never", *names, image_name(machine))

    def start(
        self, command: list[str], environment: Mapping[str, str], volumes: Mapping[str, Path]
    ) -> subprocess.Popen[bytes]:
        """Start a command behind the image's entry point, with folders by their places inside."""
        image = buildah(self._machine, "inspect", "--type", "image", image_name(self._machine)).stdout
        entrypoint: list[str] = json.loads(image)["Docker"]["config"]["Entrypoint"]
        mounts = [f"--volume={folder}:{place}" for place, folder in volumes.items()]
        self._process = self._machine.start(self._name, *self.words([*entrypoint, *command], environment, *mounts))
        return self._process

    def words(self, command: list[str], environment: Mapping[str, str], *options: str) -> list[str]:
        """Return the words that run a command inside, without capabilities."""
        marked = {**environment, MARK: self._machine.mark(self._name)}
        options = (*(f"--env={key}={value}" for key, value in marked.items()), *options)
        run = (*_buildah(self._machine), "run", "--isolation=chroot", "--cap-drop=ALL")
        return [*run, *options, self._full_name, "--", *command]

    def _inside(self) -> dict[int, str]:
        """Return the container's own processes with their programs, without those of buildah."""
        programs = {pid: command_line(pid)[:1] for pid in self._machine.processes(self._name)}
        return {pid: words[0] for pid, words in programs.items() if words and not words[0].startswith("buildah")}

    def stop(self) -> None:
        """Send SIGTERM to the first process, as ``docker stop`` does; raises FailedError unless it ends with 0."""
        for pid, program in self._inside().items():
            if "tini" in program:
                os.kill(pid, signal.SIGTERM)
        wait_until(f"{self._name} ended after SIGTERM", lambda: self._process.poll() is not None, 60)
        if code := self._process.returncode:
            raise FailedError(f"{self._name} ended with {code} after SIGTERM, but 0 was expected")

    def kill(self) -> int:
        """Send SIGKILL to all processes, as a lost machine would; return how many there were."""
        pids = self._inside()
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        wait_until(f"{self._name} ended after SIGKILL", lambda: not self._inside(), 30)
        return len(pids)

    def root(self) -> Path:
        """Mount the container's files and return where."""
        return Path(buildah(self._machine, "mount", self._full_name).stdout.strip())
