"""``coordinator run --stochastic``: real processes, real kernels."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

LIMIT_S = 200


@pytest.mark.timeout(LIMIT_S + 50)
def test_drift_and_diffusion_are_found_with_intervals_an_ensemble_and_a_density(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    decay, rows = np.exp(-0.1), [2.0]
    spread = 0.5 * np.sqrt((1.0 - decay * decay) / 2.0)
    for each in random.standard_normal(1500):
        rows.append(1.0 + decay * (rows[-1] - 1.0) + spread * each)
    lines = [f"{0.1 * number:.1f},{value:.9g}" for number, value in enumerate(rows)]
    (tmp_path / "data.csv").write_text("\n".join(["t,x", *lines]) + "\n")
    words = [sys.executable, "-m", "atoll_coordinator", "run", "data.csv", "--stochastic", "--workers", "1",
             "--islands", "1", "--operators", "+,-,*", "--max-epochs", "2", "--out", "out"]  # fmt: skip
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    assert "stationary density of x: " in done.stdout
    assert "ensemble: " in done.stdout
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    drift, diffusion = result["equations"]
    assert (drift["lhs"], diffusion["lhs"]) == ("dx/dt", "d[x]/dt")
    assert (drift["verdict"], diffusion["verdict"]) == ("good", "good")
    assert drift["complexity"] <= 5, drift["expression"]
    (variance,) = diffusion["constants"]
    assert variance["interval"][0] < 0.25 < variance["interval"][1]
    stationary = result["process"]["stationary"]["x"]
    assert abs(stationary["mean"] - 1.0) < 0.15
    assert abs(stationary["sd"] - 0.5 / np.sqrt(2.0)) < 0.06
    assert len(result["process"]["ensemble"]["times"]) == 101
    assert result["process"]["measurement_noise"] == {}
    assert len(result["covariance"]["matrix"]) == len(result["covariance"]["constants"]) >= 2
