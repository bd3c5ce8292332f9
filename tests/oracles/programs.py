"""Programs written down by hand in tests."""

from collections.abc import Sequence

from atoll_core.expression.operators import CONSTANT
from atoll_core.expression.program import Program


def program_of(nodes: Sequence[float | tuple[int, ...]]) -> Program:
    """Return the program of `nodes`: a number is a constant, a tuple an operator code with its arguments."""
    rows = [(CONSTANT, 0, 0, node) if isinstance(node, float) else (*(*node, 0, 0, 0)[:3], 0.0) for node in nodes]
    return Program.of(rows)
