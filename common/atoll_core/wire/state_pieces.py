"""States of islands in pieces that fit into messages: split by the answering side, assembled by the asking side.

Pure. A state counts only when all its bytes have arrived and have the announced digest.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.epochs import Piece
from atoll_core.wire.messages.limits import CHUNK_SIZE


class IslandState(NamedTuple):
    """The bytes of an island's state, and their SHA-256 in hex."""

    data: bytes
    digest: str

    @classmethod
    def of(cls, data: bytes) -> "IslandState":
        """Return the state with these bytes."""
        return cls(data, hashlib.sha256(data).hexdigest())

    @property
    def is_whole(self) -> bool:
        """Whether the bytes have the digest."""
        return isinstance(self.data, bytes) and hashlib.sha256(self.data).hexdigest() == self.digest


def split_states(
    islands: Sequence[int], offset: int, load: Callable[[int], IslandState], room: int = CHUNK_SIZE
) -> tuple[Piece, ...]:
    """Return pieces of states in the order of `islands`, the first one from `offset` on, `room` bytes at most.

    Raises:
        RemoteProtocolError: `offset` lies beyond the first state.
        Errors of `load`.
    """
    pieces: list[Piece] = []
    for island in islands:
        state = load(island)
        if offset >= len(state.data):
            raise RemoteProtocolError(f"byte {offset} was asked for of a state of {len(state.data)} bytes")
        data = state.data[offset : offset + room]
        pieces.append(Piece(island=island, size=len(state.data), digest=state.digest, offset=offset, data=data))
        room, offset = room - len(data), 0
        if room <= 0:
            break
    return tuple(pieces)


class Assembly:
    """The states of some islands, as far as their pieces have arrived."""

    def __init__(self, islands: Iterable[int]) -> None:
        self.states: Final[dict[int, IslandState]] = {}
        self._missing = list(islands)
        self._begun = b""
        self._whole_bytes = 0

    @property
    def is_complete(self) -> bool:
        """Whether all states have arrived."""
        return not self._missing

    @property
    def size(self) -> int:
        """Bytes that have arrived."""
        return self._whole_bytes + len(self._begun)

    @property
    def wanted(self) -> tuple[int, ...]:
        """The islands whose states are still missing, in order."""
        return tuple(self._missing)

    @property
    def offset(self) -> int:
        """Bytes that have arrived of the first missing state."""
        return len(self._begun)

    def take(self, pieces: Iterable[Piece]) -> list[int]:
        """Append the pieces that come next and ignore others; return the islands whose states are complete now.

        Raises:
            RemoteProtocolError: A state does not have its announced size or digest; it is received again.
        """
        whole = []
        for piece in pieces:
            if not self._missing or (piece.island, piece.offset) != (self._missing[0], len(self._begun)):
                continue
            self._begun += piece.data
            if len(self._begun) < piece.size and piece.data:
                continue
            data, self._begun = self._begun, b""
            state = IslandState.of(data)
            if len(data) != piece.size or state.digest != piece.digest:
                raise RemoteProtocolError(f"the state of island {piece.island} was damaged on its way")
            self.states[piece.island] = state
            self._whole_bytes += len(data)
            whole.append(self._missing.pop(0))
        return whole
