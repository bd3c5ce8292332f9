"""The same file and seed give the same bits, whatever the processor, numpy's own choices and the order of hashes.

That is: of the prepared data, of the laws by regression that end searches among few variables, of the search, and of
refining, whose linear algebra uses the kernels that all processors of a kind have (docs/reproducibility.md).
"""

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

from atoll_core.machine import use_common_instructions
from tests import kernels

ROOT = Path(__file__).resolve().parents[2]
Answer = dict[str, Any]


@pytest.fixture(scope="module", params=["clean", pytest.param("noisy", marks=pytest.mark.slow)])
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
    use_common_instructions(environment)  # as both programs do
    finished = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.integration.answer", str(path)],
        cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    written: Answer = json.loads(finished.stdout)
    return written


@pytest.fixture(scope="module")
def native(measurements: Path) -> Answer:
    return answer(measurements, PYTHONHASHSEED="0")


@pytest.mark.slow
def test_a_search_found_something(native: Answer) -> None:
    """So that the comparisons below are not of nothing with nothing."""
    assert all(len(front) > 3 for front in native["fronts"])
    assert all(spent["coevolution"] > 0 for spent in native["evaluations"])
    assert all(native["laws"][name] for name in "xy")
    assert all(native["shown"][name] for name in "xy")


def dispatched_features() -> list[str]:
    """Return the optional processor features that this numpy uses on this machine."""
    return list(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_neither_the_order_of_hashes_nor_the_processor_matters(measurements: Path, native: Answer) -> None:
    """All at once: another order, kernels for any processor, and numpy without the features that it uses here.

    OpenBLAS uses the same kernels for all, see tests/unit/common/machine/test_linear_algebra.py.

    The kernels are compiled once per machine, a minute, by ``make test`` before any test.
    """
    features = {"NPY_DISABLE_CPU_FEATURES": " ".join(dispatched_features())} if dispatched_features() else {}
    assert answer(measurements, PYTHONHASHSEED="12345", **features, **kernels.environment()) == native
