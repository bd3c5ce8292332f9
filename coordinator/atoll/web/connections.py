"""Connections of uvicorn with limits on time and number, so that slow or many clients do not block other clients.

A connection is closed after a time without a complete request, or if its client does not read the answer. If there are
too many connections, the connection that has waited longest for a request is closed; if all are busy, the newest
connection is refused.
"""

import asyncio
import resource
from typing import ClassVar, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

from atoll.web.problems import ProblemDetails

WAIT_S: Final = 30.0
"""Time limit for all headers of a request, in seconds, on a new or a reused connection."""

STALLED_S: Final = 30.0
"""Time limit for a client that reads nothing while at least 64 kB wait for it, in seconds."""

MOST: Final = 4_096
"""Maximum number of connections; a browser opens six for a page."""

_LATE: Final = ProblemDetails(
    408, f"the request did not arrive within {WAIT_S:.0f} s; send it without pauses", {"connection": "close"}
)
_INVALID: Final = ProblemDetails(400, "this is not an HTTP/1.1 request", {"connection": "close"})
_FULL: Final = ProblemDetails(
    503, "too many connections are busy; try again later", {"connection": "close", "retry-after": "5"}
)


def most_connections() -> int:
    """Return the limit of connections: at most half of the allowed open files, because requests open files, too."""
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MOST if soft == resource.RLIM_INFINITY else min(MOST, soft // 2)


def allow_open_files() -> None:
    """Raise the limit of open files to the number for all connections, if the system allows it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 2 * MOST if hard == resource.RLIM_INFINITY else min(2 * MOST, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


class LimitedConnection(H11Protocol):
    """One connection with limits."""

    idle: ClassVar[dict["LimitedConnection", None]] = {}
    """Connections that wait for a request; the first has waited longest."""

    _timer: asyncio.TimerHandle | None = None
    _stall: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Register a new connection; close another one if there are too many."""
        super().connection_made(transport)
        if len(self.connections) > most_connections():
            if not self.idle:
                self._refuse(_FULL)
                return
            next(iter(self.idle))._end()
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Process received bytes."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._wait_no_more()

    def on_response_complete(self) -> None:
        """Wait for the next request, which may have arrived already."""
        self._wait()
        super().on_response_complete()
        if not self.cycle.response_complete:
            self._wait_no_more()

    def pause_writing(self) -> None:
        """Start the time limit for a client that reads nothing."""
        super().pause_writing()
        self._stall = self.loop.call_later(STALLED_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the time limit."""
        super().resume_writing()
        if self._stall is not None:
            self._stall.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister the connection."""
        self._wait_no_more()
        super().connection_lost(exc)
        if self._stall is not None:
            self._stall.cancel()

    def _wait(self) -> None:
        self._wait_no_more()
        self.idle[self] = None
        self._timer = self.loop.call_later(WAIT_S, self._end)

    def _wait_no_more(self) -> None:
        self.idle.pop(self, None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def send_400_response(self, msg: str) -> None:
        """Refuse an invalid request; during another answer, close the connection without a message."""
        self._refuse(_INVALID if self.cycle is None or self.cycle.response_complete else None)

    def _end(self) -> None:
        """Close the connection; if a request has begun, answer it first."""
        self._refuse(_LATE if self.conn.trailing_data[0] else None)

    def _refuse(self, problem: ProblemDetails | None) -> None:
        self._wait_no_more()
        if problem is not None and not self.transport.is_closing():
            head = "".join(f"{name.decode()}: {value.decode()}\r\n" for name, value in problem.raw_headers)
            self.transport.write(f"HTTP/1.1 {problem.status_code} \r\n{head}\r\n".encode() + bytes(problem.body))
        self.transport.close()
        if self._stall is None:  # a client that reads no answer must not keep the connection open
            self._stall = self.loop.call_later(STALLED_S, self.transport.abort)
