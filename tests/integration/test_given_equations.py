"""A job with given equations from its command to every form of its result: real processes, real kernels."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import atoll
from atoll.model.given_sides import GivenSides, program_of
from tests.programs import LIMIT_S, done

LENGTH, FRICTION = 1.3, 0.25
SIDES = ("dtheta/dt=v", "dv/dt=-9.81/l*sin(theta) + ?(v)")


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    answer = done(folder, "coordinator", *words)
    assert answer.returncode == 0, answer.stderr
    return answer


def write_pendulum(file: Path) -> None:
    times = np.linspace(0.0, 10.0, 201)

    def rates(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -9.81 / LENGTH * np.sin(state[0]) - FRICTION * state[1]]

    states = solve_ivp(rates, (0.0, 10.0), [2.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-9).y
    noisy = states + np.random.default_rng(1).normal(0.0, 0.02, states.shape)
    np.savetxt(file, np.column_stack([times, *noisy]), delimiter=",", header="t,theta,v", comments="")


@pytest.mark.timeout(4 * LIMIT_S)
@pytest.mark.slow
def test_parameters_and_the_unknown_part_are_in_every_form_of_the_result(tmp_path: Path) -> None:
    write_pendulum(tmp_path / "data.csv")
    given = [word for side in SIDES for word in ("--equation", side)]
    job = run(
        tmp_path, "run", "data.csv", "--workers", "1", "--islands", "3", "--max-epochs", "3", "--out", "out", *given
    )
    assert "? in dv/dt" in job.stderr  # while it is searched
    model = atoll.Model.load(tmp_path / "out")

    # the model
    assert {*model.params} == {"l", "c1"}
    assert model.params["l"].value == pytest.approx(LENGTH, rel=0.01)
    assert model.params["c1"].value == pytest.approx(-FRICTION, rel=0.03)
    side = model.equations[1].given
    assert side is not None
    assert side.text == "-9.81/l*sin(theta) + ?(v)"
    assert model.simulate(parameters={"l": LENGTH / 4.0})["theta"][-1] != model.simulate()["theta"][-1]

    # the programs of the result, also of its candidates, are the sides with their parts
    sides, names = GivenSides.of(model.result), model.result.names
    assert sides is not None
    assert list(sides.programs) == [program_of(equation, names) for equation in model.result.equations]
    others = [candidate for candidate in model.result.equations[1].candidates if not candidate.selected]
    for candidate, known in zip(model.candidates, sorted(others, key=lambda other: other.nats or 0.0), strict=True):
        point = [[0.7, -0.4]]
        exact = atoll.Model(model.result.model_copy(update={"equations": candidate.result.equations}))
        expected = eval(known.expression, {"theta": 0.7, "v": -0.4, **vars(np)})
        np.testing.assert_allclose(exact.predict(point)[0, 1], expected, rtol=1e-12)

    # fits of the result find the numbers and the errors of the job
    profiled = model.identifiability()
    for name in ("l", "c1"):
        np.testing.assert_allclose(profiled[name].interval, model.params[name].interval, rtol=2e-3)

    # texts and exports
    text = run(tmp_path, "result", "out").stdout
    assert "given: -9.81/l*sin(theta) + ?(v)" in text
    assert "? = -0.2" in text
    run(tmp_path, "export", "out", "--format", "petab", "-o", "petab")
    parameters = (tmp_path / "petab" / "parameters.tsv").read_text().splitlines()
    assert [line.split("\t")[0] for line in parameters[1:3]] == ["l", "c1"]
    assert "9.81/l*sin(theta)" in model.to_modelica()
    run(tmp_path, "report", "out", "-o", "report.html")
    assert "<mtext>?</mtext>" in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "out" / "result.json").read_text())["equations"][1]["given"]["parameters"] == {"l": 1}
