"""What is known of an equation beforehand, as an island uses it: allowed variables, and guesses to begin from. Pure.

An equation that may use some of the variables only is searched over just those, as if there were no others; programs
are rewritten when they leave the island.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from common.config import JobConfig
from common.dataset import Problem
from common.errors import LocalProtocolError
from common.expression.operators import ARITY, BY_NAME, VARIABLE
from common.expression.parse import from_infix
from common.expression.placing import PlacedNode, placed
from common.expression.program import Program
from common.pareto import FrontEntry
from island_worker.evolution.structures import Lists


def narrowed(problem: Problem, columns: Sequence[int]) -> Problem:
    """Return `problem` over the variables of these indices only."""
    inputs = np.ascontiguousarray(problem.inputs[list(columns)])
    return Problem(tuple(problem.names[column] for column in columns), inputs, problem.target)


def widened(entry: FrontEntry, columns: Sequence[int]) -> FrontEntry:
    """Return a front member of a problem `narrowed` to `columns` as one of the whole problem."""
    program = Program.from_bytes(entry.program, len(columns))
    left = program.left.copy()
    is_variable = program.operators == VARIABLE
    left[is_variable] = np.array(columns, np.int16)[left[is_variable]]
    return replace(entry, program=replace(program, left=left).to_bytes())


def guessed_nodes(problem: Problem, config: JobConfig) -> tuple[tuple[PlacedNode, ...], ...]:
    """Return the lists of the guesses for the equation of `problem`, over its allowed variables.

    Raises:
        LocalProtocolError: the number of terminals is not resolved.
        UsageError: a guess does not fit; the coordinator refuses such jobs.
    """
    space, variable = config.space, problem.target.variable
    if space.terminals is None:
        raise LocalProtocolError("space.terminals is not resolved")
    allowed = [problem.names[column] for column in space.columns_for(variable, problem.names)]
    operators = [BY_NAME[name].code for name in space.operators_for(variable)]
    texts = config.prior.guesses.get(variable, ())
    return tuple(placed(from_infix(text, allowed), operators, space.terminals, space.operator_nodes) for text in texts)


def place_guesses(lists: Lists, guesses: Sequence[Sequence[PlacedNode]]) -> None:
    """Write the guesses over the first individuals, one each.

    Nodes that a guess leaves free, and second arguments that it does not use, stay as they were drawn.
    """
    for p, nodes in enumerate(guesses):
        for node in nodes:
            lists.code[p, node.index] = node.code
            lists.left[p, node.index] = node.left
            lists.constants[p, node.index] = node.constant
            if ARITY[node.code] != 1:
                lists.right[p, node.index] = node.right
