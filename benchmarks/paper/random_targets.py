"""Random functions of one variable that a search can be set to find: for the second panel of Figure 1.

A target is an operation list of which every node is live, its one terminal the variable: constants would have to be
met by mutation, and a target with them is hardly ever found exactly by the algorithm of Table II.
"""

from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import node_values
from atoll_core.expression.operators import BY_NAME, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.expression.simplification import simplify_program
from atoll_core.search.seeding import Stream, stream_key

MOST_OPERATORS: Final = 10
"""Operators of a target at most, before it is simplified."""

LEAST_SIZE: Final = 3
"""Nodes of a target at least, afterwards."""

FLAT: Final = 1e-9
"""Range of values that counts as constant."""

SPREAD: Final = (1e-2, 1e3)
"""Bounds of the standard deviation of a target's values."""


def random_targets(number: int, operators: tuple[str, ...], x: FloatArray) -> list[Program]:
    """Return the first `number` targets: simplified, different, finite at `x`, neither flat nor steep.

    Drawn operator by operator, with arguments among all earlier nodes. None has a part that is constant, such as x/x,
    since a target's size would then say little.
    """
    stream = Stream(stream_key(0, "figure1", -1, 0, "targets"))
    codes = [BY_NAME[name].code for name in operators]
    targets: dict[bytes, Program] = {}
    while len(targets) < number:
        drawn = simplify_program(_drawn(stream, codes))
        if len(drawn) >= LEAST_SIZE and _is_fit(drawn, x):
            targets[drawn.to_bytes()] = drawn
    return list(targets.values())


def _drawn(stream: Stream, codes: list[int]) -> Program:
    count = 1 + stream.below(MOST_OPERATORS)
    operators, left, right = [VARIABLE], [0], [0]
    for node in range(1, count + 1):
        operators.append(codes[stream.below(len(codes))])
        left.append(stream.below(node))
        right.append(stream.below(node))
    columns = (np.array(operators, np.int8), np.array(left, np.int16), np.array(right, np.int16))
    return Program(*columns, np.zeros(count + 1))


def _is_fit(program: Program, x: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        *parts, values = node_values(program, x[np.newaxis])
        varies = all(float(np.ptp(part)) > FLAT for part in parts)
        return varies and bool(np.isfinite(values).all()) and SPREAD[0] <= float(values.std()) <= SPREAD[1]
