"""Random programs for property tests: any operators, shared and dead nodes, awkward constants."""

import numpy as np
from hypothesis import strategies as st

from atoll_core.expression.operators import ARITY, CONSTANT, OPERATORS, VARIABLE
from atoll_core.expression.program import Program

NAMES = ("x", "y", "θ")

_HOSTILE = (
    "sin cos tan cot exp log sqrt abs Abs tanh pi e E I S N inf nan sin_theta cos_theta sint cost sinx cosx tanx logs "
    "expx in lambda None True if c c1 inner m s kg e5 E1 x_1 x2 _ __ a np SIZE t d dx θ π µ ſin 価 sin_ cos_"
)
HOSTILE = _HOSTILE.split()
"""Names that are functions, begin or end like them, are constants, keywords, units or numbers elsewhere."""

CONSTANTS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 0.5, 1e-300, 1e22, 1e16]),
    st.floats(-10.0, 10.0, allow_nan=False),
    st.floats(allow_nan=False, allow_infinity=False),
)
VALUES = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 2.0]), st.floats(-20.0, 20.0, allow_nan=False))
ROWS = st.tuples(*(VALUES for _ in NAMES))


@st.composite
def programs(draw: st.DrawFn, largest: int = 16, constants: st.SearchStrategy[float] = CONSTANTS) -> Program:
    """Draw a valid program of at most `largest` nodes over `NAMES`; it may have dead nodes."""
    count = draw(st.integers(1, largest))
    rows = []
    for index in range(count):
        code = draw(st.sampled_from(range(len(OPERATORS)) if index else (VARIABLE, CONSTANT)))
        left = right = 0
        if code == VARIABLE:
            left = draw(st.integers(0, len(NAMES) - 1))
        elif code != CONSTANT:
            left = draw(st.integers(0, index - 1))
            right = draw(st.integers(0, index - 1)) if ARITY[code] == 2 else 0
        rows.append((code, left, right, draw(constants) if code == CONSTANT else 0.0))
    codes, lefts, rights, values = zip(*rows, strict=True)
    return Program(
        np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(values, float)
    )


HOSTILE_NAMES = st.lists(st.sampled_from(HOSTILE), min_size=len(NAMES), max_size=len(NAMES), unique=True)
