"""A job with a parameter that differs by run, from its command to every form of its result: real processes."""

import json
from pathlib import Path

import numpy as np
import pytest

import atoll
from atoll_core.errors import UsageError
from tests.integration.test_given_equations import run
from tests.programs import LIMIT_S

RATES = {"a": 0.3, "b": 1.0, "c": 2.0}
WORDS = ("--equation", "dy/dt=-k*(y - b)", "--parameter", "k=0.01..10 by run", "--parameter", "b=0.1..10")


def write_decays(file: Path) -> None:
    times, rng = np.linspace(0.0, 5.0, 41), np.random.default_rng(3)
    lines = ["batch,t,y"]
    for name, rate in RATES.items():
        values = 0.5 + 3.0 * np.exp(-rate * times) + rng.normal(0.0, 0.01, len(times))
        lines += [f"{name},{time},{value}" for time, value in zip(times, values, strict=True)]
    file.write_text("\n".join(lines) + "\n")


def submit(folder: Path, out: str, *words: str) -> atoll.Model:
    run(folder, "run", "data.csv", "--trajectory", "batch", "--out", out, *WORDS, *words)
    return atoll.Model.load(folder / out)


@pytest.mark.timeout(4 * LIMIT_S)
def test_values_by_run_are_in_every_form_of_the_result(tmp_path: Path) -> None:
    write_decays(tmp_path / "data.csv")
    model = submit(tmp_path, "out", "--workers", "1")
    found = {f"k[run {name}]": rate for name, rate in RATES.items()}

    # the model: the values have errors, and simulations begin with the first run's value or a given one
    assert [*model.params] == ["b", *found]
    for name, rate in found.items():
        assert model.params[name].value == pytest.approx(rate, rel=0.03)
        low, high = model.params[name].interval or (np.nan, np.nan)
        assert low < model.params[name].value < high
    assert model.simulate(t=[0.0, 1.0])["k"][-1] == model.params["k[run a]"].value
    changed = model.simulate({"y": 1.5, "k": 1.0}, [0.0, 1.0], parameters={"k": 2.0, "b": 0.5})
    assert model.simulate({"y": 1.5}, [0.0, 1.0], parameters={"k": 2.0, "b": 0.5})["y"][-1] == changed["y"][-1]
    assert changed["y"][-1] == pytest.approx(0.5 + np.exp(-2.0), rel=1e-4)
    smoothed = model.smooth()
    for name, rate in RATES.items():
        assert smoothed[name].x[0, smoothed.states.index("k")] == pytest.approx(rate, rel=0.03)

    # the result: no hidden state, and the values with the names of the runs
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert "hidden" not in content
    assert content["config"]["prior"]["parameters"]["k"] == {"lower": 0.01, "upper": 10.0, "by": "run"}
    assert [value["run"] for value in content["equations"][1]["runs"]] == [*RATES]

    # texts, report and exports
    text = run(tmp_path, "result", "out").stdout
    assert "k: a parameter by run\n    k[run a] = 0." in text
    assert "hidden state)" not in text
    assert "k[run b] = 1.0" in "".join(model.to_html())
    assert r"\text{by run}" in model.latex()
    run(tmp_path, "export", "out", "--format", "petab", "-o", "petab")
    estimated = (tmp_path / "petab" / "parameters.tsv").read_text()
    assert [line.split("\t")[0] for line in estimated.splitlines() if "k" in line.split("\t")[0]] == [
        "start_k_1", "start_k_2", "start_k_3",
    ]  # fmt: skip
    assert [*json.loads(run(tmp_path, "analyse", "out", "--identifiability", "--json").stdout)["identifiability"]]
    with pytest.raises(UsageError, match="by run"):
        model.suggest()


@pytest.mark.timeout(6 * LIMIT_S)
@pytest.mark.slow
def test_values_by_run_are_equal_with_any_number_of_workers_and_differ_from_a_shared_value(tmp_path: Path) -> None:
    write_decays(tmp_path / "data.csv")
    one, two = (submit(tmp_path, number, "--workers", number) for number in "12")
    assert one.result.equations == two.result.equations
    assert one.params == two.params
    shared = [word.replace(" by run", "") for word in WORDS]
    run(tmp_path, "run", "data.csv", "--trajectory", "batch", "--out", "shared", "--workers", "1", *shared)
    compared = json.loads(run(tmp_path, "compare", "1", "shared", "--json").stdout)
    assert compared["data"][0]["nats"] > 100.0, compared["data"][0]
