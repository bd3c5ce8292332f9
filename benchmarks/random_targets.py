"""Random functions of one variable that a search can be set to find: for the second panel of Figure 1.

A target is an operation list of which every node is live, its one terminal the variable: constants would have to be
met by mutation, and a target with them is hardly ever found exactly by the algorithm of Table II.
"""

from typing import Final

import numpy as np

from benchmarks.evaluation import evaluate
from common.dataset import FloatArray
from common.expression.algebra import simplify_program
from common.expression.operators import BY_NAME, VARIABLE
from common.expression.program import Program
from common.seeding import Stream, stream_key

LARGEST: Final = 8
"""Operators of a target at most, before it is simplified."""

SPREAD: Final = (1e-2, 1e3)
"""Bounds of the standard deviation of a target's values."""


def random_targets(number: int, operators: tuple[str, ...], x: FloatArray) -> list[Program]:
    """Return the first `number` targets: simplified, different, finite at `x`, neither flat nor steep.

    Drawn operator by operator, with arguments among all earlier nodes; what is simpler than the variable times itself
    is left out.
    """
    stream = Stream(stream_key(0, "figure1", -1, 0, "targets"))
    codes = [BY_NAME[name].code for name in operators]
    targets: dict[bytes, Program] = {}
    while len(targets) < number:
        drawn = simplify_program(_drawn(stream, codes))
        if len(drawn) > 1 and _is_fit(drawn, x):
            targets[drawn.to_bytes()] = drawn
    return list(targets.values())


def _drawn(stream: Stream, codes: list[int]) -> Program:
    count = 1 + stream.below(LARGEST)
    operators, left, right = [VARIABLE], [0], [0]
    for node in range(1, count + 1):
        operators.append(codes[stream.below(len(codes))])
        left.append(stream.below(node))
        right.append(stream.below(node))
    columns = (np.array(operators, np.int8), np.array(left, np.int16), np.array(right, np.int16))
    return Program(*columns, np.zeros(count + 1))


def _is_fit(program: Program, x: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        values = evaluate(program, [x])
        return bool(np.isfinite(values).all()) and SPREAD[0] <= float(values.std()) <= SPREAD[1]
