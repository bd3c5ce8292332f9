"""A job with hidden states from its command to what is done with its result: real processes, real kernels."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import atoll
from tests.integration.test_given_equations import run
from tests.programs import LIMIT_S
from tests.unit.library.experiments.made import COMPARTMENTS, RATES, VOLUME, drug_course

TRUTH = RATES | {"V": VOLUME}
TIMES = np.linspace(0.05, 16.0, 50)


@pytest.mark.timeout(4 * LIMIT_S)
@pytest.mark.slow
def test_a_result_with_hidden_states_is_used_as_other_results(tmp_path: Path) -> None:
    y = drug_course(TIMES)[0] / VOLUME + np.random.default_rng(2).normal(0.0, 0.01, len(TIMES))
    np.savetxt(tmp_path / "data.csv", np.column_stack([TIMES, y]), delimiter=",", header="t,y", comments="")
    words = ["--hidden", "c,p", "--observe", "y=c/V", "--initial", "c=10", "--initial", "p=0"]
    words += [word for name, side in COMPARTMENTS.items() for word in ("--equation", f"d{name}/dt={side}")]
    words += [word for name in TRUTH for word in ("--parameter", f"{name}=0.01..20")]
    run(tmp_path, "run", "data.csv", "--workers", "1", "--out", "out", *words)
    model = atoll.Model.load(tmp_path / "out")
    assert {name: one.value for name, one in model.params.items()} == pytest.approx(TRUTH, rel=0.05)

    # fits of the result find the numbers and the errors of the job
    profiled = model.identifiability()
    for name in TRUTH:
        np.testing.assert_allclose(profiled[name].interval, model.params[name].interval, rtol=0.02)
    compared = json.loads(run(tmp_path, "compare", "out", "out", "--json").stdout)
    assert compared["data"][0]["columns"] == ["y"]

    # simulations, smoothed states and the listed simulation of the job are the same
    (listed,) = model.result.simulated
    rows = [*csv.DictReader(run(tmp_path, "simulate", "out").stdout.splitlines())]
    smoothed = model.smooth()
    for name in ("c", "p", "y"):
        assert listed.values is not None
        values = np.array([float(row[name]) for row in rows])
        np.testing.assert_allclose(values, np.array(listed.values[name], float), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(smoothed["1"].x[:, smoothed.states.index(name)], values, rtol=0.01, atol=0.01)
    forecast = model.forecast(5.0, draws=100)
    truth = drug_course(np.append(TIMES[0], forecast.t))[:, 1:]
    np.testing.assert_allclose(forecast["p"], truth[1], rtol=0.1)

    # texts and exports
    text = run(tmp_path, "result", "out").stdout
    assert "(hidden state)" in text
    assert "(observed: c/V)" in text
    run(tmp_path, "report", "out", "-o", "report.html")
    run(tmp_path, "export", "out", "--format", "petab", "-o", "petab")
    assert "observable_y\ty\t" in (tmp_path / "petab" / "observables.tsv").read_text()
