"""``coordinator run --stochastic``: real processes, real kernels."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.programs import LIMIT_S, done


@pytest.mark.timeout(LIMIT_S + 50)
@pytest.mark.slow
def test_drift_and_diffusion_are_found_with_intervals_an_ensemble_and_a_density(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    decay, rows = np.exp(-0.1), [2.0]
    spread = 0.5 * np.sqrt((1.0 - decay * decay) / 2.0)
    for shock in random.standard_normal(1500):
        rows.append(1.0 + decay * (rows[-1] - 1.0) + spread * shock)
    lines = [f"{0.1 * number:.1f},{value:.9g}" for number, value in enumerate(rows)]
    (tmp_path / "data.csv").write_text("\n".join(["t,x", *lines]) + "\n")
    options = ["--workers", "1", "--islands", "1", "--operators", "+,-,*", "--out", "out"]
    ended = done(tmp_path, "coordinator", "run", "data.csv", "--stochastic", *options)
    assert ended.returncode == 0, ended.stderr
    assert "stationary density of x: " in ended.stdout
    assert "ensemble: " in ended.stdout
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
