"""A problem over some of its variables only, as an island searches it, and programs on their way out of it. Pure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from atoll_core.data.dataset import Problem
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program
from atoll_core.search.pareto import FrontEntry


def select_variables(problem: Problem, columns: Sequence[int]) -> Problem:
    """Return `problem` over the variables of these indices only."""
    inputs = np.ascontiguousarray(problem.inputs[list(columns)])
    return Problem(tuple(problem.names[column] for column in columns), inputs, problem.target)


def restore_variables(entry: FrontEntry, columns: Sequence[int]) -> FrontEntry:
    """Return a front member of a problem over `columns` as one of the whole problem."""
    program = Program.from_bytes(entry.program, len(columns))
    left = program.left.copy()
    is_variable = program.operators == VARIABLE
    left[is_variable] = np.array(columns, np.int16)[left[is_variable]]
    return replace(entry, program=replace(program, left=left).to_bytes())
