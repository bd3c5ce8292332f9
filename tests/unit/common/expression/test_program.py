"""Programs as bytes and under construction: nothing is accepted that refers to nodes that do not exist."""

import struct

import pytest

from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import ADD, CONSTANT, MULTIPLY, NEGATE, OPERATORS, VARIABLE
from atoll_core.expression.program import MAX_NODES, Program, ProgramBuilder, check_program_bytes
from atoll_core.expression.text.infix import to_infix
from tests.oracles.programs import program_of


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


NAMES = ("x", "y")


def text_of(builder, output):
    return to_infix(builder.program(output), NAMES)


def test_equal_nodes_are_one_and_appended_ones_stay_apart():
    builder = ProgramBuilder()
    assert builder.constant(2.0) == builder.constant(2.0)
    assert builder.append(CONSTANT, value=2.0) != builder.append(CONSTANT, value=2.0)


def test_a_program_holds_what_its_output_depends_on():
    builder = ProgramBuilder()
    builder.add(VARIABLE, 1)
    output = builder.build((NEGATE, (VARIABLE, 0)))
    builder.constant(3.0)
    assert builder.program(output) == program_of([(VARIABLE, 0), (NEGATE, 0)])


def test_nodes_of_an_expression_may_be_those_of_a_list_that_was_copied():
    builder = ProgramBuilder()
    builder.constant(7.0)
    places = builder.copy(program_of([(VARIABLE, 1), (NEGATE, 0)]).nodes())
    assert text_of(builder, builder.build((MULTIPLY, 1, 0), places)) == "-y**2"
