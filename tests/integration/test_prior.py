"""What is known beforehand through the whole of ``coordinator run``: real processes, real kernels."""

import json
import math
import subprocess
from pathlib import Path

import pytest

from atoll.api.model import Model
from tests.programs import LIMIT_S, done


def run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return done(folder, "coordinator", "run", "data.csv", "--workers", "1", "--out", "out", *options)


@pytest.mark.timeout(LIMIT_S + 50)
@pytest.mark.slow
def test_runs_with_rates_of_their_own_obey_one_law_with_units_and_bounds(tmp_path: Path) -> None:
    rows = ["strain,t [h],x [g/L]"]
    for strain, rate in ((1, 0.5), (2, 1.0), (3, 1.7)):
        rows += [f"{strain},{0.2 * k!r},{2.0 / (1.0 + 19.0 * math.exp(-rate * 0.2 * k))!r}" for k in range(60)]
    (tmp_path / "data.csv").write_text("\n".join(rows) + "\n")
    options = ["--group", "strain", "--bound", "x: x > 0", "--require", "x=x", "--islands", "3"]
    answer = run(tmp_path, *options)
    assert answer.returncode == 0, answer.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    (equation,) = result["equations"]
    assert equation["verdict"] == "exact", equation["reason"]
    assert [bound["bound"] for bound in equation["bounds"]] == ["x > 0"]
    model = Model(result)
    for group, rate in zip(model.groups, (0.5, 1.0, 1.7), strict=True):
        group_model = model.of_group(group)
        assert group_model.predict([[1.0]])[0, 0] == pytest.approx(0.5 * rate, rel=1e-6)
        assert group_model.predict([[1.5]])[0, 0] == pytest.approx(0.375 * rate, rel=1e-6)
    assert {param.unit for param in model.params.values()} <= {"1/h", "L/g", "L/(g h)", "L/(h g)", "g/L"}
    assert (
        "constants may differ between 3 groups of trajectories\nrequired: dx/dt has x\nbounds: dx/dt: x > 0"
        in answer.stderr
    )
