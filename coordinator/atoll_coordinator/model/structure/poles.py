"""Poles: the places where an equation has no finite value, within the region of some points.

The region is sampled by lines between pairs of points. If a denominator changes its sign along a line, it is zero
somewhere on the line; bisection finds this zero. If the equation is bounded near the zero, as sin(x)/x at 0, it has no
pole. Doubt: a denominator that touches zero without a change of sign is found only if one of its factors changes its
sign.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import CONSTANT, DIVIDE, INVERSE, LOG, MULTIPLY, NEGATE, POW, SQUARE
from atoll_core.expression.program import Program

_HALVINGS: Final = 50
_NEAR: Final = (1e-4, 1e-5)
"""Two distances from a zero, as shares of a line. From the first to the second distance, a value grows tenfold near a
simple pole; a bounded value hardly changes."""
_GROWTH: Final = 10.0**0.5


def find_poles(program: Program, points: FloatArray, ends: FloatArray | None = None) -> list[Program]:
    """Return the parts of `program` that are zero at its poles in the region of `points` (V, R). Each part is returned
    once.

    If `ends` (V, R) are given, only the lines from `points` to `ends` are sampled; for example, `ends` may be the next
    points of a trajectory.
    """
    if ends is None:
        ends = points[:, np.random.default_rng(0).permutation(points.shape[1])]
    parts = dict.fromkeys(node for place in range(len(program)) for node in _singular_nodes(program, place))
    return [part for part in (_part(program, place) for place in parts) if _has_pole(program, part, points, ends)]


def _singular_nodes(program: Program, place: int) -> Iterator[int]:
    """Yield nodes such as denominators: if one of them is zero, the node at `place` is not finite."""
    code = int(program.operators[place])
    left, right = int(program.left[place]), int(program.right[place])
    if code in (INVERSE, LOG):
        yield from _factors(program, left)
    elif code == DIVIDE:
        yield from _factors(program, right)
    elif code == POW and program.operators[right] == CONSTANT and program.constants[right] < 0.0:
        yield from _factors(program, left)


def _factors(program: Program, place: int) -> Iterator[int]:
    """Yield the factors of a node; at a zero of the node, one factor is zero. Factors are used because an even power
    does not change its sign at a zero."""
    code = int(program.operators[place])
    left, right = int(program.left[place]), int(program.right[place])
    if code == MULTIPLY:
        yield from _factors(program, left)
        yield from _factors(program, right)
    elif code in (SQUARE, NEGATE, DIVIDE):
        yield from _factors(program, left)
    elif code != CONSTANT:
        yield place


def _part(program: Program, place: int) -> Program:
    end = place + 1
    return Program(program.operators[:end], program.left[:end], program.right[:end], program.constants[:end])


def _has_pole(program: Program, part: Program, points: FloatArray, ends: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        crosses = values_of(part, points) * values_of(part, ends) <= 0.0
    if not crosses.any():
        return False
    first, last = points[:, crosses], ends[:, crosses]
    sign = np.sign(values_of(part, first))
    low, high = np.zeros(first.shape[1]), np.ones(first.shape[1])
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        is_before = np.sign(values_of(part, first + middle * (last - first))) == sign
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    far, near = (
        np.abs([values_of(program, first + (low + side * share) * (last - first)) for side in (-1.0, 1.0)])
        for share in _NEAR
    )
    with np.errstate(all="ignore"):
        return bool((~np.isfinite(near) | (near > _GROWTH * far)).any())
