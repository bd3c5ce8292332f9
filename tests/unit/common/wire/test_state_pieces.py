"""States travel in pieces and count only when they are whole and undamaged."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.state_pieces import Assembly, IslandState, split_states

STATES = {island: IslandState.of(bytes([island]) * (10 + island)) for island in range(4)}


@given(st.integers(1, 60), st.lists(st.integers(0, 3), min_size=1, unique=True))
def test_whatever_fits_into_a_message_all_comes_in_the_end(room: int, islands: list[int]) -> None:
    assembly = Assembly(islands)
    while not assembly.is_complete:
        pieces = split_states(assembly.wanted, assembly.offset, STATES.__getitem__, room)
        assert sum(len(piece.data) for piece in pieces) <= room
        assembly.take(pieces)
    assert assembly.states == {island: STATES[island] for island in islands}


def test_an_answer_that_comes_twice_or_out_of_turn_changes_nothing() -> None:
    assembly = Assembly([0, 1])
    first = split_states([0, 1], 0, STATES.__getitem__, 15)
    assert assembly.take(first) == [0]
    assert (assembly.wanted, assembly.offset) == ((1,), 5)
    assert assembly.take(first) == []
    assert assembly.take(split_states([3], 0, STATES.__getitem__)) == []
    assert (assembly.wanted, assembly.offset) == ((1,), 5)


@pytest.mark.parametrize("changes", [{"digest": "0" * 64}, {"size": 9}, {"data": b""}])
def test_a_damaged_state_is_refused_and_begins_anew(changes: dict[str, object]) -> None:
    assembly = Assembly([0])
    (piece,) = split_states([0], 0, STATES.__getitem__)
    with pytest.raises(RemoteProtocolError, match="damaged"):
        assembly.take([piece.model_copy(update=changes)])
    assert (assembly.wanted, assembly.offset) == ((0,), 0)
    assert assembly.take([piece]) == [0]


def test_bytes_beyond_a_state_cannot_be_asked_for() -> None:
    with pytest.raises(RemoteProtocolError, match="byte 10 was asked for of a state of 10 bytes"):
        split_states([0], 10, STATES.__getitem__)
