"""Things that wait, of parties that take turns; within each party its clients do. Bounded by party and in all. Pure.

A party is a user, and without certificates a session on the bus, of which each may use thousands of names of clients.
"""

from collections import OrderedDict, deque
from collections.abc import Container
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Bounds:
    """How many things of one client, of one party and of all may wait, and bytes of one party and of all."""

    of_client: int
    of_party: int
    of_all: int
    bytes_of_party: int
    bytes_of_all: int


class _Line(Generic[T]):
    """What waits of one party, by client, with its sizes."""

    def __init__(self, bounds: Bounds) -> None:
        self.waiting = self.bytes = 0
        self._bounds = bounds
        self._clients: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()

    def has_room(self, client: str, size: int) -> bool:
        is_full = self.waiting >= self._bounds.of_party or self.bytes + size > self._bounds.bytes_of_party
        return not is_full and len(self._clients.get(client, ())) < self._bounds.of_client

    def add(self, client: str, item: T, size: int) -> None:
        self._clients.setdefault(client, deque()).append((item, size))
        self.waiting += 1
        self.bytes += size

    def take(self) -> tuple[T, int]:
        """Return what comes next of the client whose turn it is; the client goes to the end."""
        client, items = self._clients.popitem(last=False)
        item, size = items.popleft()
        if items:
            self._clients[client] = items
        self.waiting -= 1
        self.bytes -= size
        return item, size


class Turns(Generic[T]):
    """Lines of things that wait, by party."""

    def __init__(self, bounds: Bounds) -> None:
        self.refused = 0
        """How many were refused, since too many waited already."""
        self._bounds = bounds
        self._lines: OrderedDict[str, _Line[T]] = OrderedDict()
        self._waiting = self._bytes = 0

    def __len__(self) -> int:
        return self._waiting

    def add(self, party: str, client: str, item: T, size: int = 0) -> bool:
        """Let something of `size` bytes wait; return False when too much does."""
        line = self._lines.get(party) or _Line[T](self._bounds)
        is_full = self._waiting >= self._bounds.of_all or self._bytes + size > self._bounds.bytes_of_all
        if is_full or not line.has_room(client, size):
            self.refused += 1
            return False
        line.add(client, item, size)
        self._lines[party] = line
        self._waiting += 1
        self._bytes += size
        return True

    def take(self) -> T | None:
        """Return what comes next of the party whose turn it is; the party goes to the end."""
        return self.take_of()[1]

    def take_of(self, but: Container[str] = ()) -> tuple[str, T | None]:
        """Return whose turn it is of the parties that are not among `but`, and what comes next; None: nothing does."""
        party = next((party for party in self._lines if party not in but), None)
        if party is None:
            return "", None
        line = self._lines.pop(party)
        item, size = line.take()
        self._waiting -= 1
        self._bytes -= size
        if line.waiting:
            self._lines[party] = line
        return party, item
