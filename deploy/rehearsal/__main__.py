"""The command line of the rehearsal: ``python -m deploy.rehearsal [STEP...]``."""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from deploy.rehearsal.adapting import rehearse_adapt, rehearse_sge
from deploy.rehearsal.image import build_image, remove_containers
from deploy.rehearsal.machine import FailedError, Machine, NotPossibleError
from deploy.rehearsal.manifests import check_compose, check_kubernetes
from deploy.rehearsal.mistakes import rehearse_mistakes
from deploy.rehearsal.scripts import rehearse_mpirun, rehearse_slurm
from deploy.rehearsal.services import rehearse_containers, rehearse_systemd

SERVICES = ("containers", "slurm", "adapt", "sge", "systemd")
"""Steps whose services are ended with them."""
STEPS: dict[str, Callable[[Machine], str]] = {
    "compose": check_compose,
    "kubernetes": check_kubernetes,
    "mistakes": rehearse_mistakes,
    "image": build_image,
    "containers": rehearse_containers,
    "slurm": rehearse_slurm,
    "mpirun": rehearse_mpirun,
    "adapt": rehearse_adapt,
    "sge": rehearse_sge,
    "systemd": rehearse_systemd,
}


def main(arguments: list[str]) -> int:
    """Run the steps that are asked for; return 1 if one failed."""
    parser = argparse.ArgumentParser(prog="python -m deploy.rehearsal", description=__doc__)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=f"of {', '.join(STEPS)} (default: all)")
    parser.add_argument("--install", action="store_true", help="install what is missing: Debian packages, as root; "
                        "Python tools, into the folder of --work")  # fmt: skip
    parser.add_argument("--work", type=Path, help="a folder that stays, with image, tools and logs, so that the next "
                        "rehearsal is shorter (default: one that is deleted)")  # fmt: skip
    parser.add_argument("--base", help="base image, such as python:3.12-slim (default: Debian, made by debootstrap)")
    parser.add_argument("--kernels", default="generic", help='kinds of processor to compile for (default: "generic"; '
                        '"" for all)')  # fmt: skip
    options = parser.parse_args(arguments)
    unknown = [name for name in options.steps if name not in STEPS]
    if unknown:
        print(f"unknown step {unknown[0]}; there are {', '.join(STEPS)}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    os.environ["PATH"] += ":/usr/sbin:/sbin"  # where programs are that only root usually has on the path
    with tempfile.TemporaryDirectory(prefix="atoll-rehearsal-", ignore_cleanup_errors=True) as folder:
        work = (options.work or Path(folder)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        machine = Machine(work, options.install, options.base, options.kernels)
        try:
            verdicts = [_run_step(machine, name) for name in options.steps or STEPS]
        finally:
            mounts = [line.split()[1] for line in Path("/proc/mounts").read_text("utf-8").splitlines()]
            for mount in reversed([each for each in mounts if each.startswith(f"{work}/")]):
                machine.run("umount", mount, check=False)  # what buildah keeps mounted
    return 1 if "failed" in verdicts else 0


def _run_step(machine: Machine, name: str) -> str:
    """Run a step, print its line and return its first word."""
    begin = time.monotonic()
    try:
        verdict, text = "passed", STEPS[name](machine)
    except NotPossibleError as reason:
        verdict, text = "not possible here", str(reason)
    except (FailedError, OSError, subprocess.SubprocessError) as problem:
        verdict, text = "failed", str(problem)
    finally:
        left = machine.end_all()
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            remove_containers(machine)
    if verdict == "passed" and left and name not in SERVICES:
        verdict, text = "failed", f"{left} processes were left behind"
    print(f"{name:10} {verdict}: {text} ({time.monotonic() - begin:.0f} s)", flush=True)
    return verdict


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
