"""Sends requests to the coordinator by clients of the bus in threads, since each client belongs to one thread."""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

from atoll.client.client import Client, connected
from atoll_core.errors import UnreachableError
from atoll_core.wire.addresses import Destination

THREADS: Final = 4
"""Number of simultaneous requests: most take milliseconds, but an upload must not delay other requests."""

MAX_WAITING: Final = 256
"""Maximum number of requests that wait for a thread; more are refused, so that memory stays bounded."""

A = TypeVar("A")


class BusyError(Exception):
    """Raised when too many requests wait."""


class Gateway:
    """Sends requests to one coordinator as one user, named by the certificate in `destination` if there is one."""

    def __init__(self, destination: Destination) -> None:
        self.destination: Final = destination
        self._pool = ThreadPoolExecutor(THREADS, "question")
        self._local = threading.local()
        self._open: set[ThreadClient] = set()
        self._waiting = 0

    async def ask(self, question: Callable[[Client], A]) -> A:
        """Call `question` with a client in a thread, and return its result.

        Raises:
            BusyError: too many requests wait.
            AtollError: the client raised it.
        """
        if self._waiting >= MAX_WAITING:
            raise BusyError
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, self._ask, question)
        finally:
            self._waiting -= 1

    def _ask(self, question: Callable[[Client], A]) -> A:
        connection: ThreadClient | None = getattr(self._local, "connection", None)
        if connection is None:
            connection = self._local.connection = ThreadClient(self.destination)
            self._open.add(connection)
        return connection.ask(question)

    def close(self) -> None:
        """Close all clients after their current requests."""
        self._pool.shutdown(cancel_futures=True)
        for connection in self._open:
            connection.close()


class ThreadClient:
    """A client for one thread; opened when needed, and again after a request without an answer."""

    def __init__(self, destination: Destination) -> None:
        self._destination = destination
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None

    def ask(self, question: Callable[[Client], A]) -> A:
        """Call `question` with the client and return its result; raises the errors of the client."""
        if self._client is None:
            self._client = self._stack.enter_context(connected(self._destination))
        try:
            return question(self._client)
        except UnreachableError:  # then the next request also finds a coordinator with another store
            self.close()
            raise

    def close(self) -> None:
        """Close the client, if there is one."""
        self._client = None
        self._stack.close()
