"""The same file and seed give the same bits, whatever the processor, numpy's own choices and the order of hashes."""

import json
import math
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import kernels

ROOT = Path(__file__).resolve().parents[2]
Answer = dict[str, Any]


@pytest.fixture(scope="module", params=["clean", "noisy"])
def measurements(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A damped oscillation of two states, exact (interpolated) or with noise (smoothed)."""
    path: Path = tmp_path_factory.mktemp("data") / f"{request.param}.csv"
    noise = 0.05 if request.param == "noisy" else 0.0
    stream = random.Random(1)
    lines = ["t,x,y"]
    for row in range(150):
        t = 0.05 * row
        x, y = (math.exp(-0.1 * t) * f(1.3 * t) + noise * stream.gauss(0.0, 1.0) for f in (math.cos, math.sin))
        lines.append(f"{t!r},{x!r},{y!r}")
    path.write_text("\n".join(lines))
    return path


def answer(path: Path, **environment: str) -> Answer:
    """Return what a fresh process with that environment finds."""
    finished = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.integration.answer", str(path)],
        cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    found: Answer = json.loads(finished.stdout)
    return found


@pytest.fixture(scope="module")
def native(measurements: Path) -> Answer:
    return answer(measurements, PYTHONHASHSEED="0")


def test_a_search_found_something(native: Answer) -> None:
    """So that the comparisons below are not of nothing with nothing."""
    assert all(len(front) > 3 for front in native["fronts"])
    assert all(spent["coevolution"] > 0 for spent in native["evaluations"])


def dispatched_features() -> list[str]:
    """Return the optional processor features that this numpy uses on this machine."""
    return list(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


def test_neither_the_order_of_hashes_nor_features_of_the_processor_that_numpy_uses_matter(
    measurements: Path, native: Answer
) -> None:
    features = {"NPY_DISABLE_CPU_FEATURES": " ".join(dispatched_features())} if dispatched_features() else {}
    assert answer(measurements, PYTHONHASHSEED="12345", **features) == native


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_kernels_compiled_for_any_processor_give_the_same_bits(measurements: Path, native: Answer) -> None:
    """They are compiled once per machine, a minute, by ``make test`` before any test."""
    assert answer(measurements, **kernels.environment()) == native
