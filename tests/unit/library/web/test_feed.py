"""What pages are told: in order, once, from where they were; views as changes."""

import asyncio
import json
from typing import Any

import pytest

from atoll.web import feed as feed_module
from atoll.web.feed import Feed
from atoll_core.wire.messages.views import EventView
from tests.unit.library.web.made import Asked, AtHand
from tests.views import job_view


def event(number: int, job: str | None = "b") -> EventView:
    return EventView(number=number, time="", event="log", text=f"<b>{number}", job=job)


class Scene:
    """A feed whose thread does not run: a test says what happens."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *jobs: Any) -> None:
        self.client = Asked(*jobs)
        self.feed = Feed(AtHand(self.client))  # type: ignore[arg-type]
        monkeypatch.setattr(self.feed, "_start", lambda: None)

    def happen(self, *events: EventView) -> None:
        self.client.happened += events
        self.feed._take_events(events)

    async def look(self) -> None:
        await self.feed._look()


async def told(stream: Any, number: int) -> list[tuple[str, Any]]:
    """Return the next messages, but those of the connection."""
    found: list[tuple[str, Any]] = []
    while len(found) < number:
        text = await asyncio.wait_for(anext(stream), 5.0)
        lines = dict(line.split(": ", 1) for line in text.strip().splitlines() if ": " in line)
        if lines.get("event") not in (None, "connection"):
            found.append((lines["event"], json.loads(lines["data"])))
    return found


def test_a_page_resumes_behind_the_event_that_it_has_and_hears_each_once(monkeypatch) -> None:
    async def go() -> None:
        scene = Scene(monkeypatch, job_view(job="b"))
        scene.client.happened = [event(number) for number in range(1, 6)]
        stream = scene.feed.listen(["b"], 2)
        first = await told(stream, 3)
        assert [body["number"] for _, body in first] == [3, 4, 5]
        scene.happen(event(6), event(7, "other"), event(8))
        assert [body["number"] for _, body in await told(stream, 2)] == [6, 8]

    asyncio.run(go())


def test_what_happens_while_a_page_catches_up_comes_once(monkeypatch) -> None:
    async def go() -> None:
        monkeypatch.setattr(feed_module, "PAGE", 2)
        scene = Scene(monkeypatch, job_view(job="b"))
        scene.client.happened = [event(number) for number in range(1, 4)]
        stream = scene.feed.listen(None, 1)
        got = await told(stream, 1)
        scene.happen(event(4))  # it is in the store already, and in the queue
        got += await told(stream, 2)
        scene.happen(event(5))
        got += await told(stream, 1)
        assert [body["number"] for _, body in got] == [2, 3, 4, 5]

    asyncio.run(go())


def test_views_are_told_whole_and_then_as_changes(monkeypatch) -> None:
    async def go() -> None:
        scene = Scene(monkeypatch, job_view(job="b"))
        stream = scene.feed.listen(None, None)
        listening = asyncio.ensure_future(told(stream, 1))
        await asyncio.sleep(0.05)
        await scene.look()
        ((kind, body),) = await listening
        assert (kind, body["changes"]["state"]) == ("job", "running")
        scene.client.views["b"] = job_view(job="b", elapsed=9.0)
        await scene.look()  # time alone is no change
        scene.client.views["b"] = job_view(job="b", elapsed=10.0, workers=7)
        await scene.look()
        assert await told(stream, 1) == [("job", {"job": "b", "changes": {"elapsed": 10.0, "workers": 7}})]
        late = scene.feed.listen(None, None)
        assert (await told(late, 1))[0][1]["changes"]["workers"] == 7

    asyncio.run(go())


def test_a_job_that_ends_or_is_deleted_is_told_so(monkeypatch) -> None:
    async def go() -> None:
        scene = Scene(monkeypatch, job_view(job="b"), job_view(job="c"))
        stream = scene.feed.listen(None, None)
        listening = asyncio.ensure_future(told(stream, 2))
        await asyncio.sleep(0.05)
        await scene.look()
        await listening
        scene.client.views["b"] = job_view(job="b", state="done")
        del scene.client.views["c"]
        await scene.look()
        by_job = {body["job"]: body for _, body in await told(stream, 2)}
        assert by_job["b"]["changes"] == {"state": "done"}
        assert by_job["c"]["deleted"]

    asyncio.run(go())


def test_whoever_keeps_something_of_a_job_is_told_when_its_state_changes(monkeypatch) -> None:
    async def go() -> None:
        changed: list[str] = []
        scene = Scene(monkeypatch, job_view(job="b"))
        monkeypatch.setattr(scene.feed, "_changed", changed.append)
        await scene.look()
        scene.client.views["b"] = job_view(job="b", workers=3)
        await scene.look()
        scene.client.views["b"] = job_view(job="b", workers=3, state="refining")
        await scene.look()
        assert changed == ["b", "b"]

    asyncio.run(go())


def test_a_job_that_is_deleted_is_noticed_by_a_page_that_watches_it_alone(monkeypatch) -> None:
    async def go() -> None:
        scene = Scene(monkeypatch, job_view(job="b", state="done"))
        stream = scene.feed.listen(["b"], None)
        listening = asyncio.ensure_future(told(stream, 1))
        await asyncio.sleep(0.05)
        await scene.look()
        await listening
        del scene.client.views["b"]
        scene.happen(EventView(number=9, time="", event="deleted", text="job b is deleted"))
        await scene.look()
        ((_, body),) = await told(stream, 1)
        assert body["deleted"]

    asyncio.run(go())


def test_a_page_that_cannot_keep_up_is_let_go(monkeypatch) -> None:
    async def go() -> None:
        monkeypatch.setattr(feed_module, "MAX_BEHIND", 10)
        scene = Scene(monkeypatch, job_view(job="b"))
        stream = scene.feed.listen(None, None)
        await anext(stream)
        scene.happen(*(event(number) for number in range(1, 50)))
        heard = [text async for text in stream]
        assert len(heard) < 12
        assert scene.feed.listeners == 0

    asyncio.run(go())


def test_texts_cannot_break_out_of_a_message(monkeypatch) -> None:
    async def go() -> None:
        scene = Scene(monkeypatch, job_view(job="b"))
        stream = scene.feed.listen(None, None)
        await anext(stream)
        nasty = "a\n\nevent: job\ndata: {}\r\n\u2028"
        scene.happen(EventView(number=1, time="", event="log", text=nasty, job="b"))
        text = await anext(stream)
        assert text.count("\n\n") == 1
        assert json.loads(text.split("data: ", 1)[1])["text"] == nasty

    asyncio.run(go())
