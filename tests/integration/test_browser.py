"""Pages in a real browser: nothing is loaded, nothing complains, everybody can read them, and they can be printed.

These need Chromium and what `make browser` installs; `--site` names the built documentation, to be looked at as well.
"""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from atoll.report.page import as_html
from atoll_coordinator.result.result import Result
from tests.browsers import CHROMIUM, CUT, NARROWEST, OPTIONS, SERIOUS, SWITCHES, WIDTHS
from tests.unit.library.report import results

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright; make browser installs it")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe; make browser installs it")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; Debian's package is chromium")

MOST_BYTES = 3_000_000
HOSTILE = "<img src=x onerror=alert(1)>"
LONG = "concentration_of_bovine_serum_albumin_in_the_second_chamber"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=SWITCHES)
        yield started
        started.close()


class Visit:
    """One page in the browser, and everything that it asked for or complained about."""

    def __init__(self, browser: Any, file: Path) -> None:
        self.page = browser.new_page()
        self.complaints: list[str] = []
        self.page.on("request", self._note)
        self.page.on("dialog", lambda box: self.complaints.append(f"a dialog: {box.message}"))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        self.page.goto(file.as_uri())

    def _note(self, request: Any) -> None:
        if not request.url.startswith(("file:", "data:")):
            self.complaints.append(request.url)

    def look(self, width: int, scheme: str) -> list[str]:
        """Return what is wrong with the page at a width in a colour scheme."""
        too_wide = self.fit(width)
        self.page.emulate_media(color_scheme=scheme)
        complaints = axe.Axe().run(self.page, options=OPTIONS).response["violations"]
        return too_wide + [
            f"{complaint['id']}: {complaint['nodes'][0]['html']}"
            for complaint in complaints
            if complaint["impact"] in SERIOUS
        ]

    def fit(self, width: int) -> list[str]:
        """Return a sentence if the page is wider than this."""
        self.page.set_viewport_size({"width": width, "height": 900})
        is_wide = self.page.evaluate("document.documentElement.scrollWidth > window.innerWidth")
        return [f"the page is wider than {width} pixels"] if is_wide else []


def renamed(complaints: dict[str, Any], old: str, new: str) -> dict[str, Any]:
    """Return a result in which a column has another name, wherever its name stands."""

    def of(value: Any) -> Any:
        if isinstance(value, dict):
            return {of(key): complaint if key == "expression" else of(complaint) for key, complaint in value.items()}
        if isinstance(value, list):
            return [*map(of, value)]
        return new if value == old else value

    made = cast(dict[str, Any], of(copy.deepcopy(complaints)))
    made["symbols"] = {new if name == old else name: symbol for name, symbol in complaints["symbols"].items()}
    return made


def hostile() -> dict[str, Any]:
    """Return a result whose columns, job, command and warnings look like HTML, or are long."""
    complaints = renamed(
        renamed(results.dynamics(job=HOSTILE, command=HOSTILE, warnings=[HOSTILE]), "x", HOSTILE), "y", LONG
    )
    complaints["data"]["files"] = [HOSTILE, f"{LONG}.csv"]
    return complaints


def nothing() -> dict[str, Any]:
    """Return a result of which one equation was not found."""
    contents = results.dynamics(simulation=None)
    contents["equations"][1] |= {"expression": None, "verdict": "no model", "reason": "Nothing.", "front": []}
    return contents


REPORTS = {"dynamics": results.dynamics, "regression": results.regression, "process": results.process,
           "hostile": hostile, "nothing": nothing}  # fmt: skip


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_loads_nothing_and_can_be_read_by_everybody(name: str, browser: Any, tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    file.write_text(as_html(Result.of(REPORTS[name]())), "utf-8")
    assert file.stat().st_size < MOST_BYTES
    visit = Visit(browser, file)
    looks = (
        [(1280, "light"), (390, "dark")] if name != "dynamics" else [(w, s) for w in WIDTHS for s in ("light", "dark")]
    )
    assert {look: visit.look(*look) for look in looks} == {look: [] for look in looks}
    assert visit.complaints == []
    assert visit.fit(NARROWEST) == []
    visit.page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
    assert visit.page.evaluate(CUT) == []
    assert visit.page.locator("img").count() == 0
    if name == "hostile":
        assert visit.page.locator("h1").inner_text() == f"Equations of {HOSTILE}, {LONG}.csv"
    visit.page.emulate_media(media="print")
    assert visit.page.pdf(format="A4").startswith(b"%PDF")
    visit.page.close()


@pytest.mark.timeout(1800)
def test_the_site_loads_nothing_and_can_be_read_by_everybody(browser: Any, request: pytest.FixtureRequest) -> None:
    site = request.config.getoption("--site")
    if site is None:
        pytest.skip("no site; make browser builds it and names it with --site")
    wrong = {}
    for file in sorted(site.resolve().rglob("*.html")):
        visit = Visit(browser, file)
        narrow = (390, "dark") if file.name in ("index.html", "tutorial.html", "api.html") else None
        complaints = [
            *visit.look(1280, "light"),
            *(visit.look(*narrow) if narrow else visit.fit(390)),
            *visit.complaints,
        ]
        visit.page.close()
        if complaints:
            wrong[str(file.relative_to(site.resolve()))] = complaints
    assert wrong == {}, json.dumps(wrong, indent=1)
