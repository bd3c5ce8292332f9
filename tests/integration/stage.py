"""A service with its page, and headless Chromium that looks at it: fixtures of tests of `coordinator web` in a browser.

They need Chromium and what `make browser` installs; without these, tests are skipped.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browsers import CHROMIUM, CUT, NARROWEST, OPTIONS, SERIOUS, SWITCHES, WIDTHS
from tests.integration.test_web import TOKEN, Page, free_port
from tests.programs import serving

LIMIT_MS = 60_000

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; Debian's package is chromium")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright; make browser installs it")
    pytest.importorskip("axe_playwright_python", reason="no axe; make browser installs it")
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=CHROMIUM, args=SWITCHES)
        yield launched
        launched.close()


class Stage:
    """A service with its page, and a browser that looks at it."""

    def __init__(self, place: Path, address: str, browser: Any) -> None:
        self.place, self.address, self.browser = place, address, browser
        self.page = Page(f"http://127.0.0.1:{free_port()}")
        self.port = int(self.page.base.rpartition(":")[2])
        self.complaints: list[str] = []
        self.tabs: list[Any] = []

    def open(self, path: str = "", context: Any = None) -> Any:
        tab = (context or self.browser.new_context()).new_page()
        tab.set_default_timeout(LIMIT_MS)
        tab.on("console", lambda said: self._note(said.text) if said.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: self._note(str(error)))
        tab.on("dialog", lambda box: self._note(f"a dialog: {box.message}"))
        tab.on("request", lambda asked: None if self._is_ours(asked.url) else self._note(asked.url))
        tab.on("response", lambda got: self._note(f"{got.status} {got.url}") if got.status >= 400 else None)
        tab.goto(f"{self.page.base}/?token={TOKEN}{path}")
        self.tabs.append(tab)
        return tab

    def _is_ours(self, url: str) -> bool:
        return url.startswith((f"{self.page.base}/", "data:", "blob:"))

    def _note(self, text: str) -> None:
        if "net::ERR" not in text and "Failed to load resource" not in text:  # the process was killed; see responses
            self.complaints.append(text)


@pytest.fixture
def stage(tmp_path: Path, browser: Any) -> Iterator[Stage]:
    with serving(tmp_path, "state") as (address, _):
        made = Stage(tmp_path, address, browser)
        yield made
        for tab in made.tabs:
            tab.context.close()
        assert made.complaints == []


def check(tab: Any, *schemes: str) -> None:
    """Let axe look at a view at all widths, in light and dark, and see that nothing sticks out."""
    from axe_playwright_python import sync_playwright as axe

    for width in WIDTHS:
        tab.set_viewport_size({"width": width, "height": 900})
        for scheme in schemes or ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)
            found = axe.Axe().run(tab, options=OPTIONS).response["violations"]
            assert [one["id"] + one["nodes"][0]["html"] for one in found if one["impact"] in SERIOUS] == []
        assert not tab.evaluate("document.documentElement.scrollWidth > window.innerWidth"), width
    tab.set_viewport_size({"width": NARROWEST, "height": 900})
    assert not tab.evaluate("document.documentElement.scrollWidth > window.innerWidth"), NARROWEST
    for _ in range(50):  # charts are drawn anew a moment later
        cut = tab.evaluate(CUT)
        if not cut:
            break
        tab.wait_for_timeout(100)
    assert cut == [], cut
    tab.set_viewport_size({"width": WIDTHS[0], "height": 900})


def shoot(tab: Any, name: str) -> None:
    """Keep a picture of the page where the variable says."""
    folder = os.environ.get("ATOLL_SCREENSHOTS")
    if folder:
        tab.emulate_media(color_scheme="light")
        tab.screenshot(path=f"{folder}/{name}.png", full_page=True)
