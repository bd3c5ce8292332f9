"""The page of a result shows what the result holds, loads nothing, and takes every name for text."""

from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from atoll.analysis.analysis import TextTable, describe
from atoll.api.model import Model
from atoll.experiments.identifiability import Direction, Identifiability, ProfiledConstant
from atoll.experiments.suggestion import CandidateSystem, Suggestion, Suggestions
from atoll.model.simulation import ExtrapolationWarning
from atoll.report.equations import choice, constants, origin, overview
from atoll.report.findings import MOST_PROFILES, Findings
from atoll.report.markup import Element, table, to_text
from atoll.report.page import as_html
from atoll.report.trajectories import dynamics as section_of_dynamics
from atoll.report.trajectories import trajectories
from atoll.text.conclusion import conclusion
from atoll_coordinator.result.result import Result
from tests.unit.library.report.results import dynamics, process, regression


class Reader(HTMLParser):
    """Collects the tags, the texts of cells, and the identifiers of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.links: list[str] = []
        self.sections: list[str] = []
        self.texts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        attributes = dict(attrs)
        self.links += [str(attributes[name]) for name in ("href", "src") if name in attributes]
        if tag == "section":
            self.sections.append(str(attributes["id"]))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def page() -> Reader:
    return Reader(as_html(Result.of(dynamics())))


def test_all_that_is_known_of_dynamics_has_a_section(page: Reader) -> None:
    expected = [
        "found",
        "fit",
        "residuals",
        "errors",
        "constants",
        "candidates",
        "front",
        "dynamics",
        "search",
        "origin",
    ]
    assert page.sections == expected
    assert page.links == ["data:,", *(f"#{name}" for name in expected)]


def test_nothing_is_loaded_and_no_script_runs(page: Reader) -> None:
    assert not {"script", "img", "iframe", "object"} & page.tags
    assert {"math", "svg", "table", "details"} <= page.tags


def test_numbers_stand_behind_the_pictures(page: Reader) -> None:
    assert {"1.25", "0.25", "1e-09", "x - y", "2.5", "yes"} <= set(page.texts)  # fit, residual, front, candidate


def test_what_repeats_a_run_is_not_the_clock() -> None:
    contents = dynamics()
    assert any(
        "same digest on any number" in text and "clock" not in text
        for text in read([origin(Findings(Result.of(contents), None))]).texts
    )
    contents["equations"][0] |= {"why": "max-time", "epoch": 12}
    assert any(
        "--max-epochs x=12 instead of --max-time" in text
        for text in read([origin(Findings(Result.of(contents), None))]).texts
    )


def test_an_equation_that_was_not_found_leaves_the_rest_of_the_page() -> None:
    contents = dynamics(simulation=None)
    contents["equations"][1] |= {"expression": None, "verdict": "no model", "reason": "Nothing.", "front": []}
    page = Reader(as_html(Result.of(contents)))
    assert "dy/dt: no equation" in page.texts
    assert any("not analysed" in text for text in page.texts)


def read(sections: list[Element]) -> Reader:
    return Reader("".join(map(to_text, sections)))


def test_a_page_says_what_the_equation_of_noise_is() -> None:
    said = "d[x]/dt is the variance that noise adds to the state x per unit of time."
    assert said in read([overview(Findings(Result.of(process()), None))]).texts
    assert said not in read([overview(Findings(Result.of(dynamics()), None))]).texts


def test_columns_without_any_entry_are_left_out() -> None:
    page = read([table("some", ["name", "never", "value"], [["a", "", "1"], ["b", "", ""]])])
    assert page.texts == ["some", "name", "value", "a", "1", "b"]
    assert "never" in read([table("none", ["never"], [])]).texts


def test_many_constants_are_not_profiled_for_a_page() -> None:
    contents = dynamics()
    contents["equations"][0]["constants"] *= MOST_PROFILES + 1
    page = read(constants(Findings(Result.of(contents), None)))
    assert any("coordinator analyse --identifiability" in text for text in page.texts)


def test_profiles_say_what_the_data_determine_of_each_constant() -> None:
    values, ends = np.array([1.0, 2.0, 3.0]), (1.25, 2.75)
    constant = ProfiledConstant(
        "c1", "x", True, 2.0, 0.25, ends, ends, "open above", (False, False), values, values - 1.0
    )
    open_one = Direction(9.0, values, True, "only c1/c2 is determined")
    findings = Findings(
        Result.of(dynamics()), None, identifiability=Identifiability(0.95, 9.0, 2.0, (constant,), (open_one,), "", 3)
    )
    page = read(constants(findings))
    assert {"c1 = 2, open above: at least 1.25", "only c1/c2 is determined"} <= set(page.texts)
    assert "svg" in page.tags


def test_constants_are_called_as_those_of_the_model() -> None:
    contents = dynamics(correlations=[{"first": {"variable": "x", "constant": 0}, "value": -0.99,
                                    "second": {"variable": "y", "constant": 0}}])  # fmt: skip
    contents["equations"][1]["constants"] = [{**contents["equations"][1]["constants"][0], "value": 2.0}]
    page = read(constants(Findings(Result.of(contents), None)))
    names = [name for name, param in Model(contents).params.items() if param.stderr is not None]
    assert [text for text in page.texts if text in Model(contents).params] == names
    assert f"{names[0]} and {names[1]} are strongly correlated: correlation -0.99." in page.texts


SURE = "decides between the two with more than 99.9 % certainty"


def test_the_next_experiment_stands_with_the_candidates() -> None:
    rivals = tuple(CandidateSystem({"dx/dt": text}, "candidate", 0.5, 0.0) for text in ("x", "2*x"))
    one = Suggestion({"x": 1.5}, {"u": 2.5}, (0.0, 4.0), 1.0, 3.0, 0.625, 7.5, None, (0.9996,))
    suggestions = Suggestions("discrimination", "2 candidates differ", 0.7, rivals, (one,), {}, (), "trajectory", "")
    page = read(choice(Findings(Result.of(dynamics()), None, suggestions=suggestions)))
    said = {"x = 1.5, u = 2.5", "2 samples from 0 to 4", SURE, "dx/dt = 2*x", "candidate, Δ description length 0"}
    assert said <= set(page.texts)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contents", "section", "number"), [(regression(), "fit", "0.5"), (process(), "process", "0.75")]
)
def test_regressions_and_processes_have_sections_of_their_own(
    contents: dict[str, Any], section: str, number: str
) -> None:
    page = Reader(as_html(Result.of(contents)))
    assert section in page.sections
    assert number in page.texts
    assert ("dynamics" in page.sections) == (section == "process")


def of_groups() -> dict[str, Any]:
    """Return the result of two species, x growing at 2.5 in group a and at 3.5 in group <b>."""
    contents = dynamics()
    equation = contents["equations"][0]
    mean, whole = equation["constants"][0], equation["expression"]
    equation["groups"] = [
        {
            "group": name,
            "expression": whole.replace("3.0", str(value)),
            "constants": [{**mean, "value": value, "std_error": 0.25}],
        }
        for name, value in (("a", 2.5), ("<b>", 3.5))
    ]
    contents["groups"] = [{"group": name, "trajectories": ["1"], "covariance": None} for name in ("a", "<b>")]
    return contents


def test_constants_of_each_group_are_listed() -> None:
    read = Reader(as_html(Result.of(of_groups())))
    place = read.texts.index("<b>")
    assert read.texts[read.texts.index("a") : place + 2].count("2.5") == 1
    assert "3.5" in read.texts[place : place + 4]
    assert "0.25" in read.texts[place : place + 6]
    assert any(
        "differ between the groups a, <b>; analyse one with coordinator report --group NAME" in text
        for text in read.texts
    )
    assert any("means over them; the groups are a, <b>." in text for text in read.texts)


@pytest.mark.slow
def test_the_page_of_one_group_is_analysed() -> None:
    findings = Findings.of(Model(of_groups()).of_group("<b>").result)
    assert findings.analysis is not None
    assert findings.analysis.field.values(np.array([[1.0, 0.0]]))[0, 0] == pytest.approx(2.5)
    assert "<b>" in Reader(to_text(overview(findings))).texts


def test_figures_have_the_digits_that_their_errors_leave() -> None:
    contents = dynamics()
    contents["equations"][0]["constants"][0] |= {"std_error": 0.00016, "interval": [1.999562, 2.000193]}
    (part,) = contents["simulation"]["trajectories"]
    part["r2"] = {"x": 0.99999919, "y": 1.0}
    contents["equations"][0]["candidates"][0]["r2"] = 0.99999919
    findings = Findings(Result.of(contents), None)
    assert "1.99956 to 2.00019" in to_text(constants(findings)[0])
    assert "R² at least 0.9999" in to_text(overview(findings))
    assert all(">0.9999<" in to_text(section) for section in (trajectories(findings)[0], choice(findings)[0]))


@pytest.mark.slow
def test_dynamics_of_equations_that_do_not_fit_are_said_to_be_so() -> None:
    contents = dynamics()
    contents["equations"][1]["verdict"] = "no model"
    analysis = Model(contents).analyse()
    assert str(analysis).startswith('The verdict on dy/dt is "no model":')
    section = to_text(section_of_dynamics(Findings(Result.of(contents), Model(contents), analysis))[0])
    assert section.index('The verdict on dy/dt is "no model":') < section.index("<svg")


def test_a_page_lists_of_the_dynamics_what_the_text_lists() -> None:
    analysis = Model(dynamics()).analyse()
    listings = [part for part in describe(analysis) if isinstance(part, TextTable)]
    page = read(section_of_dynamics(Findings(Result.of(dynamics()), Model(dynamics()), analysis)))
    assert {cell for part in listings for row in part.rows for cell in row.cells} <= set(page.texts)
    assert all(row.line in str(analysis) for part in listings for row in part.rows)
    assert {"stable node, outside the box", "Limit cycles: 0 (26 simulations)."} <= set(page.texts)


def test_constants_of_the_result_stand_beside_those_fitted_again() -> None:
    shown = CandidateSystem({"dx/dt": "2.5*x"}, "shown", 1.0, 0.0, written={"dx/dt": "2*x"})
    suggestions = Suggestions("precision", "there is one", 0.0, (shown,), (), {}, (), "trajectory", "1 trajectory")
    lines = str(suggestions).splitlines()
    assert "fitted again" in lines[0]
    assert lines[2].strip() == "with the constants of the result  dx/dt = 2*x"
    text = to_text(choice(Findings(Result.of(dynamics()), None, suggestions=suggestions))[0])
    assert "shown, with the constants of the result" in text
    assert "2*x" in text


HOSTILE = (
    "'\"><script>alert(1)</script><img src=x onerror=alert(1)></title></style>&<![CDATA[\\href{javascript:alert(1)}{x}"
)
KEPT = {"expression", "program", "kind", "discretisation", "group", "variable"}
"""What is read again, not shown: formulas, kinds, and names by which parts of a result find each other."""


def hostile(value: Any, key: str = "") -> Any:
    """Return a part of a result with that text in every text that it may be in, and in names of columns."""
    if isinstance(value, dict):
        return {HOSTILE + name if name in {"x", "y"} else name: hostile(item, name) for name, item in value.items()}
    if isinstance(value, list):
        return [hostile(item, key) for item in value]
    if key in {"variable", "lhs", "states", "time", "inputs", "target"} and isinstance(value, str):
        return value.replace("x", HOSTILE + "x").replace("y", HOSTILE + "y") if key != "time" else HOSTILE
    return HOSTILE if isinstance(value, str) and key not in KEPT | {"x", "y"} else value


def dangers(text: str) -> list[str]:
    """Return what of markup would run or load something."""
    texts = []

    class Watch(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            scripts = [
                name for name, value in attrs if name.startswith("on") or "javascript:" in str(value).split("=")[0]
            ]
            if tag in {"script", "img", "iframe", "object", "embed"} or scripts:
                texts.append(f"{tag} {scripts}")

    Watch().feed(text)
    return texts


@pytest.mark.parametrize("kind", [dynamics, regression, process])
def test_no_text_of_a_result_is_taken_for_markup(kind: Any) -> None:
    assert dangers(HOSTILE)
    contents = hostile(kind())
    model = Model(contents)
    page = as_html(Result.of(contents))
    for text in (model._repr_html_(), model.mathml(), page):
        assert dangers(text) == []
    assert page.count("&lt;script&gt;") > 20
    assert r"\href" not in model.latex()


def test_simple_numbers_together_have_a_sentence_below_the_constants() -> None:
    contents = dynamics()
    together = {"constants": [0], "values": [3.0], "odds": 14.7, "chi_square": 0.61}
    contents["equations"][0]["simple_together"] = together
    page = read(constants(Findings(Result.of(contents), None)))
    assert "c1 = 3, judged together: odds 15 against all other numbers (chi-square 0.61)." in page.texts


def test_a_page_begins_with_what_was_found_for_people_who_do_not_know_the_terms() -> None:
    contents = dynamics()
    contents["equations"][1] |= {"verdict": "doubtful"}
    page = read([overview(Findings(Result.of(contents), None))])
    assert page.texts[:2] == [
        "Found",
        "Atoll searched in 3 rows of a.csv for equations that describe how fast x and y change. dx/dt is the change of "
        "x per unit of t. Do not rely on predictions of the equation of dy/dt yet: another equation may be right. "
        "Within the measured range, predictions of the equation of dx/dt can be trusted.",
    ]


@pytest.mark.parametrize(
    ("time", "unit", "words"),
    [
        ("t", "ms", "per millisecond."),
        ("t", "d", "per day."),
        ("t", "furlong", "per furlong."),
        ("Weeks", "", "per week."),
        ("year", "", "per year."),
        ("t", "", "per unit of t."),
    ],
)
def test_a_rate_is_said_in_words_of_its_time(time, unit, words) -> None:
    contents = dynamics()
    contents["system"] |= {"time": time, "units": {time: unit} if unit else {}}
    contents["equations"][0]["lhs"] = f"dx/d{time}"
    assert f"dx/d{time} is the change of x {words}" in conclusion(Result.of(contents))


def test_what_was_found_has_its_errors_its_checks_as_a_list_and_notes_apart_from_warnings() -> None:
    note = "The search sees 8 of 80 rows, spread evenly; models are judged by all."
    contents = dynamics(warnings=["Some measurements look like outliers.", note], notes=[note])
    contents["equations"][0]["checks"] = [
        {"name": "time", "outcome": "passed", "reason": "nothing was stopped"},
        {"name": "poles", "outcome": "failed", "reason": "it passes 2"},
        {"name": "long run", "outcome": "not made", "reason": "not simulated"},
        {"name": "constants", "outcome": "not made", "reason": "not simulated"},
    ]
    texts = read([overview(Findings(Result.of(contents), None))]).texts
    assert "Constants: 3 (3.00 ± 0.10)" in texts
    checks = texts.index("Checks: 1 of 4 passed:")
    assert texts[checks + 1 : checks + 6] == [
        "poles: failed.", " it passes 2", "long run, constants: not made.", " not simulated", "The other checks",
    ]  # fmt: skip
    assert texts[texts.index("Warnings") + 1] == "Some measurements look like outliers."
    assert texts[texts.index("Notes") + 1] == note


def test_rates_are_written_with_the_name_of_the_time() -> None:
    contents = dynamics()
    contents["system"]["time"] = "year"
    model = Model(contents)
    page = read(section_of_dynamics(Findings(Result.of(contents), model, model.analyse())))
    assert {"dx/dyear = 0", "dy/dyear = 0"} <= set(page.texts)


def test_lines_of_a_fit_bend_and_say_where_they_start() -> None:
    contents = dynamics()
    (part,) = contents["simulation"]["trajectories"]
    times = [0.0, 1.0, 2.0]
    with pytest.warns(ExtrapolationWarning):
        simulation = Model(contents).simulate(x0={"x": 1.0, "y": 3.0}, t=times)
    part |= {"times": times, "values": {name: simulation[name].tolist() for name in ("x", "y")}}
    part |= {"lower": None, "upper": None, "measured": part["measured"]}
    findings = Findings(Result.of(contents), Model(contents))
    text = to_text(trajectories(findings)[0])
    assert "Lines are simulated by the model, from one fitted initial state." in text
    assert max(line.count("L") for line in text.split('d="')) > 10
    part["values"]["y"][1] += 1.0
    assert "in pieces" in to_text(trajectories(Findings(Result.of(contents), Model(contents)))[0])
    assert "simulated by the model." in to_text(trajectories(Findings(Result.of(contents), None))[0])
