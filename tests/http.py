"""Requests to an ASGI application, without a network."""

import asyncio
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode

LOCAL = {"host": "127.0.0.1:7480"}


@dataclass(frozen=True)
class Answer:
    """What an application has answered."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


def ask(
    app: Any, method: str, path: str, body: bytes | list[bytes] = b"", query: Mapping[str, str] | None = None,
    **headers: str,
) -> Answer:  # fmt: skip
    """Return the answer to one request; the underscores of names of `headers` are hyphens."""
    given = LOCAL | {name.replace("_", "-"): value for name, value in headers.items()}
    return asyncio.run(ask_async(app, method, path, body if isinstance(body, list) else [body], query or {}, given))


async def ask_async(
    app: Any, method: str, path: str, body: list[bytes], query: Mapping[str, str], headers: Mapping[str, str]
) -> Answer:  # fmt: skip
    """Return the answer to one request, in a loop that is there; `headers` are all of them."""
    sent = _messages(body)
    parts: list[dict[str, Any]] = []
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "scheme": "http",
        "path": path, "raw_path": quote(path).encode(), "root_path": "",
        "query_string": urlencode(query, doseq=True).encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 7480),
    }  # fmt: skip

    async def receive() -> dict[str, Any]:
        message = next(sent, None)
        if message is None:
            await asyncio.Event().wait()  # the other side stays
        assert message is not None
        return message

    async def send(message: dict[str, Any]) -> None:
        parts.append(message)

    await app(scope, receive, send)
    start = parts[0]
    answered = {name.decode(): value.decode() for name, value in start["headers"]}
    return Answer(start["status"], answered, b"".join(part.get("body", b"") for part in parts[1:]))


def _messages(body: list[bytes]) -> Iterator[dict[str, Any]]:
    for place, part in enumerate(body):
        yield {"type": "http.request", "body": part, "more_body": place + 1 < len(body)}
