"""The states with which a term begins at a checkpoint, on their way from the coordinator. Pure."""

from collections.abc import Sequence

from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.workers import Placement
from atoll_core.wire.state_pieces import Assembly


class StateTransfer:
    """The states of some islands at the epoch at which a placement begins; one question at a time."""

    def __init__(self, placement: Placement, islands: Sequence[int]) -> None:
        self._placement = placement
        self._assembly = Assembly(islands)
        self._is_asked = False

    def due_fetch(self) -> PullStates | None:
        """Return the question for what is still missing, if there is anything and no question is under way."""
        wanted = self._assembly.wanted
        if not wanted or self._is_asked:
            return None
        self._is_asked = True
        placed = self._placement
        return PullStates(
            job=placed.job,
            variable=placed.variable,
            term=placed.term,
            epoch=placed.epoch,
            islands=wanted,
            offset=self._assembly.offset,
        )

    def take(self, body: States | None) -> tuple[bool, list[int]]:
        """Take in an answer; return whether it brought anything, and the islands whose states are whole by it.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        self._is_asked = False
        before = (self._assembly.wanted, self._assembly.offset)
        whole = self._assembly.take(body.pieces if body is not None else ())
        return (self._assembly.wanted, self._assembly.offset) != before, whole

    def hand_over(self, island: int) -> bytes:
        """Return the state of an island, once."""
        return self._assembly.states.pop(island).data
