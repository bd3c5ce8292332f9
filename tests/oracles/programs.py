"""Programs written down by hand in tests."""

from collections.abc import Sequence

import numpy as np

from atoll.expression.operators import CONSTANT
from atoll.expression.program import Program


def program_of(nodes: Sequence[float | tuple[int, ...]]) -> Program:
    """Return the program of `nodes`: a number is a constant, a tuple an operator code with its arguments."""
    rows = [(CONSTANT, 0, 0, node) if isinstance(node, float) else (*(*node, 0, 0, 0)[:3], 0.0) for node in nodes]
    codes, lefts, rights, constants = zip(*rows, strict=True)
    return Program(
        np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(constants, float)
    )
