"""The first run after an installation: ``python -m benchmarks.operations.first_run WHEEL...``.

Installs each wheel into a fresh environment, with the newest dependencies and no extras, and prints the megabytes of
its site-packages without pip and setuptools. Then runs the example twice with an empty folder of kernels, and prints
the seconds of all processors and the seconds until the result, for the first run and for the second run.
"""

import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

_DATA: Final = Path(__file__).resolve().parents[2] / "examples" / "lotka_volterra.csv"
_SUBREAPER: Final = 36
_NOT_OURS: Final = ("pip", "setuptools", "pkg_resources", "_distutils_hack")


def main(wheels: list[str]) -> None:
    """Measure and print."""
    ctypes.CDLL(None).prctl(
        _SUBREAPER, 1
    )  # workers outlive the command, and their time is counted when they are waited
    for wheel in map(Path, wheels):
        with tempfile.TemporaryDirectory(prefix="atoll-first-") as name:
            folder = Path(name)
            programs = _install(folder / "environment", wheel)
            print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, installed {_megabytes(folder):.0f} MB")
            for which in ("first", "second"):
                processor, wall = _run(programs, folder, which)
                print(f"  {which} run: {processor:.1f} s of processors, {wall:.1f} s until the result", flush=True)


def _install(folder: Path, wheel: Path) -> Path:
    """Return the folder of the programs of a fresh environment with the wheel."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([folder / "bin" / "pip", "install", "--quiet", wheel], check=True)
    return folder / "bin"


def _megabytes(folder: Path) -> float:
    """Return the size on disk of everything that was installed, with compiled bytecode."""
    (packages,) = folder.glob("environment/lib/python3*/site-packages")
    kept = [path for path in packages.iterdir() if not path.name.startswith(_NOT_OURS)]
    files = [file for path in kept for file in (path.rglob("*") if path.is_dir() else [path])]
    return sum(file.stat().st_blocks * 512 for file in files) / 2**20


def _run(programs: Path, folder: Path, which: str) -> tuple[float, float]:
    """Run the example; return the processor seconds of all processes, and the seconds of the job."""
    environment = {**os.environ, "ATOLL_KERNEL_CACHE": str(folder / "kernels")}
    out = folder / which
    command = [str(programs / "coordinator"), "run", str(_DATA), "--workers", "2", "--out", str(out)]
    before, begun = os.times(), time.monotonic()
    subprocess.run(command, check=True, cwd=folder, env=environment, capture_output=True)
    wall = time.monotonic() - begun
    while True:
        try:
            os.wait()  # the processes that the command left behind
        except ChildProcessError:
            break
    after = os.times()
    assert json.loads((out / "result.json").read_text("utf-8"))["equations"]
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return used, wall


if __name__ == "__main__":
    main(sys.argv[1:])
