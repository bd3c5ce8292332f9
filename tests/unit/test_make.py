"""The commands that a newcomer types first."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def make(*words: str) -> subprocess.CompletedProcess[str]:
    """Run make, which need not look for an interpreter."""
    python = f"PYTHON={sys.executable}"
    return subprocess.run(["make", *words, python], cwd=ROOT, capture_output=True, text=True, check=False)


@needs_make
@pytest.mark.parametrize("target", ["demo", "test", "test-all", "check", "bench"])
def test_every_target_is_explained_and_prepares_the_environment(target: str) -> None:
    assert f"make {target} " in make("help").stdout
    plan = make("--dry-run", "--always-make", target)
    assert plan.returncode == 0, plan.stderr
    assert "pip install" in plan.stdout
    assert ".venv/bin/" in plan.stdout


@needs_make
def test_an_old_interpreter_is_refused_with_advice(tmp_path: Path) -> None:
    """With a Python that says it is too old, in a copy without an environment."""
    old = tmp_path / "python3"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    for name in ("Makefile", "pyproject.toml", "requirements-dev.txt"):
        shutil.copy(ROOT / name, tmp_path)
    done = subprocess.run(["make", "demo", f"PYTHON={old}"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "Atoll needs Python 3.11 or newer" in done.stdout
    assert not (tmp_path / ".venv").exists()
