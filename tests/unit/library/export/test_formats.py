"""What is exported computes what the model does, whatever names and operators it has."""

import inspect
import re
import shutil

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.cli.parser import EXPORT_FORMATS
from atoll.export.formats import LANGUAGES, NAMES
from atoll.model.arguments import times_of
from atoll_core.errors import UsageError
from atoll_core.expression.operators import OPERATORS
from benchmarks.exports import programs, readers
from benchmarks.exports.models import published
from benchmarks.harness.systems import TABLE_III
from tests.unit.library.export.exported import (
    TIMES,
    decay,
    difference,
    everything,
    model,
    process,
    run_python,
)
from tests.unit.library.model.results import result

READERS = {"xppaut": readers.read_xppaut, "modelica": readers.read_modelica, "julia": readers.read_julia}


@pytest.fixture(scope="module")
def systems() -> dict[str, Model]:
    return {name: published(name, until=4.0, rows=9) for name in TABLE_III}


@pytest.mark.slow
@pytest.mark.parametrize("system", TABLE_III)
def test_texts_agree_with_simulations_of_published_systems(systems: dict[str, Model], system: str) -> None:
    exported = systems[system]
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-8
    for name, read in READERS.items():
        reading = read(exported.export(name))
        assert difference(reading.simulate(times_of(exported, None)), exported) < 1e-8


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_compiles_without_warnings_and_agrees(systems: dict[str, Model]) -> None:
    for exported in (systems["glider"], everything()):
        assert difference(programs.c(exported), exported) < 1e-8


@pytest.mark.parametrize("program", [programs.julia_text, programs.pymoca, programs.roadrunner])
def test_other_programs_agree(systems: dict[str, Model], program: object) -> None:
    try:
        assert difference(program(everything()), everything()) < 1e-8  # type: ignore[operator]
    except programs.Absent as missing:
        pytest.skip(f"{missing} is not installed")


def test_every_operator_and_hostile_names_keep_their_meaning() -> None:
    exported = everything()
    used = {code for program in exported.field.programs for code in program.operators.tolist()}
    assert used | {1, 14} >= {operator.code for operator in OPERATORS}  # inverse is written as a quotient
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-8
    for name, read in READERS.items():
        assert difference(read(exported.export(name)).simulate(TIMES), exported) < 1e-8


def test_a_state_may_have_the_name_of_a_constant_or_of_a_helper() -> None:
    exported = model({"c1": "-0.5*c1 + 0.25*w1", "w1": "0.75*c1"})
    for name, read in READERS.items():
        text = exported.export(name)
        assert "c1_2 is the constant c1" in text
        assert difference(read(text).simulate(TIMES), exported) < 1e-8
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-8
    noisy = process().result.as_dict()
    noisy["symbols"] = {"w1": "w1", "g1_1": "g1_1"}
    for equation in noisy["equations"]:
        for key in ("variable", "expression"):
            equation[key] = equation[key].replace("x", "w1").replace("y", "g1_1")
    noisy["process"]["ensemble"]["mean"] = {"w1": [1.0], "g1_1": [0.5]}
    assert run_python(Model(noisy).to_python())["noise"](0.0, np.array([1.0, 1.0])).shape == (2, 2)


@pytest.mark.parametrize("format", LANGUAGES)
def test_constants_have_all_digits_and_their_errors(format: str) -> None:
    text = decay().export(format, {"x": 0.1 + 0.2})
    assert "0.30000000000000004" in text
    assert "-0.3" in text
    assert re.search(r"\bc1\b", text)
    assert "standard error 0.1" in text or format == "xppaut"


def test_an_input_is_a_number_a_table_or_the_time() -> None:
    exported, values = decay(), np.array([0.0, 1.0, 4.0, 4.0, 3.0, 1.0, 0.0, 0.5, 0.5])
    for u in ({"u": 1.5}, {"u": values}):
        text = exported.to_python(t=TIMES, u=u)
        assert difference(run_python(text)["simulate"](), exported, t=TIMES, u=u) < 1e-8
    assert (
        difference(
            readers.read_modelica(exported.to_modelica(u={"u": 1.5})).simulate(TIMES),
            exported,
            u={"u": 1.5},
        )
        < 1e-8
    )
    assert "PARAMETERS = {\n    'c1': -0.3,  # standard error 0.1\n    'u': 0.0,  # input\n}" in exported.to_python()
    clock = model({"x": "cos(t)*x"}, inputs=("t",))
    assert difference(run_python(clock.to_python())["simulate"](), clock) < 1e-8
    for name, read in READERS.items():
        assert difference(read(clock.export(name)).simulate(TIMES), clock) < 1e-8


def recorded(values: list[float | None]) -> Model:
    """Return a model whose result has the measurements of its input."""
    contents = decay().result.as_dict()
    part = {"name": "1", "times": TIMES.tolist(), "measured": {}, "inputs": {"u": values}}
    return Model({**contents, "data": {**contents["data"], "trajectories": [part]}})


def test_recorded_inputs_are_held_as_simulations_have_them() -> None:
    exported = recorded([0.0, 1.0, None, 4.0, 3.0, 1.0, 0.0, 0.5, 0.5])
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-8
    late = np.linspace(0.0, 3.0, 9)
    assert difference(run_python(exported.to_python(t=3.0))["simulate"](times=late), exported, t=late) < 1e-8
    for name in ("c", "julia", "matlab", "modelica", "sbml"):
        assert "set to 0" not in exported.export(name)
    assert "set to 0, because no value is given: u" in exported.to_python({"x": 1.0})
    assert (
        difference(readers.read_modelica(recorded([2.0] * 9).to_modelica()).simulate(TIMES), recorded([2.0] * 9)) < 1e-8
    )


def held() -> Model:
    """Return a model whose recorded input is held between rows."""
    contents = recorded([0.0, 1.0, 1.0, 4.0, 3.0, 1.0, 0.0, 0.5, 2.0]).result.as_dict()
    contents["system"]["input_kinds"] = {"u": "held"}
    contents["data"]["trajectories"][0]["input_slopes"] = {"u": [None] * 9}
    return Model(contents)


def test_held_inputs_are_tables_of_constant_pieces() -> None:
    """What solves the text does not know of jumps: its steps are short there, and err by more than elsewhere."""
    exported = held()
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-5
    assert difference(run_python(recorded([1.0] * 9).to_python())["simulate"](), exported) > 0.1
    late = np.linspace(0.0, 3.0, 9)
    assert difference(run_python(exported.to_python(t=3.0))["simulate"](times=late), exported, t=late) < 1e-5


def test_a_format_without_tables_says_that_a_recorded_input_is_not_held() -> None:
    text = recorded([0.0, 1.0, None, 4.0, 3.0, 1.0, 0.0, 0.5, 0.5]).to_xppaut()
    assert "set to 0, and not to the recorded values, because XPPAUT has no tables: u" in text
    text = recorded([2.0] * 9).to_xppaut()
    assert "set to 0" not in text
    assert "par u=2.0" in text


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_goes_along_tables() -> None:
    values = np.sin(3.0 * TIMES)

    class Given(Model):
        def to_c(self, *_: object) -> str:
            return self.export("c", None, TIMES, {"u": values})

    assert difference(programs.c(Given(decay().result.as_dict())), decay(), t=TIMES, u={"u": values}) < 1e-8
    exported = recorded([0.0, 1.0, None, 4.0, 3.0, 1.0, 0.0, 0.5, 0.5])
    assert difference(programs.c(exported), exported) < 1e-8


SIZES_APART = {"x": "-0.0001*x", "y": "1.3*y"}
TROUGHS = {"x": "x*(1.0 - y)", "y": "y*(x - 1.0)"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equations", "start", "until"),
    [(SIZES_APART, {"x": 300.0, "y": 1e-12}, 20.0), (TROUGHS, {"x": 20.0, "y": 20.0}, 40.0)],
)
def test_each_state_has_errors_of_its_own_size(
    equations: dict[str, str], start: dict[str, float], until: float
) -> None:
    contents = model(equations, start).result.as_dict()
    contents["simulation"]["trajectories"][0]["times"] = np.linspace(0.0, until, 9).tolist()
    exported = Model(contents)
    expected = exported.simulate(has_bands=False).x
    np.testing.assert_allclose(run_python(exported.to_python())["simulate"](), expected, rtol=1e-6)
    if shutil.which("cc") is not None:
        np.testing.assert_allclose(programs.c(exported), expected, rtol=1e-6)


def test_tolerances_that_other_solvers_are_given_have_the_units_of_the_states() -> None:
    exported = model(SIZES_APART, {"x": 300.0, "y": 1e-12})
    assert f"'AbsTol', [{1e-12 * 300.0!r}, {1e-12 * 1e-12!r}]" in exported.to_matlab()
    assert f"Dict(string(x) => {1e-12 * 300.0!r}, string(y) => {1e-12 * 1e-12!r})" in exported.to_julia()
    assert f"tol=1e-12, atol={1e-12 * 1e-12!r}" in exported.to_xppaut()
    assert "Real y(start = 1e-12, fixed = true, nominal = 1e-12)" in exported.to_modelica()


def test_second_order_becomes_first_order() -> None:
    contents = result({"x": "-4.5*x - 0.25*x_dot"}, ("x_dot",))
    contents["equations"][0]["lhs"] = "d2x/dt2"
    contents["simulation"] = {
        "trajectories": [{"name": "1", "start": {"x": 1.0, "x_dot": 0.5}, "times": TIMES.tolist()}]
    }
    exported = Model(contents)
    assert difference(run_python(exported.to_python())["simulate"](), exported) < 1e-8
    assert readers.read_xppaut(exported.to_xppaut()).rates["x"] == "x_dot"


def test_a_process_keeps_its_noise_or_is_refused() -> None:
    exported = process()
    names = run_python(exported.to_python())
    x = np.array([0.7, -0.4])
    g = names["noise"](0.0, x)
    assert g @ g.T == pytest.approx(np.array([[0.04, 0.03 * x[1]], [0.03 * x[1], 0.09 + 0.01 * x[0] ** 2]]))
    path = names["simulate"](seed=3, substeps=5)
    assert path.shape == (9, 2)
    assert np.isfinite(path).all()
    assert "wiener w1\nwiener w2\n" in exported.to_xppaut()
    assert "@brownians w1 w2" in exported.to_julia()
    for name in ("c", "matlab", "modelica", "sbml"):
        with pytest.raises(UsageError, match="cannot express the noise of a process; python, julia and xppaut can"):
            exported.export(name)


def test_paths_of_a_process_have_its_variance() -> None:
    names = run_python(model_of_noise().to_python())
    ends = [names["simulate"](times=[0.0, 3.0], seed=seed, substeps=60)[-1, 0] for seed in range(400)]
    assert np.var(ends) == pytest.approx(0.5, rel=0.2)


def model_of_noise() -> Model:
    """Return dx = -x dt + dW, which settles into the variance 1/2."""
    contents = result({"x": "-x"})
    contents["equations"].append({**contents["equations"][0], "variable": "[x]", "lhs": "d[x]/dt", "expression": "1.0"})
    return Model({**contents, "process": {"step": 0.1, "ensemble": {"times": TIMES.tolist(), "mean": {"x": [0.0]}}}})


def test_a_regression_is_a_function_or_is_refused() -> None:
    contents = result({"y": "2.5*a - sqrt(b)"}, ("a", "b"))
    contents["equations"][0]["lhs"] = "y"
    del contents["symbols"]["y"], contents["equations"][0]["program"]
    exported = Model(contents | {"symbols": {"a": "a", "b": "b"}})
    assert run_python(exported.to_python())["value"](np.array([2.0, 4.0]), 9.0).tolist() == [2.0, 7.0]
    assert "double value(double a, double b)" in exported.to_c()
    assert "function value(a, b)" in exported.to_julia()
    assert "function value = atoll_model(a, b)" in exported.to_matlab()
    for name in ("modelica", "xppaut", "sbml"):
        with pytest.raises(UsageError, match="this is a regression"):
            exported.export(name)


def test_where_a_solution_ends_the_module_says_so() -> None:
    names = run_python(model({"x": "x**2"}).to_python())
    with pytest.raises(ArithmeticError, match=r"cannot be continued after time 0\.99999"):
        names["simulate"]()
    undefined = run_python(model({"x": "log(-x)"}).to_python())
    with pytest.raises(ArithmeticError, match=r"after time 0\.0"):
        undefined["simulate"]()


def test_what_a_format_cannot_hold_is_refused_in_a_sentence() -> None:
    contents = decay()
    with pytest.raises(UsageError, match="XPPAUT has no tables, but the input 'u' changes; give one number"):
        contents.to_xppaut(t=TIMES, u={"u": TIMES})
    with pytest.raises(UsageError, match="is a function, which cannot be exported"):
        contents.to_c(u={"u": np.sin})
    with pytest.raises(UsageError, match="2 values for 9 times"):
        contents.to_c(u={"u": [1.0, 2.0]})
    with pytest.raises(UsageError, match="characters, but XPPAUT reads at most 900"):
        model({"x": " + ".join(f"{0.1 + number!r}*sin(cos(tanh(x)))" for number in range(60))}).to_xppaut()
    with pytest.raises(UsageError, match="not an export format; choose one of python, c"):
        contents.export("fortran")


def test_constants_of_groups_are_exported_group_by_group() -> None:
    contents = model({"x": "-0.5*x"}).result.as_dict()
    part = {"group": "a", "expression": "-0.75*x", "program": None, "constants": []}
    contents["equations"][0]["groups"] = [part, part | {"group": "b"}]
    contents["groups"] = [{"group": name, "trajectories": ["1"], "covariance": None} for name in ("a", "b")]
    with pytest.raises(UsageError, match=r"may differ between its groups \(a, b\); choose one"):
        Model(contents).to_c()
    assert "-0.75, // c1" in Model(contents).of_group("a").to_c()


def test_no_text_breaks_out_of_a_comment() -> None:
    contents = model({"x": "-2.5*x"}).result.as_dict()
    contents["equations"][0]["reason"] = "*/ \\\nimport os #\u2028system()\u202e"
    contents["data"]["files"] = ['a".csv\r\nexit']
    for name in LANGUAGES:
        lines = Model(contents).export(name).splitlines()
        assert not any(line.startswith(("import os", "system", "exit")) for line in lines)
        assert not any(line.endswith("\\") for line in lines)
    assert run_python(Model(contents).to_python())["PARAMETERS"] == {"c1": -2.5}


def test_the_table_of_formats_is_that_of_options_methods_and_documents() -> None:
    from tests.unit.documents import texts

    assert EXPORT_FORMATS == NAMES
    assert all(callable(getattr(Model, f"to_{name}")) for name in NAMES)
    page = texts()["docs/export.md"]
    assert all(f"`{name}`" in page for name in NAMES)
    assert "x0" in inspect.signature(Model.to_c).parameters
