"""Tapes, lists and rows for tests of the kernels, and slow, obvious versions of what is done to tapes."""

from collections.abc import Sequence

import numpy as np

from atoll_core.expression.kernels.tape import Floats, forward
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, DIVIDE, MULTIPLY, NEGATE, SUBTRACT
from atoll_core.expression.program import Program
from atoll_island_worker.evolution.front import from_program, from_tape, onto_tape, to_program
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import Lists, Rows, Tape, Work, empty_lists, empty_tape, empty_work

SPACE = 128


def tape_of(program: Program) -> tuple[Tape, int]:
    """Return a roomy tape that holds `program` as it stands, and its number of nodes."""
    tape = empty_tape(SPACE)
    return tape, onto_tape(from_program(program), tape)


def program_on(tape: Tape, count: int) -> Program:
    """Return the program that stands on `tape`."""
    return to_program(from_tape(tape, count))


def list_of(program: Program) -> Lists:
    """Return one list with the nodes of `program`, dead ones included."""
    lists = empty_lists(1, len(program))
    lists.code[0] = program.operators
    lists.left[0] = program.left
    lists.right[0] = program.right
    lists.constants[0] = program.constants
    return lists


def rows_of(inputs: Sequence[Sequence[float]] | Floats, target: Sequence[float] | Floats) -> Rows:
    """Return padded rows of `inputs` (V, R) and `target` (R,)."""
    return padded_rows(np.array(inputs, dtype=np.float64), np.array(target, dtype=np.float64))


def evaluate_tape(tape: Tape, count: int, rows: Rows, work: Work) -> None:
    """Write the kernels' value of every node on `tape` at every row into `work.values`."""
    tape.wanted[:count] = True
    forward(
        count, tape.code, tape.left, tape.right, tape.constants, tape.wanted, rows.inputs, rows.waves, rows.length,
        work.values, work.functions,
    )  # fmt: skip


def node_values(program: Program, inputs: Sequence[Sequence[float]] | Floats) -> Floats:
    """Return the kernels' value of every node of `program` at every row of `inputs` (V, R); shape (nodes, R)."""
    rows = rows_of(inputs, np.zeros(len(inputs[0])))
    tape, count = tape_of(program)
    work = empty_work(count, rows.length)
    evaluate_tape(tape, count, rows, work)
    return work.values[:, : rows.length]


def live_nodes(program: Program) -> list[int]:
    """Return the nodes that the output depends on, in order."""
    live = {len(program) - 1}
    for node in range(len(program) - 1, -1, -1):
        if node in live:
            live |= set(arguments(program, node))
    return sorted(live)


def arguments(program: Program, node: int) -> tuple[int, ...]:
    """Return the nodes that `node` is computed from."""
    return (int(program.left[node]), int(program.right[node]))[: ARITY[program.operators[node]]]


def top_level_terms(program: Program, most: int) -> set[int]:
    """Return the terms of `program` by their definition: what remains when the output is taken apart.

    A sum or difference gives way to its arguments as long as there are fewer than `most` terms; a negation, and a
    product or quotient with a constant, to the part that is no constant, always. Constants and repetitions go.
    """
    terms: list[int] = []
    waiting = [len(program) - 1]
    while waiting:
        terms = [node for node in dict.fromkeys(waiting) if program.operators[node] != CONSTANT]
        waiting = _taken_apart(program, terms, most)
    return set(terms)


def _taken_apart(program: Program, terms: list[int], most: int) -> list[int]:
    """Return the terms with the first of them that can be taken apart replaced by its parts; empty when none can."""
    for node in terms:
        code, parts = program.operators[node], arguments(program, node)
        constant = [program.operators[part] == CONSTANT for part in parts]
        scaled = code == NEGATE or (code == MULTIPLY and any(constant)) or (code == DIVIDE and constant[1])
        if scaled or (code in (ADD, SUBTRACT) and len(terms) < most):
            return [other for other in terms if other != node] + list(parts)
    return []
