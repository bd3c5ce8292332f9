"""Programs from the wire: canonical bytes come back, and nothing that refers to what is not there gets in."""

import struct

import pytest

from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import ADD, CONSTANT, NEGATE, OPERATORS, VARIABLE
from atoll_core.expression.program import MAX_NODES, Program, check_program_bytes


def packed(*nodes: tuple[int, int, int], constants: tuple[float, ...] = ()) -> bytes:
    codes, left, right = zip(*nodes, strict=True)
    count = len(nodes)
    return struct.pack(f"<B{count}b{count}h{count}h{len(constants)}d", count, *codes, *left, *right, *constants)


def test_canonical_bytes_come_back() -> None:
    data = packed((VARIABLE, 1, 0), (CONSTANT, 0, 0), (ADD, 0, 1), (NEGATE, 2, 0), constants=(2.5,))
    check_program_bytes(data, 2)
    program = Program.from_bytes(data, 2)
    assert program.to_bytes() == data
    assert program.constants.tolist() == [0.0, 2.5, 0.0, 0.0]


@pytest.mark.parametrize(
    "data",
    [
        packed((VARIABLE, 2, 0)),
        packed((VARIABLE, -1, 0)),
        packed((VARIABLE, 0, 1)),
        packed((CONSTANT, 1, 0), constants=(1.0,)),
        packed((CONSTANT, 0, 0)),
        packed((VARIABLE, 0, 0), constants=(1.0,)),
        packed((VARIABLE, 0, 0), (ADD, 0, 1)),
        packed((VARIABLE, 0, 0), (ADD, 1, 0)),
        packed((VARIABLE, 0, 0), (NEGATE, 0, 1)),
        packed((ADD, 0, 0)),
        packed((len(OPERATORS), 0, 0)),
        packed((-1, 0, 0)),
        b"",
        b"\x00",
        bytes([MAX_NODES + 1]),
        b"\x05\x00",
    ],
)
def test_what_cannot_be_a_program_is_refused(data: bytes) -> None:
    with pytest.raises(RemoteProtocolError):
        Program.from_bytes(data, 2)
    with pytest.raises(RemoteProtocolError):
        check_program_bytes(data, 2)
