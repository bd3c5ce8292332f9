"""``coordinator simulate``: CSV from a driven result, and a sentence with exit code 2 for what does not fit."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.cli.main import main
from atoll_coordinator.result.result import Result
from tests.unit.library.experiments.made import measured
from tests.unit.library.experiments.test_comparison import decay
from tests.unit.library.experiments.test_design_search import FOUND, TIMES, WIDE
from tests.unit.library.export.exported import run_python
from tests.unit.library.model.results import process_result, result
from tests.unit.library.report.results import regression


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    contents = result({"x": "u*x"}, ("u",))
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0.0, 1.0]}]}
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def test_a_file_gives_initial_state_times_and_inputs(driven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (driven / "a.csv").write_text("t,x,u\n0,2,0\n1,9,0\n2,9,0\n")
    assert main(["simulate", str(driven), "--initial", str(driven / "a.csv")]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n1.0,2.0\n2.0,2.0\n"


def test_dates_in_a_file_are_counted_in_the_unit_of_the_model(driven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contents = json.loads((driven / "result.json").read_text())
    contents["system"]["units"] = {"t": "min"}
    (driven / "result.json").write_text(json.dumps(contents))
    (driven / "a.csv").write_text("t,x,u\n2021-03-01 06:00,2,0\n2021-03-01 07:00,9,0\n")
    assert main(["simulate", str(driven), "--initial", str(driven / "a.csv")]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n60.0,2.0\n"


def test_an_input_that_nothing_gives_is_named(driven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(driven / "result.json"), "--initial", "x=1"]) == 2
    assert "the input 'u', but no values of it are given; give a number, such as --hold u=1," in capsys.readouterr().err


@pytest.mark.parametrize("simulation", [None, {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0, 1]}]}])
def test_what_was_recorded_is_simulated_unless_inputs_are_held(
    driven: Path, capsys: pytest.CaptureFixture[str], simulation: dict | None
) -> None:
    contents = result({"x": "u*x"}, ("u",)) | {"simulation": simulation}
    measured = {"name": "1", "times": [0.0, 1.0], "measured": {"x": [2.0, 2.0]}, "inputs": {"u": [0.0, 0.0]}}
    contents["data"]["trajectories"] = [measured]
    (driven / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(driven)]) == 0
    assert capsys.readouterr().out == "t,x\n0.0,2.0\n1.0,2.0\n"
    assert main(["simulate", str(driven), "--hold", "u=1"]) == 0
    assert float(capsys.readouterr().out.split(",")[-1]) == pytest.approx(2.0 * 2.718281828)
    assert main(["simulate", str(driven), "--hold", "v=1"]) == 2
    assert "--hold names 'v'; the inputs are u" in capsys.readouterr().err


def test_a_regression_has_no_time_to_simulate(driven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contents = result({}, ("x",))
    contents["equations"] = [result({"y": "2*x"}, ("x",))["equations"][0] | {"lhs": "y"}]
    contents["system"]["kind"] = "regression"
    (driven / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(driven)]) == 2
    assert "regression without time" in capsys.readouterr().err


def test_the_drift_of_a_process_is_simulated_with_the_band_of_its_own_constants(
    driven: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = result({"x": "0.5 - x"}, process={"step": 0.1})
    diffusion = result({"x": "0.25"})["equations"][0] | {"variable": "[x]", "lhs": "d[x]/dt"}
    contents["equations"].insert(0, diffusion)
    names = [{"variable": "[x]", "constant": 0}, {"variable": "x", "constant": 0}]
    contents["covariance"] = {"constants": names, "matrix": [[9.0, 0.5], [0.5, 0.01]], "freedom": None}
    (driven / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(driven), "--initial", "x=0.5", "--until", "40", "--step", "40"]) == 0
    said = capsys.readouterr()
    last = [float(cell) for cell in said.out.splitlines()[-1].split(",")]
    assert last == pytest.approx([40.0, 0.5, 0.5 - 0.196, 0.5 + 0.196], abs=1e-3)
    assert "without the noise" in said.err


def test_an_early_end_is_said_and_is_no_error(driven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (driven / "result.json").write_text(json.dumps(result({"x": "x**2"})))
    words = ["simulate", str(driven), "--initial", "x=1", "--until", "2", "--step", "0.5"]
    assert main([*words, "--json", "-o", str(driven / "o.json")]) == 0
    written = json.loads((driven / "o.json").read_text())
    assert written["status"] == "blow-up"
    assert written["columns"]["t"] == [0.0, 0.5]
    assert "ended early: a state grows without bounds" in capsys.readouterr().err


def test_paths_of_a_process_are_written_as_bounds_or_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "result.json").write_text(json.dumps(process_result()))
    words = ["simulate", str(tmp_path), "--until", "0.2", "--step", "0.1"]
    assert main([*words, "--paths", "3", "--seed", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines[:2], len(lines)) == (["t,x_mean,x_lower,x_median,x_upper", "0.0,2.0,2.0,2.0,2.0"], 4)
    assert main([*words, "--paths", "3", "--seed", "5", "--each-path"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()]
    assert (rows[0], rows[4][:2], len(rows)) == (["trajectory", "t", "x"], ["2", "0.0"], 10)
    assert float(lines[2].split(",")[1]) == pytest.approx(
        np.mean([float(row[2]) for row in (rows[2], rows[5], rows[8])])
    )
    assert main([*words, "--paths", "2", "--json", "--each-path"]) == 0
    assert len(json.loads(capsys.readouterr().out)["states"]["x"]) == 2
    assert main(words) == 0
    assert "the drift was simulated without the noise of the process; --paths" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "words", "sentence"),
    [
        ({"data": None}, ["--initial", "x=1"], "the last time of the simulation is not known; give --until"),
        ({"data": None}, ["--until", "3"], "no fitted initial state; give one, such as --initial x=1"),
        (
            {"equations": [{"groups": [{"group": "a", "expression": "2*x"}]}], "groups": [{"group": "a"}]},
            ["--until", "3"],
            "between its groups (a); choose one with --group",
        ),
    ],
)
def test_advice_is_in_the_words_of_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict, words: list[str], sentence: str
) -> None:
    contents = result({"x": "-x"})
    contents |= changes | {
        "equations": [contents["equations"][0] | equation for equation in changes.get("equations", [{}])]
    }
    (tmp_path / "result.json").write_text(json.dumps(contents))
    assert main(["simulate", str(tmp_path), *words]) == 2
    assert capsys.readouterr().err.endswith(f"{sentence}\n")


SIDES = ["--box", "x=-2:2,y=-1:2"]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Return a folder with a result: x' = 0.5 x - x**3 + u, y' = -y, measured on its way to (1/sqrt 2, 0)."""
    times = np.linspace(0.0, 20.0, 200)
    course = {"x": (2.0 + 2.0 * np.exp(-times)) ** -0.5, "y": np.exp(-times)}
    curves = {name: values.tolist() for name, values in course.items()}
    simulation = {"trajectories": [{"name": "a", "times": times.tolist(), "values": curves}]}
    contents = result({"x": "0.5*x - x**3 + u", "y": "-y"}, ("u",), simulation=simulation)
    recorded = {"name": "a", "times": times.tolist(), "measured": curves, "inputs": {"u": [0.0] * 200}}
    contents["data"]["trajectories"] = [recorded]
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


@pytest.mark.slow
def test_json_lists_fixed_points_in_the_order_of_the_states(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", str(saved), *SIDES, "--parameter", "c1", "--range", "-1:1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["states"] == ["x", "y"]
    points = [(point["point"], point["kind"]) for point in printed["fixed_points"]]
    root = 0.5**0.5
    assert [kind for _, kind in points] == ["stable node", "saddle", "stable node"]
    np.testing.assert_allclose([point for point, _ in points], [[-root, 0.0], [0.0, 0.0], [root, 0.0]], atol=1e-9)
    special = [point for branch in printed["continuation"]["branches"] for point in branch["special"]]
    assert {point["kind"] for point in special} == {"branch point"}
    assert set(printed["nullclines"]) == {"x", "y"}
    assert np.shape(printed["basins"]["grid"]) == (40, 40)


def test_inputs_are_held_and_files_written(saved: Path) -> None:
    out = saved / "out.json"
    assert main(["analyse", str(saved), *SIDES, "--hold", "u=1.5", "--json", "-o", str(out)]) == 0
    written = json.loads(out.read_text())
    assert written["inputs"] == {"u": 1.5}
    x = written["fixed_points"][0]["point"][0]
    assert 0.5 * x - x**3 + 1.5 == pytest.approx(0.0, abs=1e-9)


def test_identifiability_is_that_of_the_measurements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    times = np.linspace(0.0, 5.0, 20)
    decay = 3.0 * np.exp(-0.6 * times) + 0.02 * np.random.default_rng(1).standard_normal(20)
    (tmp_path / "result.json").write_text(json.dumps(measured({"x": "-0.5*x"}, [(times, {"x": decay})], 0.02)))
    asked = ["analyse", str(tmp_path), "--box", "x=0:4"]
    assert main([*asked, "--identifiability", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (constant,) = printed["identifiability"]["constants"]
    assert (constant["name"], constant["verdict"]) == ("c1", "determined")
    assert printed["fixed_points"]
    (tmp_path / "a.csv").write_text("t,x\n" + "\n".join(f"{t},{x}" for t, x in zip(times, decay, strict=True)))
    assert main([*asked, "--identifiability", "--data", str(tmp_path / "a.csv")]) == 0
    said = capsys.readouterr().out
    assert "identifiability (95 % profile likelihood; the given data):" in said
    assert main([*asked, "--data", str(tmp_path / "a.csv")]) == 2
    assert "--data was given without --identifiability" in capsys.readouterr().err
    assert main([*asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["identifiability"] is None


@pytest.fixture
def found(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text(json.dumps(FOUND))
    return tmp_path


def test_json_is_that_of_the_model_and_goes_into_a_file(found: Path) -> None:
    out = found / "out.json"
    words = ["suggest", str(found), "--box", "x=0.1:20", "--count", "1", "--samples", "6", "--duration", "1.5"]
    assert main([*words, "--seed", "3", "--json", "-o", str(out)]) == 0
    written = json.loads(out.read_text())
    assert written == Model(FOUND).suggest(WIDE, count=1, samples=6, duration=1.5, seed=3).as_dict()
    (first,) = written["experiments"]
    assert len(first["times"]) == 6
    assert first["times"][-1] == 1.5


def test_text_names_candidates_bounds_and_experiments(found: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = zip(TIMES.tolist(), FOUND["data"]["trajectories"][0]["measured"]["x"], strict=True)
    (found / "a.csv").write_text("t,x\n" + "\n".join(f"{time},{value}" for time, value in rows))
    words = ["suggest", str(found), "--data", str(found / "a.csv"), "--rival", "dx=-x + 0.1*x**2", "--cost", "samples"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.startswith("candidates, with constants fitted again (the given data):")
    assert re.search(r"\(given, Δ description length [\d.e+-]+\)  dx/dt = ", said)
    assert "(of the data, smoothed)" in said
    assert "experiment 1: x = " in said
    assert "per unit of samples" in said


@pytest.fixture
def regressed(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text(json.dumps(regression()), "utf-8")
    return tmp_path


def test_the_page_stands_beside_the_result_or_where_it_is_wanted(
    regressed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(regressed)]) == 0
    assert capsys.readouterr() == ("", f"report in {regressed / 'report.html'}\n")
    assert main(["report", str(regressed / "result.json"), "-o", str(regressed / "page.html")]) == 0
    assert (regressed / "page.html").read_text("utf-8") == (regressed / "report.html").read_text("utf-8")


def test_several_results_have_a_page_each_and_one_that_is_none_keeps_no_other_from_it(
    regressed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (regressed / "result.json").read_text("utf-8")
    for name, contents in (("a", text), ("b", "no JSON"), ("c", text)):
        (regressed / name).mkdir()
        (regressed / name / "result.json").write_text(contents, "utf-8")
    runs = [str(regressed / name) for name in "abc"]
    assert main(["report", *runs]) == 2
    printed = capsys.readouterr().err.splitlines()
    assert printed[0] == f"report in {regressed / 'a' / 'report.html'}"
    assert printed[1].startswith(f"coordinator: {regressed / 'b'}")
    assert (regressed / "c" / "report.html").exists()
    assert main(["report", "nothing", runs[2]]) == 2
    printed = capsys.readouterr().err.splitlines()
    assert printed[0].startswith("coordinator: nothing is not a saved result")
    assert printed[1] == f"report in {regressed / 'c' / 'report.html'}"
    assert main(["report", runs[0], runs[2]]) == 0
    assert main(["report", runs[0], runs[2], "-o", "page.html"]) == 2
    assert "--output names one file or folder, but 2 results were given" in capsys.readouterr().err
    assert main(["report", runs[0], f"{runs[0]}/result.json"]) == 2
    assert "two of these results would be written to" in capsys.readouterr().err


def test_a_result_whose_texts_no_page_can_hold_has_one(regressed: Path) -> None:
    contents = regression()
    contents["equations"][0]["lhs"] = "dy\x01/dt"
    (regressed / "result.json").write_text(json.dumps(contents), "utf-8")
    assert main(["report", str(regressed)]) == 0
    assert r"dy\x01/dt" in (regressed / "report.html").read_text("utf-8")


def test_pictures_are_files_that_need_no_page(regressed: Path) -> None:
    assert main(["report", str(regressed), "--pictures", str(regressed / "pictures")]) == 0
    assert sorted(path.name for path in (regressed / "pictures").iterdir()) == ["fit-1.svg", "fit-2.svg", "front-1.svg"]
    root = ElementTree.parse(regressed / "pictures" / "fit-1.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert ".line" in (root[0].text or "")


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"schema": 1}', '{"schema": 2, "equations": []}'])
def test_what_is_no_result_ends_with_a_sentence(regressed: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (regressed / "result.json").write_text(text, "utf-8")
    assert main(["report", str(regressed)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"coordinator: {regressed / 'result.json'}")
    assert printed.err.count("\n") == 1
    assert not (regressed / "report.html").exists()


@pytest.fixture
def decaying(tmp_path: Path) -> Path:
    contents = decay()
    other = {"expression": "-0.4", "complexity": 1, "nats": 9.0, "origin": "library", "selected": False}
    contents["equations"][0]["candidates"] = [other]
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def test_a_result_is_compared_with_its_candidate(decaying: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(decaying), ":1"]) == 0
    text = capsys.readouterr().out
    assert f"B = {decaying}:1: dx/dt = -0.4" in text
    assert "The data decide for A" in text
    assert main(["compare", str(decaying / "result.json"), f"{decaying}:1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["B"]["equations"] == {"dx/dt": "-0.4"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((":1", "{}"), "A is ':1', but the name of a result was expected, such as runs/JOB:1"),
        (("{}", ":2"), "has no candidate 2: it has candidates 1 to 1"),
        (("{}", "{}/nothing"), "cannot be read"),
    ],
)
def test_what_is_no_result_is_a_sentence(
    decaying: Path, words: tuple[str, str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *(word.format(decaying) for word in words)]) == 2
    assert sentence in capsys.readouterr().err


def test_states_and_forecasts_are_tables_with_sentences_and_pictures(
    decaying: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb, words in (("smooth", []), ("forecast", ["--for", "2", "--step", "1", "--seed", "3"])):
        picture = decaying / f"{verb}.svg"
        assert main([verb, str(decaying), *words, "--picture", str(picture)]) == 0
        printed = capsys.readouterr()
        assert printed.out.startswith("trajectory,t,piece,x" if verb == "smooth" else "t,x,x_lower,x_upper")
        assert printed.err.startswith("coordinator: ")
        assert ElementTree.parse(picture).getroot().tag == "{http://www.w3.org/2000/svg}svg"
        assert main([verb, str(decaying), *words, "--json", "-o", str(decaying / "out.json")]) == 0
        assert json.loads((decaying / "out.json").read_text())["schema"] == 1
        assert capsys.readouterr().out == ""


def test_a_forecast_begins_at_the_last_row_of_the_given_data(
    decaying: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{t:.6g},{2.0 * np.exp(-0.5 * t):.6g}" for t in np.linspace(0.0, 6.0, 25)]
    (decaying / "new.csv").write_text("\n".join(["t,x", *rows]))
    words = ["--for", "2", "--step", "2", "--data", str(decaying / "new.csv"), "--json"]
    assert main(["forecast", str(decaying), *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["columns"]["t"] == [6.0, 8.0]
    assert found["columns"]["x"] == pytest.approx([2.0 * np.exp(-3.0), 2.0 * np.exp(-4.0)], abs=0.01)


def test_inputs_after_the_last_row_come_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.linspace(0.0, 4.0, 40)
    columns = {"x": 1.0 + 0.01 * np.sin(37.0 * t), "u": np.ones(40)}
    contents = measured({"x": "1.0*u-1.0*x"}, [(t, columns)], 0.01, ("u",))
    (tmp_path / "result.json").write_text(json.dumps(contents))
    (tmp_path / "inputs.csv").write_text("t,u\n4.001,3\n9,3\n")
    words = ["--for", "10", "--json", "--inputs", str(tmp_path / "inputs.csv")]
    assert main(["forecast", str(tmp_path), *words]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["columns"]["x"][-1] == pytest.approx(3.0, abs=0.1)
    assert "the values of the input u end at t = 9; it keeps the last one" in printed.err
    (tmp_path / "other.csv").write_text("t,v\n5,3\n9,3\n")
    assert main(["forecast", str(tmp_path), "--for", "10", "--inputs", str(tmp_path / "other.csv")]) == 2
    assert "a column of an input (u) are needed" in capsys.readouterr().err


@pytest.fixture
def exportable(tmp_path: Path) -> Path:
    contents = result({"x": "u*x"}, ("u",))
    contents["simulation"] = {"trajectories": [{"name": "1", "start": {"x": 2.0}, "times": [0.0, 1.0]}]}
    expression = {"expression": "u*x/3.5", "nats": 2.0, "complexity": 7, "origin": "library", "selected": False}
    figures = {"error": 0.5, "normalized_error": 0.5, "r2": 0.5, "constants": [], "holdout_error": None}
    member = {"expression": "-0.75*x", "complexity": 3, "selected": False, **figures}
    contents["equations"][0] |= {"candidates": [expression], "front": [member], "why": "target", "target_error": 0.1}
    (tmp_path / "result.json").write_text(json.dumps(contents))
    return tmp_path


def exported(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["export", *words]) == 0
    return capsys.readouterr().out


def test_export_takes_state_times_and_inputs_from_a_file(exportable: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (exportable / "a.csv").write_text("t,x,u\n0,3,0\n1,9,0\n2,9,0\n")
    text = exported(capsys, str(exportable), "--format", "python", "--initial", str(exportable / "a.csv"))
    names = run_python(text)
    assert names["TIMES"].tolist() == [0.0, 1.0, 2.0]
    assert names["simulate"]().tolist() == [[3.0], [3.0], [3.0]]


def test_an_input_of_which_nothing_is_given_is_said_to_be_held(
    exportable: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(exportable), "--format", "python"]) == 0
    assert "set to 0, because no value is given: u;" in capsys.readouterr().err
    assert main(["export", str(exportable), "--format", "python", "--hold", "u=0"]) == 0
    assert capsys.readouterr().err == ""


def test_a_folder_is_written(exportable: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (exportable / "a.csv").write_text("t,x\n0,3\n1,9\n2,9\n3,1\n4,1\n5,2\n6,1\n7,1\n")
    contents = json.loads((exportable / "result.json").read_text())
    (exportable / "result.json").write_text(json.dumps(contents | result({"x": "-0.5*x"})))
    words = ("--format", "petab", "-o", str(exportable / "problem"), "--data", str(exportable / "a.csv"))
    assert exported(capsys, str(exportable), *words) == ""
    assert len((exportable / "problem" / "measurements.tsv").read_text().splitlines()) == 9


def test_what_needs_no_model_is_written_of_a_result_without_one(
    exportable: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = json.loads((exportable / "result.json").read_text())
    contents["equations"][0]["expression"] = None
    (exportable / "result.json").write_text(json.dumps(contents))
    assert Result.load(json.loads(exported(capsys, str(exportable), "--format", "json"))) == Result.load(exportable)
    assert exported(capsys, str(exportable), "--format", "csv").splitlines()[1].endswith("-0.75*x")
    assert main(["export", str(exportable), "--format", "c"]) == 2
    assert "lacks an equation" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["c", "latex", "sympy"])
def test_the_heading_of_one_group_names_it(exportable: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    contents = result({"x": "-0.9*x"}, groups=[{"group": "a\nb", "trajectories": ["1"], "covariance": None}])
    contents["equations"][0]["groups"] = [{"group": "a\nb", "expression": "-0.6*x"}]
    (exportable / "result.json").write_text(json.dumps(contents))
    words = (str(exportable), "--format", name, "--group", "a\nb")
    start = () if name != "c" else ("--initial", "x=1", "--until", "2")
    text = exported(capsys, *words, *start)
    member = {"expression": "-0.75*x", "complexity": 3, "selected": False, "error": 0.5, "normalized_error": 0.5}
    contents["equations"][0] |= {"front": [member | {"r2": 0.5, "constants": []}], "why": "target", "target_error": 0.1}
    (exportable / "result.json").write_text(json.dumps(contents))
    picked = exported(capsys, *words, *start, "--pick", "x=0")
    assert "the constants of dx/dt belong to all groups together." in picked
    assert "0.75" in picked
    assert "Constants belong to group a b." in text
    assert "0.6" in text


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text(json.dumps(process_result()))
    return tmp_path


@pytest.mark.parametrize(
    ("result_of", "verb", "words", "sentence"),
    [
        ("driven", "simulate", "--initial x=a", "must be a finite number"),
        ("driven", "simulate", "--initial nothing.csv", "must be numbers such as"),
        ("driven", "simulate", "--initial y=1", "state has 'y'"),
        ("driven", "simulate", "--until -1", "must be after the first time"),
        ("driven", "simulate", "--step 0", "must be above 0"),
        ("saved", "analyse", "--box x=3", "--box x must be LOWER:UPPER"),
        ("saved", "analyse", "--box x=3:1", "must have LOWER below UPPER"),
        ("saved", "analyse", "--box x=0:inf", "must be a finite number"),
        ("saved", "analyse", "--box z=0:1", "the box has 'z'"),
        ("saved", "analyse", "--box x=0:1,x=0:2", "names 'x' twice"),
        ("saved", "analyse", "--hold v=1", "no input 'v'"),
        ("saved", "analyse", "--parameter c9 --range 0:1", "no parameter 'c9'; the model has c1 = 0.5 of x"),
        ("saved", "analyse", "--parameter c1", "without --range"),
        ("found", "suggest", "--box z=0:1", "the bounds have 'z'"),
        ("found", "suggest", "--box x=1", "--box x must be LOWER:UPPER"),
        ("found", "suggest", "--cost money", "the cost must be trajectory, duration or samples"),
        ("found", "suggest", "--samples 2.5", "--samples must be a whole number"),
        ("found", "suggest", "--duration soon", "--duration must be a finite number"),
        ("found", "suggest", "--rival x", "--rival must be dx=EXPR"),
        ("found", "suggest", "--rival ;", "--rival must be dx=EXPR, but an empty text was given"),
        ("found", "suggest", "--rival dx=z", "z"),
        (
            "exportable",
            "export",
            "--format petab",
            "petab is a folder of several files; name the folder with -o FOLDER",
        ),
        (
            "exportable",
            "export",
            "--format c --candidate 2",
            "--candidate 2 does not exist; the result has 1 candidates",
        ),
        ("exportable", "export", "--format c --candidate 1 --pick x=0", "both choose equations"),
        ("exportable", "export", "--format c --hold v=1", "--hold names 'v'; the inputs are u"),
        ("exportable", "export", "--format c --data a.csv", "--data was given without --format petab"),
        ("exportable", "export", "--format fortran", "but 'fortran' was given"),
        ("decaying", "forecast", "--for x", "--for must be a finite number"),
        ("decaying", "forecast", "--for -1", "the duration of a forecast must be above 0"),
        ("decaying", "forecast", "--for 1 --draws x", "--draws must be a whole number"),
        ("decaying", "forecast", "--for 1 --trajectory 7", "there is no trajectory '7'"),
        ("decaying", "forecast", "--for 1 --group a", "the model has no groups"),
        ("driven", "forecast", "--for 1", "the result has no measurements; give the data file with --data"),
        ("driven", "smooth", "", "the result has no measurements; give the data file with --data"),
        ("noisy", "smooth", "", "only models of measured trajectories can be fitted again"),
        ("regressed", "forecast", "--for 1", "a regression"),
        ("noisy", "simulate", "--seed 1", "--seed needs --paths"),
        ("noisy", "simulate", "--each-path", "--each-path needs --paths"),
        ("noisy", "simulate", "--paths x", "--paths must be a whole number, but 'x' was given"),
        ("noisy", "simulate", "--paths 0", "paths must be a whole number of at least 1"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_sentence(
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
    result_of: str,
    verb: str,
    words: str,
    sentence: str,
) -> None:
    assert main([verb, str(request.getfixturevalue(result_of)), *words.split()]) == 2
    said = capsys.readouterr().err
    assert said.startswith("coordinator: ")
    assert sentence in said
    assert said.count("\n") == 1
