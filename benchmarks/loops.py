"""The compiled loops that ``benchmarks.kernels`` times, and their plain numpy counterpart.

`measure_into` is what the benchmark of the corpus measures: everything from an operation list to its fitness, as the
search does it for preset ``paper``. Each loop has a twin that repeats it many times, so that a call from the
interpreter does not count.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from benchmarks.evaluation import OPERATIONS, FloatArray
from common.expression.kernels import LANES, forward, reverse_block
from common.expression.operators import ARITY, CONSTANT, VARIABLE
from common.jit import kernel
from island_worker.evolution.kernels_fit import errors
from island_worker.evolution.kernels_tape import compile_tape
from island_worker.evolution.structures import Floats, Lists, Rows, Tape, Work, empty_tape, empty_work

REGISTER_STEPS: Final = 4
"""Multiplications, and additions, that `in_registers_into` does with each number."""

Instructions = list[tuple[int, int, int, float]]
"""Live nodes of one list: code, left, right (indices among them, or the variable's), constant."""


class Room(NamedTuple):
    """Scratch of the loops."""

    tape: Tape
    work: Work
    result: Floats
    """(2,) the errors of one individual."""


def room_for(nodes: int, rows: int) -> Room:
    """Return scratch for lists of `nodes` nodes on `rows` rows."""
    return Room(empty_tape(nodes), empty_work(nodes, rows), np.zeros(2))


@kernel
def measure_into(fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Write the mean absolute error of each list on `rows`: find its live nodes, evaluate them, compare."""
    tape = room.tape
    for p in range(fitness.shape[0]):
        count = compile_tape(lists.code[p], lists.left[p], lists.right[p], lists.constants[p], tape)
        forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, room.work.values)
        errors(room.work.values[count - 1], rows, room.work.lanes, room.result)
        fitness[p] = room.result[0]


@kernel
def measure_repeatedly(times: int, fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Do `measure_into` so many times."""
    for _ in range(times):
        measure_into(fitness, lists, rows, room)


@kernel
def _sweep(count: int, tape: Tape, rows: Rows, work: Work) -> None:
    """Carry the adjoint 1 of the last node down to all that `tape.depends` marks, over all rows."""
    for start in range(0, rows.length, LANES):
        for i in range(count):
            if tape.depends[i]:
                for k in range(LANES):
                    work.adjoints[i, k] = 0.0
        for k in range(LANES):
            work.adjoints[count - 1, k] = 1.0
        reverse_block(count, tape.code, tape.left, tape.right, tape.depends, work.values, start, work.adjoints)


@kernel
def differentiate_into(fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Do what `measure_into` does and a reverse sweep to every live constant of each list."""
    tape = room.tape
    for p in range(fitness.shape[0]):
        count = compile_tape(lists.code[p], lists.left[p], lists.right[p], lists.constants[p], tape)
        forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, room.work.values)
        for i in range(count):
            op = tape.code[i]
            tape.depends[i] = op == CONSTANT
            if op > CONSTANT:
                tape.depends[i] = tape.depends[tape.left[i]] or tape.depends[tape.right[i]]
        _sweep(count, tape, rows, room.work)
        errors(room.work.values[count - 1], rows, room.work.lanes, room.result)
        fitness[p] = room.result[0]


@kernel
def differentiate_repeatedly(times: int, fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Do `differentiate_into` so many times."""
    for _ in range(times):
        differentiate_into(fitness, lists, rows, room)


@kernel
def forward_repeatedly(times: int, count: int, rows: Rows, room: Room) -> None:
    """Evaluate the first `count` nodes of the tape so many times."""
    tape = room.tape
    for _ in range(times):
        forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, room.work.values)


@kernel
def gradient_repeatedly(times: int, count: int, rows: Rows, room: Room) -> None:
    """Evaluate the tape and sweep back over it so many times."""
    tape = room.tape
    for _ in range(times):
        forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, room.work.values)
        _sweep(count, tape, rows, room.work)


@kernel
def multiply_add_repeatedly(times: int, out: Floats, x: Floats) -> None:
    """Replace each of `out` by half of it and `x`, so many times: one load more than a node, and its store."""
    for _ in range(times):
        for k in range(x.shape[0]):
            out[k] = out[k] * 0.5 + x[k]


@kernel
def in_registers_repeatedly(times: int, out: Floats, x: Floats) -> None:
    """Replace each of `out` by a polynomial in `x` of degree `REGISTER_STEPS`, so many times."""
    for _ in range(times):
        for k in range(x.shape[0]):
            value = out[k]
            for _step in range(REGISTER_STEPS):
                value = value * x[k] + 0.5
            out[k] = value


def instructions(lists: Lists, p: int, tape: Tape) -> Instructions:
    """Return the live nodes of list `p`, for `fitness_by_numpy`."""
    count = compile_tape(lists.code[p], lists.left[p], lists.right[p], lists.constants[p], tape)
    parts = (tape.code, tape.left, tape.right, tape.constants)
    return list(zip(*(part[:count].tolist() for part in parts), strict=True))


def values_by_numpy(program: Instructions, inputs: FloatArray) -> FloatArray:
    """Return the output of a list on `inputs` (V, R), one numpy call for each node."""
    values: list[FloatArray] = []
    for code, left, right, constant in program:
        if code == VARIABLE:
            values.append(inputs[left])
        elif code == CONSTANT:
            values.append(np.full(inputs.shape[1], constant))
        else:
            values.append(OPERATIONS[code](values[left], values[right if ARITY[code] > 1 else left]))
    return values[-1]


def fitness_by_numpy(programs: Sequence[Instructions], inputs: FloatArray, target: FloatArray) -> FloatArray:
    """Return the mean absolute error of each list on the rows of `inputs` (V, R) and `target` (R,), NaN included."""
    with np.errstate(all="ignore"):
        return np.array([np.abs(values_by_numpy(each, inputs) - target).mean() for each in programs])


def operator_tape(code: int, nodes: int, tape: Tape) -> int:
    """Write two variables and then `nodes` nodes that apply `code` to them onto `tape`; return its length.

    All are marked as depending on what is fitted, so that a reverse sweep has work at each.
    """
    count = 2 + nodes
    tape.code[:2], tape.code[2:count] = VARIABLE, code
    tape.left[:count], tape.right[:count] = 0, 1
    tape.left[1] = 1
    tape.depends[:count] = True
    return count
