"""Models with hidden states: simulations begin with their initial values, and have the observed columns."""

from pathlib import Path

import numpy as np
import pytest

from atoll import Model
from atoll.report.page import as_html
from atoll.text.render import render_text
from atoll_core.data.dataset import FloatArray
from tests.unit.library.experiments.made import RATES, drug_course, two_compartments

VOLUME = 2.1
TIMES = np.linspace(0.5, 20.0, 60)
ERRORS = {("c", 0): 0.02, ("c", 1): 0.01, ("c", 2): 0.03, ("p", 0): 0.01, ("p", 1): 0.03, ("y", 0): 0.05}
"""Standard errors; k12 and k21 stand in both equations, and each is one number."""


@pytest.fixture(scope="module")
def model() -> Model:
    contents = two_compartments()
    directions = ["k10", "k12", "k21", "k12", "k21", "V"]
    names = np.array(directions)
    matrix = np.outer([*ERRORS.values()], [*ERRORS.values()]) * (names[:, None] == names)
    places = [{"variable": variable, "constant": number} for variable, number in ERRORS]
    return Model(contents | {"covariance": {"constants": places, "matrix": matrix.tolist(), "freedom": None}})


def simulated(model: Model, **values: float) -> dict[str, FloatArray]:
    known = {name: one.value for name, one in model.params.items()}
    simulation = model.simulate(t=TIMES, parameters=known | values)
    return {name: simulation[name] for name in ("c", "p", "y")}


def test_simulations_begin_with_the_values_of_hidden_states_in_the_result(model: Model) -> None:
    simulation = model.simulate()
    assert simulation.states == ("c", "p")
    assert simulation.t[0] == 0.5
    np.testing.assert_allclose(simulation.x.T, drug_course(TIMES), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(simulation["y"], drug_course(TIMES)[0] / VOLUME, rtol=1e-8)
    assert [*simulation.columns()][:4] == ["t", "c", "p", "y"]


def test_bands_of_observed_columns_contain_the_errors_of_their_own_parameters(model: Model) -> None:
    simulation, base = model.simulate(), simulated(model)
    variance = np.zeros(len(TIMES))
    for name, own in {"k10": 0.02, "k12": 0.01, "k21": 0.03, "V": 0.05}.items():
        value, step = model.params[name].value, 1e-5
        variance += ((simulated(model, **{name: value + step})["y"] - base["y"]) / step * own) ** 2
    error = simulation.observed["y"].stderr
    assert error is not None
    np.testing.assert_allclose(error, np.sqrt(variance), rtol=2e-3)
    assert error[0] == pytest.approx(10.0 / VOLUME**2 * 0.05, rel=1e-6)  # the initial value is given
    lower, upper = simulation.band("y")
    np.testing.assert_allclose(0.5 * (upper - lower), 1.96 * error, rtol=1e-3)
    assert {"y_lower", "y_upper"} < {*simulation.columns()}


def test_parameters_of_observations_are_parameters_of_the_model(model: Model) -> None:
    assert [*model.params] == [*RATES, "V"]
    assert model.params["V"].value == VOLUME
    np.testing.assert_allclose(simulated(model, V=4.2)["y"], 0.5 * simulated(model)["y"], rtol=1e-12)
    np.testing.assert_array_equal(simulated(model, V=4.2)["c"], simulated(model)["c"])


def test_models_are_scored_by_observed_columns(model: Model) -> None:
    y = drug_course(TIMES)[0] / VOLUME
    assert model.score({"t": TIMES, "y": y}) == pytest.approx(1.0)
    assert model.score({"t": TIMES, "y": y + 1.0}) < 0.5


def test_texts_mark_hidden_states_and_list_observed_columns(model: Model) -> None:
    text = render_text(model.result)
    assert "dc/dt = -0.3*c - 0.5*c + 0.25*p  (hidden state)" in text
    assert "y = c/2.1  (observed: c/V)\n    V = 2.1" in text
    assert "y = c/2.1  (observed: c/V)" in model.summary()
    listed = render_text(model.result, fronts=True)
    assert "noise of y" in listed
    assert "noise of c" not in listed


def test_reports_draw_hidden_states_without_points(model: Model, tmp_path: Path) -> None:
    page = as_html(model.result)
    assert "c (hidden: it has no measured values)" in page
    assert "y = c/2.1" in page
    assert "residuals of y" in page
    assert "residuals of c" not in page
