"""Clients that are slow, or many: each is ended in time, and others are answered meanwhile."""

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import h11
import pytest
from uvicorn.server import ServerState

from atoll.web import connections
from atoll.web.connections import LimitedConnection
from atoll.web.server import Listener, build_application, configure
from tests.unit.library.web.made import READERS, Asked, AtHand, access

GET = b"GET /api/v1/version HTTP/1.1\r\nhost: localhost\r\n\r\n"
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]
Open = Callable[[], Awaitable[Streams]]


@asynccontextmanager
async def listening(application=None) -> AsyncIterator[Open]:
    """Answer as the web process does; yield what opens a connection."""
    loop, state = asyncio.get_running_loop(), ServerState()
    config = configure(application or build_application(access(AtHand(Asked())), READERS), Listener("127.0.0.1", 0))
    config.load()
    server = await loop.create_server(lambda: LimitedConnection(config, state, {}, loop), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    opened: list[Streams] = []

    async def connect() -> Streams:
        opened.append(await asyncio.open_connection("127.0.0.1", port, limit=2**20))
        return opened[-1]

    try:
        yield connect
    finally:
        for _, writer in opened:
            writer.close()
        for task in state.tasks:
            task.cancel()
        server.close()
        LimitedConnection.idle.clear()


async def answer(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """Return status and body of an answer."""
    head = await reader.readuntil(b"\r\n\r\n")
    length = int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0])
    return int(head[9:12]), await reader.readexactly(length)


async def only(is_so: Callable[[LimitedConnection], bool] = lambda one: True) -> LimitedConnection:
    """Return the connection that waits for a request, as soon as this is so of it."""
    while not (found := [one for one in LimitedConnection.idle if is_so(one)]):
        await asyncio.sleep(0)
    return found[0]


def has_begun(one: LimitedConnection) -> bool:
    return bool(one.conn.trailing_data[0])


@pytest.mark.parametrize("before", [b"", GET])
@pytest.mark.parametrize("part", [b"", b"GET / HTTP/1.1\r\nhost: loc"])
def test_a_request_that_does_not_come_ends_its_connection_however_it_dribbles(before, part) -> None:
    async def go() -> None:
        async with listening() as connect:
            reader, writer = await connect()
            if before:
                writer.write(before)
                assert (await answer(reader))[0] == 200
            one = await only()
            timer = one._timer
            assert timer is not None
            assert timer.when() <= asyncio.get_running_loop().time() + connections.WAIT_S
            writer.write(part)
            one = await only(lambda one: has_begun(one) == bool(part))
            assert one._timer is timer, "what comes does not put off the end"
            one._end()
            if part:
                status, body = await answer(reader)
                assert (status, json.loads(body)["status"]) == (408, 408)
            assert await reader.read() == b""

    asyncio.run(go())


def test_a_body_that_nobody_reads_does_not_keep_a_connection() -> None:
    async def go() -> None:
        async with listening() as connect:
            reader, writer = await connect()
            writer.write(b"POST /api/v1/jobs HTTP/1.1\r\nhost: localhost\r\ncontent-length: 1000000\r\n\r\n")
            assert (await answer(reader))[0] == 401
            one = await only()
            timer = one._timer
            writer.write(b"x")
            await only(lambda one: one.conn.their_state is h11.SEND_BODY)
            assert one._timer is timer

    asyncio.run(go())


def test_an_answer_that_is_not_read_ends_its_connection(monkeypatch) -> None:
    monkeypatch.setattr(connections, "STALLED_S", 0.0)
    ended = asyncio.Event()

    async def endless(scope, receive, send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        closed = asyncio.create_task(gone(receive))
        while not closed.done():
            await send({"type": "http.response.body", "body": bytes(2**20), "more_body": True})
        ended.set()

    async def go() -> None:
        async with listening(endless) as connect:
            _, writer = await connect()
            writer.transport.pause_reading()
            writer.write(GET)
            await ended.wait()

    asyncio.run(go())


async def gone(receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def test_where_there_are_too_many_the_one_that_waits_longest_goes(monkeypatch) -> None:
    monkeypatch.setattr(connections, "MOST", 3)

    async def go() -> None:
        async with listening() as connect:
            idle = []
            for number in range(3):
                idle.append(await connect())
                while len(LimitedConnection.idle) <= number:
                    await asyncio.sleep(0)
            reader, writer = await connect()
            assert await idle[0][0].read() == b""
            writer.write(GET)
            assert (await answer(reader))[0] == 200
            idle[2][1].write(GET)
            assert (await answer(idle[2][0]))[0] == 200

    asyncio.run(go())


def test_where_all_are_at_work_the_next_is_told_to_come_later(monkeypatch) -> None:
    monkeypatch.setattr(connections, "MOST", 2)
    begun = asyncio.Semaphore(0)

    async def busy(scope, receive, send) -> None:
        begun.release()
        await asyncio.Event().wait()

    async def go() -> None:
        async with listening(busy) as connect:
            for _ in range(2):
                _, writer = await connect()
                writer.write(GET)
                await begun.acquire()
            reader, _ = await connect()
            status, body = await answer(reader)
            assert (status, "try again later" in json.loads(body)["detail"]) == (503, True)

    asyncio.run(go())
