"""The checkout's tests against the wheel: ``python -m tests.wheel [options of pytest]``.

Builds the wheel and installs it into a fresh environment beside a foreign package named ``common``, where no source
root is on the path, and runs the tests there.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from deploy.release import FailedError, build_distributions, install_wheel, make_environment, run

ROOT = Path(__file__).resolve().parents[1]
WHERE = "import atoll, atoll_coordinator, atoll_island_worker as worker; print(*atoll.__path__, *worker.__path__)"


def main(words: list[str]) -> int:
    """Run the tests; return pytest's exit code, or 1 if the wheel could not be made or is not what is imported."""
    with tempfile.TemporaryDirectory(prefix="atoll-wheel-") as folder:
        work = Path(folder)
        try:
            python = _installed(work)
        except FailedError as problem:
            sys.stderr.write(f"failed: {problem}\n")
            return 1
        sys.stderr.write(f"testing the wheel installed in {python.parents[1]}\n")
        outside = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
        return subprocess.run([python, "-m", "pytest", *words], cwd=ROOT, env=outside, check=False).returncode


def _installed(work: Path) -> Path:
    """Return the Python of an environment with the wheel and what its tests need."""
    tools = make_environment(work / "tools")
    run(tools / "pip", "install", "--quiet", "build")
    (wheel,) = (file for file in build_distributions(tools, work / "dist") if file.suffix == ".whl")
    python = install_wheel(work, wheel)
    run(python, "-m", "pip", "install", "--quiet", f"{wheel}[dev]")
    places = run(python, "-c", WHERE, cwd=ROOT).split()
    if not all(place.startswith(str(work)) for place in places):
        raise FailedError(f"tests in {ROOT} import {', '.join(places)}, not the wheel")
    return python


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
