"""A model reads a result, knows its constants, predicts, scores, and writes itself down."""

import json
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import atoll
from atoll.api.model import Model
from atoll.model.arguments import start_of_file
from atoll.model.simulation import EarlyEndWarning, ExtrapolationWarning
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.text.parsing import from_infix
from tests.unit.library.model.results import constant, result

TIMES = np.linspace(0.0, 1.0, 11)
OUTSIDE = pytest.mark.filterwarnings("ignore::atoll.model.simulation.ExtrapolationWarning")
"""For starts and inputs that are chosen for the sake of round numbers."""


def decay() -> dict:
    """dx/dt = -2 x, the constant known to 0.1."""
    contents = result({"x": "-2.0*x"})
    contents["equations"][0]["constants"] = [constant(-2.0, 0.1)]
    contents["covariance"] = {"constants": [{"variable": "x", "constant": 0}], "matrix": [[0.01]], "freedom": 1e9}
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 3.0}, "times": [0.0, 0.5, 1.0]}]}
    contents["system"]["ranges"] = {"x": [0.4, 3.0]}
    return contents


def test_the_class_is_an_attribute_of_the_package() -> None:
    assert atoll.Model is Model
    assert "Model" in dir(atoll)
    with pytest.raises(AttributeError, match="no attribute 'model_of'"):
        _ = atoll.model_of


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    Model(decay()).save(tmp_path / "m.json")
    assert Model.load(tmp_path / "m.json").result == Result.of(decay())
    Model(decay()).save(tmp_path / "result.json")
    assert Model.load(tmp_path).result == Result.of(decay())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [("{", "is not valid JSON"), ("[]", "no result of this version"), (json.dumps(result({})), "no model")],
)
def test_what_is_no_model_is_refused_in_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(UsageError, match=sentence):
        Model.load(tmp_path / "m.json")


def test_constants_have_errors_and_the_sign_of_the_text() -> None:
    (parameter,) = Model(decay()).params.values()
    assert (parameter.name, parameter.variable, abs(parameter.value), parameter.stderr) == ("c1", "x", 2.0, 0.1)
    assert parameter.interval is not None
    assert parameter.interval[0] < parameter.value < parameter.interval[1]
    (narrow,) = Model(decay()).conf_int(0.6827).values()
    assert narrow == pytest.approx((parameter.value - 0.1, parameter.value + 0.1), rel=1e-4)


@pytest.mark.parametrize(
    ("x", "t", "unit"),
    [("m", "s", "m/s"), ("kg m", "s", "(kg m)/s"), ("mol/L", "min", "(mol/L)/min"), ("m", "s^2", "m/(s^2)")],
)
def test_units_of_a_rate_are_those_of_its_columns(x: str, t: str, unit: str) -> None:
    contents = decay()
    contents["system"]["units"] = {"x": x, "t": t}
    (equation,) = Model(contents).equations
    assert str(equation) == f"dx/dt = -2*x  [{unit}]"


def test_a_model_goes_to_another_process_after_its_formulas_were_compiled() -> None:
    model = Model(decay())
    model.simulate([1.0], [0.0, 0.5])
    copied = pickle.loads(pickle.dumps(model))
    assert copied.result == model.result
    assert copied.simulate([1.0], [0.0, 0.5])["x"].tolist() == model.simulate([1.0], [0.0, 0.5])["x"].tolist()


def test_the_band_is_that_of_the_derivative_by_the_constant() -> None:
    """x = 3 exp(-c t): dx/dc = -t x."""
    simulation = Model(decay()).simulate(t=TIMES)
    exact = 3.0 * np.exp(-2.0 * TIMES)
    assert simulation["x"] == pytest.approx(exact, rel=1e-7)
    assert simulation.stderr is not None
    assert simulation.stderr[:, 0] == pytest.approx(0.1 * TIMES * exact, rel=1e-4, abs=1e-9)
    assert simulation.upper is not None
    assert simulation.upper[:, 0] - simulation["x"] == pytest.approx(
        1.96 * simulation.stderr[:, 0], rel=1e-3, abs=1e-12
    )


def test_factors_of_one_and_correlations_are_part_of_the_band() -> None:
    """dx/dt = a - b x with a = 2, b = 1 (not written), fully correlated errors that leave a/b as it is."""
    contents = result({"x": "2.0 - x"})
    contents["equations"][0]["constants"] = [constant(2.0, 0.2)]
    names = [{"variable": "x", "constant": 0}, {"variable": "x", "constant": None}]
    contents["covariance"] = {"constants": names, "matrix": [[0.04, 0.02], [0.02, 0.01]], "freedom": 50.0}
    simulation = Model(contents).simulate({"x": 0.0}, np.array([0.0, 1.0, 40.0]))
    assert simulation.stderr is not None
    assert simulation.stderr[:, 0] == pytest.approx([0.0, 0.2 * np.exp(-1.0), 0.0], abs=1e-5)  # dx = 2 t exp(-t) db


def test_initial_states_are_as_measured_by_name_or_in_order() -> None:
    model = Model(decay())
    for given in (None, {"x": 3.0}, [3.0]):
        assert model.simulate(given).x[-1] == pytest.approx(3.0 * np.exp(-2.0))
    with pytest.raises(UsageError, match="the initial state has 'y', but the states are x"):
        model.simulate({"y": 3.0})
    with pytest.raises(UsageError, match="lacks 'x'"):
        model.simulate({})


@OUTSIDE
@pytest.mark.parametrize(
    "given", [{"u": 2.0}, {"u": 2.0 * np.ones(11)}, {"u": lambda t: 2.0}, lambda t: 2.0, 2.0 * np.ones((11, 1))]
)
def test_inputs_are_numbers_arrays_or_functions(given: object) -> None:
    model = Model(result({"x": "u"}, ("u",)))
    assert model.simulate([0.0], TIMES, given)["x"] == pytest.approx(2.0 * TIMES, abs=1e-9)


def driven(kind: str | None) -> dict:
    """dx/dt = u, the input being of a kind between rows and recorded at five times."""
    times, values = [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 0.0, -1.0, 0.0]
    slopes = [None] * 5 if kind == "held" else [1.5, 0.0, -1.5, 0.0, 1.5]
    part = {"name": "1", "times": times, "measured": {"x": values}, "inputs": {"u": values}}
    contents = result({"x": "u"}, ("u",))
    contents["data"]["trajectories"] = [{**part, "input_slopes": {"u": slopes}}]
    contents["system"]["input_kinds"] = {} if kind is None else {"u": kind}
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 0.0}, "times": times}]}
    return contents


def test_recorded_inputs_go_between_rows_as_the_fit_has_taken_them() -> None:
    """The cubic with the recorded slopes: its integral over a step is the trapezoid and (m - n) / 12 of the slopes."""
    steps = [0.5 + 1.5 / 12, 0.5 + 1.5 / 12, -0.5 - 1.5 / 12, -0.5 - 1.5 / 12]
    simulation = Model(driven("smooth")).simulate()
    assert simulation["x"] == pytest.approx(np.cumsum([0.0, *steps]), abs=1e-9)


@OUTSIDE
def test_held_inputs_jump_at_rows() -> None:
    simulation = Model(driven("held")).simulate()
    assert simulation["x"] == pytest.approx([0.0, 0.0, 1.0, 1.0, 0.0], abs=1e-9)
    model = Model(driven("held"))
    given = model.simulate([0.0], np.arange(5.0), {"u": np.array([2.0, 0.0, 0.0, 1.0, 7.0])})
    assert given["x"] == pytest.approx([0.0, 2.0, 2.0, 2.0, 3.0], abs=1e-9)


def test_bands_follow_held_inputs() -> None:
    """dx/dt = c u with c = 1 +- 0.1: the error is a tenth of the state."""
    contents = driven("held")
    contents["equations"][0] |= {"expression": "1.0*u", "program": from_infix("1.0*u", ["x", "u"]).to_bytes().hex()}
    contents["equations"][0]["constants"] = [constant(1.0, 0.1)]
    contents["covariance"] = {"constants": [{"variable": "x", "constant": 0}], "matrix": [[0.01]], "freedom": 1e9}
    simulation = Model(contents).simulate()
    assert simulation.stderr is not None
    assert simulation.stderr[:, 0] == pytest.approx([0.0, 0.0, 0.1, 0.1, 0.0], abs=1e-6)


def rotor() -> tuple[dict, dict]:
    """An angle in degrees, wrapped, that turns by 1 rad in each unit of time, and its table."""
    contents = result({"angle": "1.0", "x": "sin(angle)"})
    contents["config"] = {"data": {"angles": [{"column": "angle", "degrees": True}]}}
    times = np.arange(0.0, 20.0, 0.5)
    table = {"t": times, "angle": np.degrees(6.0 + times) % 360.0, "x": np.cos(6.0) - np.cos(6.0 + times)}
    return contents, table


def test_angles_of_a_table_are_read_as_the_fit_has_read_them() -> None:
    contents, table = rotor()
    model = Model(contents)
    assert model.score(table) == pytest.approx(1.0)
    assert model.predict(table)[:, 1] == pytest.approx(np.sin(6.0 + table["t"]))
    radians = np.column_stack([6.0 + table["t"], table["x"]])
    assert model.predict(radians)[:, 1] == pytest.approx(np.sin(6.0 + table["t"]))


def test_a_simulation_starts_at_the_angle_of_its_file(tmp_path: Path) -> None:
    contents, table = rotor()
    path = tmp_path / "angles.csv"
    np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", header=",".join(table), comments="")
    start = start_of_file(Model(contents), path)
    assert start.state == pytest.approx({"angle": 6.0, "x": 0.0})


@OUTSIDE
def test_an_input_of_a_file_goes_between_rows_as_in_the_fit(tmp_path: Path) -> None:
    path = tmp_path / "held.csv"
    path.write_text("t,x,u\n0,0,2\n1,2,0\n2,2,0\n3,2,1\n4,3,7\n", "utf-8")
    model = Model(driven("held"))
    start = start_of_file(model, path)
    simulation = model.simulate(start.state, np.array([0.0, 0.5, 3.5]), start.inputs)
    assert simulation["x"] == pytest.approx([0.0, 1.0, 2.5], abs=1e-9)


def test_an_input_that_is_the_time_needs_nothing_and_another_one_does() -> None:
    model = Model(result({"x": "t"}, ("t",)))
    assert model.simulate([0.0], TIMES)["x"] == pytest.approx(0.5 * TIMES**2, abs=1e-9)
    with pytest.raises(UsageError, match="the input 'u', but no values of it are given"):
        Model(result({"x": "u"}, ("u",))).simulate([0.0], TIMES)


def test_predictions_are_derivatives_of_rows_and_of_columns() -> None:
    model = Model(result({"x": "y", "y": "u - x"}, ("u",)))
    rows, inputs = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0], [6.0]])
    expected = [[2.0, 4.0], [4.0, 3.0]]
    assert model.predict(rows, inputs).tolist() == expected
    assert model.predict({"x": rows[:, 0], "y": rows[:, 1], "u": inputs[:, 0]}).tolist() == expected
    with pytest.raises(UsageError, match="has the inputs u"):
        model.predict(rows)


@OUTSIDE
def test_a_regression_predicts_its_target() -> None:
    contents = result({"z": "x"}, ("x",))
    contents["equations"][0] |= {"lhs": "z", "expression": "2.0*x + 1.0"}
    del contents["symbols"]["z"]
    model = Model(contents)
    assert model.predict([[1.0], [2.0]]).tolist() == [3.0, 5.0]
    assert model.score({"x": [1.0, 2.0], "z": [3.0, 5.0]}) == 1.0
    with pytest.raises(UsageError, match="not differential"):
        model.simulate([1.0], TIMES)


def test_rows_of_a_regression_outside_of_what_was_measured_are_warned_of() -> None:
    contents = result({"z": "x"}, ("x", "u"))
    contents["equations"][0] |= {"lhs": "z", "expression": "2.0*x + u"}
    contents["system"]["ranges"] = {"x": [0.0, 3.0], "u": [-1.0, 1.0]}
    del contents["symbols"]["z"]
    model, inside = Model(contents), [[0.0, -1.0], [3.0, 1.0]]
    with pytest.warns(
        ExtrapolationWarning, match=r"^2 of 4 rows are outside of .* range of x \(measured: 0 to 3\); the"
    ):
        assert model.predict([*inside, [3.5, 0.0], [-1.0, 0.0]]).tolist() == [-1.0, 7.0, 7.0, -2.0]
    with pytest.warns(
        ExtrapolationWarning, match=r"^1 of 3 rows .* of x \(measured: 0 to 3\), u \(measured: -1 to 1\);"
    ):
        model.predict([*inside, [4.0, 2.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert model.predict(inside).tolist() == [-1.0, 7.0]
        assert model.score({"x": [4.0, 5.0], "u": [0.0, 0.0], "z": [8.0, 10.0]}) == 1.0


def test_scores_are_r2_of_simulations_of_all_trajectories() -> None:
    model = Model(decay())
    exact = {"t": TIMES, "x": np.exp(-2.0 * TIMES)}
    assert model.score([exact, exact]) == pytest.approx(1.0)
    assert model.score({"t": TIMES, "x": exact["x"] + 0.1 * np.sin(40.0 * TIMES)}) < 0.99
    assert Model(result({"x": "x**2"})).score({"t": 3.0 * TIMES, "x": 1.0 + TIMES}) == -np.inf


def test_a_start_outside_of_what_was_measured_is_warned_of() -> None:
    model = Model(decay())
    with pytest.warns(ExtrapolationWarning, match=r"x = 50 \(measured: 0.4 to 3\); the model is extrapolated there"):
        simulation = model.simulate({"x": 50.0}, TIMES)
    assert simulation.as_dict()["remark"] == simulation.remark
    assert simulation.remark in repr(simulation)
    assert model.simulate({"x": 3.0}, TIMES).remark == ""
    with pytest.warns(ExtrapolationWarning, match=r"u = 9 \(measured: -1 to 1\)"):
        Model(driven("held")).simulate([0.0], TIMES, {"u": 9.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Model(driven("held")).simulate([0.0], TIMES, {"u": -1.0})  # recorded, though not in the rows that were searched
        contents, _ = rotor()
        Model(contents).simulate({"angle": 100.0, "x": 0.0}, TIMES)  # an angle comes round
        assert model.score({"t": TIMES, "x": 50.0 * np.exp(-2.0 * TIMES)}) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ({"t": TIMES, "x": TIMES}, "no column 'y'"),
        ({"t": TIMES, "x": TIMES, "y": np.append(np.nan, TIMES[1:])}, "no finite 'y'"),
    ],
)
def test_a_score_needs_every_state_of_order_1_in_the_first_row(data: dict, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        Model(result({"x": "y", "y": "-x"})).score(data)


def test_velocities_of_order_2_are_estimated_from_three_rows() -> None:
    contents = result({"x": "-x"}, ("x_dot",))
    contents["equations"][0]["lhs"] = "d2x/dt2"
    assert Model(contents).score({"t": TIMES, "x": np.cos(TIMES)}) > 0.99
    with pytest.raises(UsageError, match="velocity of 'x' is estimated from 3 or more rows"):
        Model(contents).score({"t": TIMES[:2], "x": TIMES[:2]})
    with pytest.raises(UsageError, match="no finite 'x'"):
        Model(contents).score({"t": TIMES, "x": np.append(np.nan, TIMES[1:])})


@pytest.mark.parametrize("name", ["O2/N2", "dose/day"])
def test_a_target_with_a_slash_is_no_derivative(name: str) -> None:
    contents = result({"y": "2.0*x"}, ("x",))
    contents["symbols"] = {name: "y", "x": "x"}
    contents["equations"][0] |= {"lhs": name, "variable": name}
    contents["system"] |= {"kind": "regression", "units": {name: "mol"}}
    del contents["symbols"][name]
    contents["equations"][0]["program"] = from_infix("2.0*x", ["x"]).to_bytes().hex()
    model = Model(contents)
    assert model.is_regression
    assert str(model) == f"{name} = 2*x  [mol]"
    assert model.predict({"x": [1.0]}) == pytest.approx([2.0])
    assert "frac" not in model.latex() + model.mathml()


def test_a_constant_on_its_bound_has_its_ends_and_no_other_level() -> None:
    contents = decay()
    contents["equations"][0]["constants"] = [constant(-2.0, 0.1) | {"std_error": None, "interval": [-2.0, -1.5]}]
    assert "± " not in Model(contents).summary()
    assert "-2 to -1.5" in Model(contents).summary()
    assert Model(contents).conf_int() == {"c1": pytest.approx((-2.0, -1.5))}
    assert Model(contents).conf_int(0.5) == {"c1": None}


def test_the_index_of_a_pandas_frame_is_a_column_by_its_name() -> None:
    import pandas

    frame = pandas.DataFrame({"x": 3.0 * np.exp(-2.0 * TIMES)}, index=pandas.Index(TIMES, name="t"))
    assert Model(decay()).score(frame) == pytest.approx(1.0)


def test_candidates_are_models_with_the_rest_as_it_is() -> None:
    contents = result({"x": "y", "y": "-x"})
    other = {"expression": "-sin(x)", "complexity": 3, "origin": "front", "nats": 2.5, "selected": False}
    contents["equations"][1]["candidates"] = [{**other, "selected": True, "nats": 0.0}, other]
    (model,) = Model(contents).candidates
    assert [equation.expression for equation in model.equations] == ["y", "-sin(x)"]
    assert model.equations[1].nats == 2.5
    assert model.simulate([0.0, 0.1], TIMES).status == "finished"


def test_expressions_of_sympy_need_sympy_and_nothing_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll.display.notation.find_spec", lambda name: None)
    model = Model(decay())
    assert model.latex()
    assert model.mathml()
    with pytest.raises(UsageError, match=r"sympy, which is not installed; run: pip install 'atoll\[sympy\]'"):
        model.to_sympy()


def test_a_model_is_written_as_text_latex_mathml_and_html() -> None:
    model = Model(decay())
    assert "good: It fits & more." in model.summary()
    assert "± 0.2" in model.summary()
    assert model.latex().startswith(r"\begin{aligned}\frac{d x}{d t} &= - 2 x \\ &")
    assert model.latex() in model._repr_latex_()
    assert model.mathml().startswith("<math")
    assert "It fits &amp; more." in model._repr_html_()
    assert str(model.to_sympy()["dx/dt"]) == "-2.0*x"
    assert model.provenance["data"] == "ab"


def grouped() -> dict:
    """dx/dt = -c1 x + c2, c1 of each strain, c2 of both."""
    contents = result({"x": "2.0 - 0.75*x"}, config={"data": {"group": "strain"}})
    shared = {"shared": True}
    equation = contents["equations"][0]
    equation["constants"] = [constant(2.0, 0.1) | shared, constant(0.75, 0.0) | {"shared": False, "std_error": None}]
    equation["groups"] = [
        {
            "group": name,
            "expression": f"2.0 - {value}*x",
            "program": from_infix(f"2.0 - {value}*x", ["x"]).to_bytes().hex(),
            "constants": [constant(2.0, 0.1) | shared, constant(value, 0.01) | {"shared": False}],
        }
        for name, value in (("1", 0.5), ("2", 1.0))
    ]
    numbers = [{"variable": "x", "constant": 0}, {"variable": "x", "constant": 1}]
    spread = {"constants": numbers, "matrix": [[0.01, 0.0], [0.0, 0.0001]], "freedom": 50.0}
    contents["groups"] = [{"group": name, "trajectories": [name], "covariance": spread} for name in ("1", "2")]
    contents["simulation"] = {
        "trajectories": [{"name": name, "start": {"x": float(name)}, "times": [0.0, 1.0]} for name in ("1", "2")]
    }
    return contents


def test_constants_of_groups_are_named_by_them() -> None:
    model = Model(grouped())
    assert model.groups == ("1", "2")
    assert {name: param.value for name, param in model.params.items()} == {
        "c1": 2.0,
        "c2[strain 1]": 0.5,
        "c2[strain 2]": 1.0,
    }
    assert model.params["c2[strain 2]"].stderr == 0.01
    assert model.conf_int(0.9)["c2[strain 1]"][0] == pytest.approx(0.5 - 1.676 * 0.01, abs=1e-4)


def test_a_group_is_simulated_with_its_own_constants() -> None:
    model = Model(grouped())
    for name, rate in (("1", 0.5), ("2", 1.0)):
        run = model.simulate({"x": 1.0}, t=[0.0, 60.0], group=name)
        assert run["x"][-1] == pytest.approx(2.0 / rate)
        assert run.upper is not None
        assert model.of_group(name).simulate()["x"][0] == float(name)
    assert model.of_group(2).params["c2"].value == 1.0
    assert model.of_group(2).groups == ()


def test_a_model_of_groups_asks_which_one_is_meant() -> None:
    model = Model(grouped())
    for use in (lambda: model.simulate({"x": 1.0}, 1.0), model.analyse, lambda: model.predict([[1.0]])):
        with pytest.raises(UsageError, match=r"differ between its groups \(1, 2\); choose one"):
            use()
    with pytest.raises(UsageError, match="no group '3'; the groups are 1, 2"):
        model.of_group(3)
    with pytest.raises(UsageError, match="the model has no groups"):
        Model(decay()).of_group(1)


def test_what_is_shown_says_that_constants_are_means_over_groups() -> None:
    model = Model(grouped())
    remark = "Constants that differ between groups are means over them; the groups are 1, 2."
    assert repr(model).splitlines()[1:] == [remark]
    assert remark in model.summary().splitlines()
    assert f"<p>{remark}</p>" in model._repr_html_()
    assert model.export("latex").startswith(f"% {remark}\n")
    assert model.export("sympy").startswith(f"# {remark}\n")
    for name in ("latex", "sympy"):
        assert "means" not in repr(model.of_group(1)) + model.of_group(1).export(name)


def test_a_candidate_is_not_of_the_groups_of_the_equation_that_is_shown() -> None:
    contents = grouped()
    contents["equations"][0]["candidates"] = [
        {"expression": "1.0 - x*x", "complexity": 5, "origin": "front", "nats": 3.0, "selected": False}
    ]
    contents["equations"][0] |= {"bounds": [{"text": "c > 0"}], "units": {"implied": [], "faults": []}}
    for model in (Model(contents), Model(contents).of_group("1")):
        (candidate,) = model.candidates
        assert candidate.equations[0].exact == "1.0 - x*x"
        assert candidate.groups == ()
        assert "dx/dt" in candidate.remark
        assert "all groups together" in candidate.remark
        assert candidate.result.groups == ()
        equation = candidate.result.equations[0]
        assert (equation.groups, equation.bounds, equation.units) == ((), (), None)


def test_names_that_are_no_inputs_are_refused() -> None:
    model = Model(result({"x": "u - x"}, ("u",)))
    for ask in (lambda: model.simulate([1.0], TIMES, {"U": 0}), lambda: model.export("c", [1.0], TIMES, {"U": 0})):
        with pytest.raises(UsageError, match="there is no input 'U'; the inputs are u"):
            ask()
    with pytest.raises(UsageError, match="there is no input 'v'; the inputs are none"):
        Model(result({"x": "-x"})).simulate([1.0], TIMES, {"v": 1.0})


@pytest.mark.slow
def test_a_simulation_that_ends_early_is_warned_of_and_a_score_of_it_is_none() -> None:
    model = Model(result({"x": "x**2"}))
    with pytest.warns(EarlyEndWarning, match="times were reached"):
        assert len(model.simulate([1.0], [0.0, 0.5, 2.0]).t) == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert model.score({"t": [0.0, 0.5, 2.0], "x": [1.0, 2.0, 3.0]}) == -np.inf


@pytest.mark.parametrize(
    "data", [[{"t": [0.0], "x": [1.0]}, {"t": [0.0], "y": [1.0]}], {"t": [0.0, 1.0], "x": [[1.0], [2.0]]}]
)
def test_a_score_says_what_it_lacks(data: Any) -> None:
    with pytest.raises(UsageError, match=r"give|same number of rows"):
        Model(result({"x": "-x"})).score(data)


@OUTSIDE
def test_errors_are_those_of_an_equation_that_names_another_state() -> None:
    """With dx/dt = c v and dv/dt = 0, x = c v t has the error v t of that of c."""
    contents = result({"x": "v", "v": "v - v"})
    places = [{"variable": "x", "constant": None}]
    model = Model(contents | {"covariance": {"constants": places, "matrix": [[0.01]], "freedom": None}})
    simulation = model.simulate({"x": 0.0, "v": 2.0}, [0.0, 3.0])
    assert simulation.stderr is not None
    assert simulation.stderr[-1].tolist() == pytest.approx([0.1 * 2.0 * 3.0, 0.0])
