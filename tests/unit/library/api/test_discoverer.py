"""`Discoverer` hands on arrays as columns, and names results as PySINDy's users expect."""

from typing import Any

import numpy as np
import pytest

from atoll.api import discoverer
from atoll.api.discoverer import Discoverer
from atoll.api.model import Model
from atoll_core.errors import DataError, UsageError
from tests.unit.library.experiments.made import two_compartments
from tests.unit.library.model.results import bioreactor, result

X = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 7.0]])


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, dict[str, Any]]]:
    """What `discover` was called with; it finds dx0/dt = x1, dx1/dt = -x0."""
    calls: list[tuple[Any, dict[str, Any]]] = []

    def discover(data: Any, **options: Any) -> Model:
        calls.append((data, options))
        return Model(result({"x0": "x1", "x1": "-1.23456789*x0"}))

    monkeypatch.setattr(discoverer, "discover", discover)
    return calls


def test_parameters_of_a_template_have_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discoverer, "discover", lambda data, **options: Model(bioreactor()))
    fitted = Discoverer().fit(X[:, :2], np.arange(3.0), feature_names=["X", "S"])
    assert fitted.parameters_ == {"Y": 0.5}
    assert fitted.equations(3)[1] == "0.2*(3 - S) - S/(0.6 + 2*S)*X/0.5"


def test_parameters_of_observed_columns_have_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discoverer, "discover", lambda data, **options: Model(two_compartments()))
    assert [*Discoverer().fit(X[:, :1], np.arange(3.0), feature_names=["y"]).parameters_] == ["k10", "k12", "k21", "V"]


def test_lists_are_trajectories_with_inputs_and_derivatives(calls: list[tuple[Any, dict[str, Any]]]) -> None:
    fitted = Discoverer(seed=3).fit(
        [X, X[:2]], [np.arange(3.0), np.arange(2.0)], u=[X[:, :1], X[:2, :1]], x_dot=[X, X[:2]]
    )
    ((data, options),) = calls
    assert [sorted(part) for part in data] == [["t", "u0", "x0", "x0_dot", "x1", "x1_dot"]] * 2
    assert data[1]["x1"].tolist() == [2.0, 4.0]
    expected = {"time": "t", "states": ["x0", "x1"], "inputs": ["u0"], "derivatives": ["x0_dot", "x1_dot"], "seed": 3}
    assert options == expected
    assert fitted.feature_names_in_.tolist() == ["x0", "x1", "u0"]
    assert fitted.n_features_in_ == 2


@pytest.mark.parametrize("others", [[X], [X, X[:2], X]])
@pytest.mark.parametrize("name", ["u", "x_dot"])
def test_arrays_for_another_number_of_trajectories_are_refused(
    calls: list[tuple[Any, dict[str, Any]]], name: str, others: list[Any]
) -> None:
    with pytest.raises(DataError, match=f"{name} has {len(others)} arrays, but x has 2 trajectories"):
        Discoverer().fit([X, X[:2]], 1.0, **{name: others})
    assert not calls


@pytest.mark.usefixtures("calls")
def test_results_have_the_names_that_users_know(capsys: pytest.CaptureFixture[str]) -> None:
    fitted = Discoverer().fit(X, 1.0)
    assert fitted.equations(3) == ["x1", "-1.23*x0"]
    assert fitted.equations_ == {"x0": "x1", "x1": "-1.23457*x0"}
    fitted.print(2)
    assert capsys.readouterr().out == "dx0/dt = x1\ndx1/dt = -1.2*x0\n"
    assert fitted.predict(X)[:, 0].tolist() == [2.0, 4.0, 7.0]
    assert [values.shape for values in fitted.predict([X, X[:2]])] == [(3, 2), (2, 2)]
    assert fitted.simulate([1.0, 0.0], [0.0, 0.1]).shape == (2, 2)
    assert fitted.score(X, x_dot=fitted.predict(X)) == 1.0


@pytest.mark.usefixtures("calls")
def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(UsageError, match="no model yet"):
        Discoverer().predict(X)
    with pytest.raises(DataError, match="t has 2 times, but x has 3 rows"):
        Discoverer().fit(X, [0.0, 1.0])
    with pytest.raises(DataError, match="u has the shape"):
        Discoverer().fit(X, u=X[:2])
    with pytest.raises(UsageError, match="feature_names has 1 names"):
        Discoverer().fit(X, feature_names=["a"])
    with pytest.raises(DataError, match="list of trajectories is empty"):
        Discoverer().fit([])
    with pytest.raises(UsageError, match="times must be numbers"):
        Discoverer().fit(X, "abc")


def test_of_groups_the_constants_of_one_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    contents = result({"x0": "-2.0*x0"}, groups=[{"group": name, "trajectories": [name]} for name in ("1", "2")])
    contents["equations"][0]["groups"] = [{"group": "1", "expression": "-x0"}, {"group": "2", "expression": "-3.0*x0"}]
    monkeypatch.setattr(discoverer, "discover", lambda *_, **__: Model(contents))
    fitted = Discoverer(per_trajectory=True).fit([X[:, :1], X[:, :1]], 1.0)
    assert fitted.predict([[1.0], [2.0]], group=2).tolist() == [[-3.0], [-6.0]]
    assert fitted.simulate([1.0], [0.0, 1.0], group=1)[-1, 0] == pytest.approx(np.exp(-1.0))
    assert fitted.score(X[:, :1], x_dot=-3.0 * X[:, :1], group=2) == 1.0
    with pytest.raises(UsageError, match="choose one with of_group"):
        fitted.predict([[1.0]])


def test_angles_of_arrays_are_read_as_by_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """In degrees, with full turns: dx0/dt = 1 + x1, dx1/dt = sin(x0) - 0.2*x1, along some curve."""
    contents = result({"x0": "1.0 + x1", "x1": "sin(x0) - 0.2*x1"})
    contents["config"] = {"data": {"angles": [{"column": "x0", "degrees": True}]}}
    model = Model(contents)
    monkeypatch.setattr(discoverer, "discover", lambda *_, **__: model)
    times = np.arange(0.0, 9.0, 0.02)
    radians = model.simulate([6.0, 0.5], times).x
    rows = np.column_stack([np.degrees(radians[:, 0]) % 360.0, radians[:, 1]])
    fitted = Discoverer(angle="x0:deg").fit(rows, times)
    assert np.asarray(fitted.predict(rows)) == pytest.approx(model.predict(radians))
    assert fitted.score(rows, times) == pytest.approx(1.0, abs=1e-4)
