"""The page by keyboard alone: from an empty service to a result taken along, and two jobs compared."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.integration.stage import LIMIT_MS, Stage, needs_chromium
from tests.integration.test_web import TOKEN, web
from tests.programs import started, until

pytestmark = needs_chromium

MOST_STEPS = 120
FOCUSED = """() => {
  const focused = document.activeElement;
  if (!focused || focused === document.body) return null;
  const shown = focused.matches("input.unseen") ? focused.nextElementSibling : focused;
  const style = getComputedStyle(shown);
  const box = shown.getBoundingClientRect();
  const all = [...document.querySelectorAll("*")];
  const text = focused.labels?.[0]?.textContent || focused.getAttribute("aria-label") || focused.textContent;
  return {
    at: all.indexOf(focused), text: text.trim().slice(0, 80), tag: focused.localName,
    isMarked: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2 || focused.matches("h1, main"),
    isSeen: box.width > 0 && box.height > 0 && box.bottom > 0 && box.top < innerHeight
      && box.right > 0 && box.left < innerWidth,
  };
}"""


class Keys:
    """Presses keys, and sees at each step where the focus is, and that one sees it."""

    def __init__(self, tab: Any) -> None:
        self.tab = tab

    def press(self, *keys: str) -> dict[str, Any] | None:
        for key in keys:
            self.tab.keyboard.press(key)
        return self.focused()

    def focused(self) -> dict[str, Any] | None:
        found: dict[str, Any] | None = self.tab.evaluate(FOCUSED)
        if found is not None:
            assert found["isMarked"], f"one does not see that {found} has the focus"
            assert found["isSeen"], f"the focus is at {found}, which is not on the screen"
        return found

    def to(self, text: str, key: str = "Tab") -> dict[str, Any]:
        """Go on until something that is called like this has the focus."""
        passed = []
        for _ in range(MOST_STEPS):
            found = self.press(key)
            if found is not None and text.lower() in found["text"].lower():
                return found
            passed.append(found["text"] if found else None)
        raise AssertionError(f"the key {key} never leads to {text!r}, but to {passed}")

    def round(self) -> list[dict[str, Any]]:
        """Go round the whole page; return what had the focus, from the first on."""
        self.tab.evaluate("document.activeElement.blur(); getSelection().removeAllRanges(); scrollTo(0, 0)")
        self.to("Skip to the content", "Shift+Tab")
        first = self.focused()
        assert first is not None
        passed = [first]
        for _ in range(MOST_STEPS):
            found = self.press("Tab")
            if found is None or found["text"] == first["text"]:
                return passed
            passed.append(found)
        raise AssertionError(f"the Tab key never comes to an end: {passed[-5:]}")


def check_round(keys: Keys) -> list[str]:
    """See that the Tab key goes through a view in the order of what one reads, to its end; return what it names."""
    passed = keys.round()
    places = [one["at"] for one in passed]
    assert places == sorted(places), [one["text"] for one in passed]
    return [one["text"] for one in passed]


def chosen(tab: Any) -> Callable[[], str]:
    return lambda: str(tab.get_by_role("slider").first.get_attribute("aria-valuetext"))


def test_from_an_empty_service_to_a_result_and_a_comparison_without_a_mouse(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open()
        tab.get_by_text(f"island-worker --connect {stage.address}").wait_for()  # an empty service says what to do next
        keys = Keys(tab)
        assert keys.press("Tab")["text"] == "Skip to the content"  # type: ignore[index]
        assert keys.press("Enter")["tag"] == "main"  # type: ignore[index]
        keys.to("choose a file")
        keys.to("demo data")
        tab.keyboard.press("Enter")
        tab.get_by_role("heading", name="Smoothed").wait_for()
        assert check_round(keys)[0] == "Skip to the content"
        keys.to("Role of")
        data = stage.place / "mine.csv"
        data.write_bytes((Path("coordinator/atoll/web/static/predator_prey.csv")).read_bytes())
        keys.to("choose files", "Shift+Tab")
        tab.locator("#file").set_input_files(data)  # the dialog of the system is the browser's
        tab.get_by_text("mine.csv", exact=False).first.wait_for()
        keys.to("search")
        tab.keyboard.press("Enter")
        keys.to("--seed")
        tab.keyboard.type("3")
        tab.get_by_text("--seed 3", exact=False).first.wait_for()
        keys.to("Name")
        tab.keyboard.type("predators and prey")
        keys.to("Submit the job")
        tab.keyboard.press("Enter")
        tab.get_by_role("heading", name="predators and prey").wait_for()
        assert keys.focused()["tag"] == "h1"  # type: ignore[index]
        first = tab.url.rpartition("/")[2]

        tab.get_by_role("button", name="Open the report").wait_for()
        tab.get_by_text("checks passed", exact=False).first.wait_for()
        tab.get_by_label("Phase portrait").locator("canvas").wait_for()  # nothing moves any more
        keys.to("Candidates, front and convergence")
        tab.keyboard.press("Enter")
        tab.get_by_role("slider").first.wait_for()
        check_round(keys)
        tab.get_by_label("Phase portrait").locator("canvas").wait_for()
        keys.to("choose an equation")
        keys.press("End")
        last = chosen(tab)()
        keys.press("ArrowLeft")
        until(lambda: chosen(tab)() != last)
        tab.get_by_text(chosen(tab)().split(", ")[0], exact=False).first.wait_for()
        with tab.expect_download(timeout=LIMIT_MS) as taken:
            keys.to("python")
            tab.keyboard.press("Enter")
        assert "def " in Path(taken.value.path()).read_text("utf-8")
        with tab.context.expect_page() as opened:
            keys.to("Open the report", "Shift+Tab")
            tab.keyboard.press("Enter")
        opened.value.get_by_role("heading", level=1).wait_for()
        opened.value.close()

        stage.page.submit("long", seed="1", preset="paper", target_error="1e-300", max_epochs="100000")
        keys.to("Jobs", "Shift+Tab")
        tab.keyboard.press("Enter")
        tab.get_by_role("link", name="d.csv").wait_for()
        check_round(keys)
        keys.to("d.csv")
        if keys.focused()["tag"] != "a":  # type: ignore[index]
            keys.to("d.csv")
        tab.keyboard.press("Enter")
        keys.to("Pause")
        tab.keyboard.press("Space")
        tab.get_by_role("button", name="Resume").wait_for()
        assert keys.focused()["text"] == "Resume"  # type: ignore[index]
        tab.keyboard.press("Space")
        tab.get_by_role("button", name="Pause").wait_for()
        keys.to("Cancel")
        assert keys.press("Enter")["text"] == "No"  # type: ignore[index]
        assert keys.press("Escape")["text"] == "Cancel"  # type: ignore[index]
        keys.press("Enter")
        keys.to("Yes, cancel it", "Shift+Tab")
        tab.keyboard.press("Space")
        tab.get_by_role("link", name="Submit again").wait_for()
        until(lambda: stage.page.state("long") == "cancelled")
        tab.get_by_role("button", name="Delete").wait_for()
        until(keys.focused)  # not lost with the button that is gone

        keys.to("Jobs", "Shift+Tab")
        tab.keyboard.press("Enter")
        for name in ("Compare d.csv", "Compare predators and prey"):
            keys.to(name)
            tab.keyboard.press("Space")
        keys.to("Compare the two", "Shift+Tab")
        tab.keyboard.press("Enter")
        tab.get_by_role("heading", name="Compare jobs").wait_for()
        tab.get_by_role("heading", name="Options that differ").wait_for()
        assert first in tab.url
        assert "long" in tab.url
        check_round(keys)
        for view in ("Workers", "Coordinator"):
            keys.to(view, "Shift+Tab")
            tab.keyboard.press("Enter")
            tab.get_by_role("heading", level=1, name=view).wait_for()
            tab.get_by_role("button").first.wait_for()
            check_round(keys)
        assert TOKEN not in tab.url
