"""Ten tabs of one browser share one stream of events: all are live, whoever leads them is closed or hidden."""

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Any

from tests.integration.stage import Stage, needs_chromium
from tests.integration.test_web import Listening, web
from tests.programs import until

pytestmark = needs_chromium

TABS = 10
HEARING = """
  window.heard = [];
  window.isAway = window.greeted = false;
  Object.defineProperty(document, "visibilityState", { get: () => (window.isAway ? "hidden" : "visible") });
  const note = ({ kind, type, id }) => {
    if (kind === "event" && type === "job") window.greeted = true;
    if (kind === "event" && type === "happened" && id !== null && !window.isAway) window.heard.push(Number(id));
  };
  const Real = window.BroadcastChannel;
  window.BroadcastChannel = class extends Real {
    constructor(name) { super(name); this.addEventListener("message", ({ data }) => note(data)); }
    postMessage(data) { note(data); super.postMessage(data); }
  };
"""
"""Notes the numbers of all events that a tab hears or, as the one that leads, hands out; lets it be hidden."""

LEADS = """new Promise((done) => navigator.locks.request(`own ${Math.random()}`, async (own) => {
  const { held } = await navigator.locks.query();
  const holder = (isMeant) => held.find(({ name }) => isMeant(name))?.clientId;
  done(holder((name) => name.startsWith("atoll-events")) === holder((name) => name === own.name));
}))"""
"""Tells whether a tab holds the lock of the events: it takes one of its own to know how it is called."""

LINES = "[...document.querySelectorAll('.log li')].map((line) => line.textContent)"


class Tabs:
    """Tabs of one browser, in the order in which they were opened."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.context = stage.browser.new_context()
        self.context.add_init_script(HEARING)
        self.context.route("**/api/v1/events*", self._take)
        self.witness = Listening(stage.page, "j1")
        self.open_ones: list[Any] = []
        self.is_holding = False
        self.held: list[Any] = []

    def _take(self, route: Any) -> None:
        if self.is_holding:
            self.held.append(route)
        else:
            route.continue_()

    def change_unheard(self, priority: int) -> None:
        """Give j1 another priority, and wait until the service has told everybody who listens."""
        prioritize(self.stage, "j1", priority)
        until(lambda: numbers(self.stage, "j1")[-1] in self.witness.numbers)

    @contextlib.contextmanager
    def between_streams(self) -> Iterator[None]:
        """What happens in here happens while the next stream has been asked for and has not begun."""
        self.is_holding = True
        yield
        self.is_holding = False
        for route in self.held:
            route.continue_()
        self.held.clear()

    def wait_for_the_next_stream(self) -> None:
        until(lambda: self.open_ones[0].evaluate("1") and self.held)

    def open(self, path: str) -> Any:
        tab = self.stage.open(path, self.context)
        self.open_ones.append(tab)
        return tab

    def hide(self, tab: Any, *, is_away: bool = True) -> None:
        tab.evaluate(f"window.isAway = {str(is_away).lower()}; document.dispatchEvent(new Event('visibilitychange'))")

    def close(self, tab: Any) -> None:
        self.open_ones.remove(tab)
        tab.close()

    def listeners(self) -> int:
        """How many streams of tabs the service tells."""
        _, text = self.stage.page.ask("GET", "metrics")
        found = re.search(r"^atoll_web_listeners (\d+)$", text, re.MULTILINE)
        assert found is not None
        return int(found[1]) - 1  # the witness's

    def leads(self, tab: Any) -> bool:
        """Tell whether a tab holds the lock."""
        leads: bool = tab.evaluate(LEADS)
        return leads

    def leader(self) -> Any:
        return next(tab for tab in self.open_ones if self.leads(tab))


def numbers(stage: Stage, job: str) -> list[int]:
    _, answer = stage.page.ask("GET", f"jobs/{job}/logs?limit=1000&after=1")
    return [event["number"] for event in answer["events"]]


def show(tab: Any, text: str) -> Callable[[], bool]:
    return lambda: any(text in line for line in tab.evaluate(LINES))


def prioritize(stage: Stage, job: str, priority: int) -> None:
    status, _ = stage.page.ask(
        "PUT", f"jobs/{job}/priority", b'{"priority": %d}' % priority, **{"Content-Type": "application/json"}
    )
    assert status == 200


def test_ten_tabs_of_a_browser_share_a_stream_and_lose_nothing_with_the_one_that_leads(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        for job in ("j1", "j2", "j3"):
            stage.page.submit(job)
        tabs = Tabs(stage)
        for index in range(TABS):
            tabs.open("#/jobs" if index == TABS - 1 else f"#/jobs/{('j1', 'j2', 'j3')[index % 3]}")
        watched = {tab: ("j1", "j2", "j3")[index % 3] for index, tab in enumerate(tabs.open_ones[:-1])}
        for tab, job in watched.items():
            tab.get_by_text(f"'{job}'").or_(tab.get_by_text("submitted as")).first.wait_for()
        until(lambda: tabs.listeners() == 1)

        def change(priority: int) -> None:
            for job in ("j1", "j2", "j3"):
                prioritize(stage, job, priority)
            for tab in watched:
                if tab in tabs.open_ones and not tab.evaluate("window.isAway"):
                    until(show(tab, f"its priority is {priority} now"))

        change(1)
        assert tabs.listeners() == 1
        for priority in (2, 3):  # who leads is closed, twice
            with tabs.between_streams():
                tabs.close(tabs.leader())
                tabs.wait_for_the_next_stream()
                tabs.change_unheard(-priority)
            change(priority)
            for tab, job in watched.items():
                if tab in tabs.open_ones and job == "j1":
                    until(show(tab, f"its priority is {-priority} now"))
            until(lambda: tabs.listeners() == 1)

        leader = tabs.leader()  # is hidden: another one leads
        tabs.hide(leader)
        until(lambda: not tabs.leads(leader))
        change(4)
        assert not show(leader, "its priority is 4 now")()
        tabs.hide(leader, is_away=False)
        if leader in watched:
            until(show(leader, "its priority is 4 now"))  # it fetches what it has missed
        change(5)

        for tab in tabs.open_ones:  # nothing twice, nothing out of order, nothing lost since it has been open
            heard = tab.evaluate("window.heard")
            assert heard == sorted(set(heard)), heard
            if tab in watched:
                ours = set(numbers(stage, watched[tab]))
                lines = [line for line in tab.evaluate(LINES) if "priority is" in line]
                assert len(lines) == len(set(lines)), lines
                known = {number for number in ours if number > min(heard)}
                assert tab is leader or known <= set(heard), (watched[tab], sorted(known - set(heard)))

        for tab in tabs.open_ones:  # whom nobody sees costs nothing
            tabs.hide(tab)
        until(lambda: tabs.listeners() == 0)
        prioritize(stage, "j1", 6)
        for tab in tabs.open_ones:
            tabs.hide(tab, is_away=False)
        change(7)
        for tab, job in watched.items():
            if tab in tabs.open_ones and job == "j1":
                until(show(tab, "its priority is 6 now"))
        until(lambda: tabs.listeners() == 1)
        tabs.witness.is_over.set()


def test_what_happens_while_a_quiet_stream_is_opened_for_another_job_is_not_lost(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        for job in ("j1", "j2"):
            stage.page.submit(job)
        tabs = Tabs(stage)
        first = tabs.open("#/jobs/j1")
        first.get_by_text("submitted as").first.wait_for()
        until(lambda: tabs.listeners() == 1)
        until(lambda: first.evaluate("window.greeted"))
        with tabs.between_streams():
            tabs.open("#/jobs/j2")
            tabs.wait_for_the_next_stream()
            tabs.change_unheard(1)
        until(show(first, "its priority is 1 now"))
        tabs.witness.is_over.set()
