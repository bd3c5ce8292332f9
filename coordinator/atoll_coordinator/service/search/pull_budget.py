"""Decides which states of checkpoints are pulled from workers during the search, within a limit on memory. Pure.

While no checkpoint is being written, the checkpoint that was begun first always continues. So no checkpoint waits for
ever, and a checkpoint that is larger than the limit is gathered alone.
"""

from collections.abc import Mapping
from typing import Final

from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey, Checkpoint
from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.limits import CHUNK_SIZE

MAX_PULLS: Final = 4
"""Pulls of states at the same time; each answer has at most 4 MB."""

MAX_BYTES: Final = 256 * 1024**2
"""Bytes of states that are pulled, gathered or written at the same time; the oldest checkpoint may exceed it."""


class PullBudget:
    """All checkpoints that are being gathered or written."""

    def __init__(self) -> None:
        self._pulls = 0
        self._gathered: dict[
            ArchipelagoKey, int
        ] = {}  # bytes of each checkpoint, in the order in which checkpoints were begun
        self._written: dict[ArchipelagoKey, int] = {}
        self._waiting: dict[ArchipelagoKey, None] = {}

    @property
    def held_bytes(self) -> int:
        """Bytes of all states in memory."""
        return sum(self._gathered.values()) + sum(self._written.values())

    @property
    def waiting(self) -> tuple[ArchipelagoKey, ...]:
        """The archipelagos whose pulls wait until other pulls have ended, or other checkpoints are written."""
        return tuple(self._waiting)

    def begin_round(self, archipelagos: Mapping[ArchipelagoKey, Archipelago]) -> None:
        """Forget checkpoints whose archipelago is no longer open, or has lost its placement."""
        for key in list(self._gathered):
            if key not in archipelagos or archipelagos[key].gathered_bytes is None:
                del self._gathered[key]
        self._waiting.clear()

    def next_pulls(self, archipelago: Archipelago) -> list[tuple[str, PullStates]]:
        """Return the pulls of states that are due and for which there is memory, each with its worker."""
        wanted = MAX_PULLS - self._pulls
        is_first = not self._written and next(iter(self._gathered), archipelago.key) == archipelago.key
        room = (MAX_BYTES - self.held_bytes) // CHUNK_SIZE - self._pulls
        length_limit = wanted if is_first else min(wanted, room)
        pulls = archipelago.next_pulls(length_limit)
        self._waiting.pop(archipelago.key, None)
        if archipelago.has_pulls:
            self._waiting[archipelago.key] = None
        if pulls:
            self._gathered.setdefault(archipelago.key, 0)
        self._pulls += len(pulls)
        return pulls

    def take_complete_checkpoint(self, archipelago: Archipelago) -> Checkpoint | None:
        """Return the checkpoint that can be written now, each only once; it counts as being written."""
        checkpoint = archipelago.take_complete_checkpoint()
        if checkpoint is not None:
            self._gathered.pop(archipelago.key, None)
            self._written[archipelago.key] = checkpoint.size
        return checkpoint

    def add_states(self, archipelago: Archipelago | None, worker: str, pull: PullStates, body: States | None) -> None:
        """Add the answer to a pull; None: there was no answer.

        Raises:
            RemoteProtocolError: A state was damaged in transit; it is pulled again.
        """
        self._pulls -= 1
        if archipelago is None:
            return
        archipelago.add_states(worker, pull, body)
        if archipelago.gathered_bytes is None:
            self._gathered.pop(archipelago.key, None)
        elif archipelago.key in self._gathered:
            self._gathered[archipelago.key] = archipelago.gathered_bytes

    def mark_written(self, checkpoint: Checkpoint) -> None:
        """Record that a checkpoint has been written."""
        self._written.pop(checkpoint.key, None)
