"""What a notebook shows of values: a few lines of each, frames, bands by name, LaTeX as it is typeset."""

import re
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from atoll.api.model import Model
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import measured
from tests.unit.library.model.results import constant, process_result, result

ROWS = 400
TIMES = np.linspace(0.0, 4.0, ROWS)
NOISE = 0.01 * np.random.default_rng(1).standard_normal(ROWS)


@pytest.fixture(scope="module")
def model() -> Model:
    """A predator that is not pursued: dx/dt = 1.0 - 0.5 x y, of many rows, with another candidate."""
    courses = [(TIMES, {"x": 2.0 * np.exp(-0.5 * TIMES) + NOISE, "y": 3.0 * np.exp(-1.5 * TIMES) - NOISE})]
    contents = measured({"x": "-0.5*x", "y": "-1.5*y"}, courses, 0.01)
    contents["system"]["ranges"] = {"x": [0.2, 2.0], "y": [0.01, 3.0]}
    for equation, value in zip(contents["equations"], (-0.5, -1.5), strict=True):
        equation["constants"] = [constant(value, 0.01)]
    other = {"expression": "-2*x/(4 + x)", "complexity": 7, "nats": 2.0, "origin": "library", "selected": False}
    contents["equations"][0]["candidates"] = [other]
    numbers = [{"variable": name, "constant": 0} for name in ("x", "y")]
    contents["covariance"] = {"constants": numbers, "matrix": [[1e-4, 0.0], [0.0, 1e-4]], "freedom": 400.0}
    curves = {name: column.tolist() for name, column in courses[0][1].items()}
    part = {"name": "1", "times": TIMES.tolist(), "values": curves, "measured": curves, "start": {"x": 2.0, "y": 3.0}}
    contents["simulation"] = {"trajectories": [part]}
    return Model(contents)


def parts_of(value: Any, name: str) -> dict[str, Any]:
    """Return a value and all objects of ours that it holds, by where they are."""
    found = {name: value}
    if is_dataclass(value):
        held = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, tuple | list):
        held = {str(number): each for number, each in enumerate(value[:5])}
    else:
        held = dict(value) if isinstance(value, dict) else {}
    for key, each in held.items():
        if type(each).__module__.startswith("atoll") or isinstance(each, tuple | list | dict):
            found |= parts_of(each, f"{name}.{key}")
    return found


def test_a_value_shows_a_few_lines_of_itself_and_of_each_part(model: Model) -> None:
    values: dict[str, Any] = {
        "model": model,
        "result": model.result,
        "equation": model.result.equations[0],
        "simulation": model.simulate(),
        "analysis": model.analyse(vary=("c1", (-1.0, 1.0))),
        "identifiability": model.identifiability(),
        "suggestions": model.suggest(),
        "paths": Model(process_result()).simulate([1.0], TIMES, paths=50),
        "density": Model(process_result()).stationary_density([1.0], paths=50),
    }
    for name, value in values.items():
        for where, part in parts_of(value, name).items():
            if type(part).__module__.startswith("atoll"):
                assert len(repr(part)) <= 2500, (where, repr(part))
                assert repr(part).count("\n") < 20, (where, repr(part))
                assert max(map(len, repr(part).splitlines())) <= 1200, (where, repr(part))
    assert repr(values["simulation"]) == (
        "<Simulation of x, y: 400 times from 0 to 4, with 95 % bands; finished: it reached time 4>"
    )
    assert repr(values["paths"]) == "<Ensemble of x: 400 times from 0 to 4; 50 paths>"
    assert repr(values["analysis"]).startswith("box: x ")


def test_a_long_text_is_cut_with_what_is_left_out_named(model: Model) -> None:
    from atoll_core.quoting import first_lines

    text = first_lines("\n".join(["a" * 500, *("b" for _ in range(30))]), "print it").splitlines()
    assert text[0] == "a" * 159 + "…"
    assert text[-1] == "… 12 more lines; print it"
    assert len(text) == 20


def test_values_are_frames(model: Model) -> None:
    run = model.simulate()
    frame = run.to_frame()
    assert isinstance(frame, polars.DataFrame)
    assert frame.columns == ["t", "x", "y", "x_lower", "x_upper", "y_lower", "y_upper"]
    assert frame["x"].to_list() == run["x"].tolist()
    assert model.to_frame().rows()[0][:4] == ("c1", "x", -0.5, 0.01)
    assert model.analyse().to_frame()["kind"].to_list() == ["stable node"]
    assert model.identifiability().to_frame()["verdict"].to_list() == ["determined", "determined"]
    assert {"x", "y", "until", "samples", "cost"} <= set(model.suggest().to_frame().columns)
    assert Model(process_result()).simulate([1.0], TIMES, paths=9).to_frame().columns[:3] == ["t", "x_mean", "x_lower"]
    with pytest.raises(UsageError, match="'R' was given"):
        run.to_frame("R")  # type: ignore[arg-type]


def test_a_frame_is_of_pandas_too_and_a_missing_library_is_named(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    import pandas

    assert isinstance(model.simulate().to_frame("pandas"), pandas.DataFrame)
    for name, other, install in (("polars", "pandas", "'atoll[parquet]'"), ("pandas", "polars", "pandas")):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(UsageError, match=re.escape(f'pip install {install}, or call to_frame("{other}")')):
            model.simulate().to_frame(name)  # type: ignore[arg-type]


def test_bands_are_named_by_their_state(model: Model) -> None:
    run = model.simulate()
    lower, upper = run.band("y")
    assert (lower <= run["y"]).all()
    assert (run["y"] <= upper).all()
    assert (lower == run.lower[:, 1]).all()
    with pytest.raises(KeyError):
        run.band("z")
    with pytest.raises(UsageError, match="there is no band of 'y': the errors of the constants are not known"):
        model.simulate(has_bands=False).band("y")
    ensemble = Model(process_result()).simulate([1.0], TIMES, paths=9)
    assert (ensemble.band("x")[1] == ensemble.upper[:, 0]).all()


def test_a_loaded_model_is_equal_to_the_one_that_was_saved(model: Model, tmp_path: Path) -> None:
    for number, each in enumerate((model, *model.candidates, Model(process_result()))):
        each.save(tmp_path / f"{number}.json")
        loaded = Model.load(tmp_path / f"{number}.json")
        assert loaded == each
        assert hash(loaded) == hash(each)
        _ = each.simulate([1.0] * len(each.states), 1.0)  # what is computed when it is needed makes no difference
        assert loaded == each
    assert model != model.candidates[0]
    assert model != "model"


def test_a_report_is_written_and_its_path_returned(model: Model, tmp_path: Path) -> None:
    assert model.report(tmp_path / "page.html") == tmp_path / "page.html"
    assert (tmp_path / "page.html").read_text("utf-8") == model.to_html()


def test_latex_has_upright_words_errors_and_units() -> None:
    contents = result({"hare": "0.5*hare + 1.25e-07", "lynx": "-hare*lynx"})
    contents["equations"][0]["constants"] = [
        constant(0.5, 0.01) | {"unit": "1/year"},
        constant(1.25e-7, 3e-9) | {"value": 1.2e-7, "identifiable": False},
    ]
    contents["system"] |= {"time": "year", "units": {"hare": "thousand", "year": "a"}}
    contents["equations"][0]["lhs"] = "dhare/dyear"
    first, constants, second = Model(contents).latex().split(r" \\ ")
    assert first == (
        r"\begin{aligned}\frac{d \mathrm{hare}}{d \mathrm{year}} &= "
        r"1.25 \cdot 10^{-7} + 0.5 \, \mathrm{hare} \quad \left[\mathrm{thousand/a}\right]"
    )
    assert constants == (
        r"&\quad \text{constants: } 0.5\; (0.500 \pm 0.010)\,\mathrm{1/year},\; "
        r"1.2 \cdot 10^{-7}\; (1.250 \cdot 10^{-7} \pm 3.0 \cdot 10^{-9}, \text{not determined})"
    )
    assert r"- \mathrm{hare} \, \mathrm{lynx}" in second
    assert Model(contents).latex() in Model(contents)._repr_latex_()
