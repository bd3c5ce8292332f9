"""The page of a result shows what the result holds, loads nothing, and takes every name for text."""

from html.parser import HTMLParser
from typing import Any

import pytest

from atoll.report.page import as_html
from tests.unit.common.report.results import dynamics, process, regression


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
        found = dict(attrs)
        self.links += [str(found[name]) for name in ("href", "src") if name in found]
        if tag == "section":
            self.sections.append(str(found["id"]))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def page() -> Reader:
    return Reader(as_html(dynamics()))


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


def test_fixed_points_are_listed_with_their_kinds(page: Reader) -> None:
    assert {"(1, 1)", "saddle", "(3, 0)", "stable node"} <= set(page.texts)


def test_names_from_data_are_text_wherever_they_stand() -> None:
    hostile = "<img src=x onerror=alert(1)>"
    found = dynamics(warnings=[hostile], command=hostile, job=hostile)
    found["data"]["files"] = [hostile]
    found["system"] |= {"time": hostile, "states": [hostile, "y"]}
    found["symbols"] = {hostile: "x", "y": "y"}
    found["equations"][0] |= {"variable": hostile, "lhs": f"d{hostile}/dt", "reason": hostile}
    found["simulation"]["trajectories"][0]["name"] = hostile
    for key in ("values", "lower", "upper", "measured", "r2", "start"):
        part = found["simulation"]["trajectories"][0]
        part[key] = {hostile if name == "x" else name: value for name, value in part[key].items()}
    read = Reader(as_html(found))
    assert "img" not in read.tags
    assert f"Equations of {hostile}" in read.texts


def test_an_equation_that_was_not_found_leaves_the_rest_of_the_page() -> None:
    found = dynamics(simulation=None)
    found["equations"][1] |= {"expression": None, "verdict": "no model", "reason": "Nothing.", "front": []}
    read = Reader(as_html(found))
    assert "dy/dt: no equation" in read.texts
    assert any("not analysed" in text for text in read.texts)


@pytest.mark.parametrize(("found", "section", "number"), [(regression(), "fit", "0.5"), (process(), "process", "0.75")])
def test_regressions_and_processes_have_sections_of_their_own(found: dict[str, Any], section: str, number: str) -> None:
    read = Reader(as_html(found))
    assert section in read.sections
    assert number in read.texts
    assert ("dynamics" in read.sections) == (section == "process")
