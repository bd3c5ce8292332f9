"""The compiled loops that ``benchmarks.kernels`` times.

The benchmark of the corpus times `measure_into`: all work from operation lists to fitness, one list after the other, as
in the search. For each loop there is a second kernel that repeats it many times, so that the time of the call from
Python is negligible.
"""

from typing import Final, NamedTuple

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.lanes import fill, place
from atoll_core.expression.kernels.tape import LANES, forward, reverse_block
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_island_worker.evolution.kernels.fit import errors, residual_of
from atoll_island_worker.evolution.kernels.tape import compile_tape
from atoll_island_worker.evolution.structures import Floats, Lists, Rows, Tape, Work, empty_tape, empty_work

_ZERO: Final = np.int64(0)
_ONE: Final = np.int64(1)


class Room(NamedTuple):
    """Scratch arrays of the loops."""

    tape: Tape
    work: Work
    result: Floats
    """(2,) mean absolute and mean squared error of one individual."""


def room_for(nodes: int, rows: Rows) -> Room:
    """Return scratch arrays for lists of `nodes` nodes on `rows`."""
    return Room(empty_tape(nodes), empty_work(nodes, rows.length), np.zeros(2))


@inlined
def _evaluate(count: int, rows: Rows, room: Room) -> None:
    """Evaluate the first `count` nodes of the tape on all `rows`."""
    tape = room.tape
    forward(
        count, tape.code, tape.left, tape.right, tape.constants, tape.wanted, rows.inputs, rows.waves, rows.length,
        room.work.values, room.work.functions,
    )  # fmt: skip


@inlined
def _error(lists: Lists, p: int, count: int, rows: Rows, room: Room) -> float:
    """Return the mean absolute error of list `p`, whose `count` nodes are on the tape and have been evaluated."""
    room.work.terms[0] = count - 1
    residual_of(_ONE, rows, room.work, lists.scale[p])
    errors(rows, room.work, room.result)
    return room.result[0]  # type: ignore[no-any-return]


@kernel
def measure_into(fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Write the mean absolute error of each list on `rows`: find its live nodes, evaluate them, subtract the target."""
    for p in range(fitness.shape[0]):
        count = compile_tape(lists, p, room.tape)
        _evaluate(count, rows, room)
        fitness[p] = _error(lists, p, count, rows, room)


@kernel
def measure_repeatedly(times: int, fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Call `measure_into` as often as `times` says."""
    for _ in range(times):
        measure_into(fitness, lists, rows, room)


@inlined
def _sweep(count: int, tape: Tape, rows: Rows, work: Work) -> None:
    """Propagate the adjoint 1 of the last node to all nodes marked in `tape.depends`, over all rows."""
    for start in range(_ZERO, rows.length, LANES):
        for i in range(count):
            if tape.depends[i]:
                fill(place(work.adjoints, i, _ZERO), 0.0)
        fill(place(work.adjoints, count - 1, _ZERO), 1.0)
        reverse_block(
            count, tape.code, tape.left, tape.right, tape.depends, work.values, start, work.adjoints, work.functions
        )


@kernel
def differentiate_into(fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Do the same as `measure_into`, and a reverse sweep to every live constant of each list."""
    tape = room.tape
    for p in range(fitness.shape[0]):
        count = compile_tape(lists, p, tape)
        _evaluate(count, rows, room)
        for i in range(count):
            op = tape.code[i]
            tape.depends[i] = op == CONSTANT
            if op > CONSTANT:
                tape.depends[i] = tape.depends[tape.left[i]] or tape.depends[tape.right[i]]
        _sweep(count, tape, rows, room.work)
        fitness[p] = _error(lists, p, count, rows, room)


@kernel
def differentiate_repeatedly(times: int, fitness: Floats, lists: Lists, rows: Rows, room: Room) -> None:
    """Call `differentiate_into` as often as `times` says."""
    for _ in range(times):
        differentiate_into(fitness, lists, rows, room)


@kernel
def forward_repeatedly(times: int, count: int, rows: Rows, room: Room) -> None:
    """Evaluate the first `count` nodes of the tape as often as `times` says."""
    for _ in range(times):
        _evaluate(count, rows, room)


@kernel
def gradient_repeatedly(times: int, count: int, rows: Rows, room: Room) -> None:
    """Evaluate the first `count` nodes of the tape and sweep back over them, as often as `times` says."""
    for _ in range(times):
        _evaluate(count, rows, room)
        _sweep(count, room.tape, rows, room.work)


def operator_tape(code: int, nodes: int, tape: Tape) -> int:
    """Write two variables and then `nodes` nodes that apply operator `code` to them onto `tape`; return its length.

    All nodes are marked as dependent on fitted constants, so that a reverse sweep visits each of them.
    """
    count = 2 + nodes
    tape.code[:2], tape.code[2:count] = VARIABLE, code
    tape.left[:count], tape.right[:count] = 0, 1
    tape.left[1] = 1
    tape.depends[:count] = True
    return count
