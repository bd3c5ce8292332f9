"""How many nats it takes to write an equation down, before its constants: the simpler, the more plausible.

Sums, products and whole powers are common in equations of motion, functions less so, functions inside functions rare
(compare the counts of Guimerà et al. 2020 in a corpus of named equations).
"""

from functools import lru_cache
from typing import Final

import numpy as np

from atoll.expression.operators import ARITY, CONSTANT, DIVIDE, INVERSE, MULTIPLY, NEGATE, POW, SQUARE, VARIABLE
from atoll.expression.program import Program, structure

LEAF: Final = 1.4
PLAIN: Final = 1.4
QUOTIENT: Final = 2.1
FUNCTION: Final = 3.5
NESTED: Final = 5.0
AGAIN: Final = 1.4
"""Nats of a further use of what is there already."""

_PLAIN: Final = range(2, 5)


def structure_nats(program: Program) -> float:
    """Return the nats of a program without the values of its constants."""
    return _nats_of(structure(program), len(program))


@lru_cache(maxsize=20_000)
def _nats_of(its: bytes, size: int) -> float:
    """Return the nats of a structure of so many nodes: a descent meets the same one many times."""
    codes = np.frombuffer(its, np.int8, size).tolist()
    lefts, rights = np.frombuffer(its, np.int16, 2 * size, size).reshape(2, size).tolist()
    total = 0.0
    has_function: list[bool] = []
    uses = [0] * size
    for code, left, right in zip(codes, lefts, rights, strict=True):
        arguments = (left, right)[: ARITY[code]]
        inner = any(has_function[argument] for argument in arguments)
        calls = is_function(code)
        has_function.append(inner or calls)
        total += _nats(code) + (NESTED if inner and calls else 0.0)
        for argument in arguments:
            uses[argument] += 1
    leaves = [code in (VARIABLE, CONSTANT) for code in codes]
    return total + sum((LEAF if leaf else AGAIN) * max(count - 1, 0) for count, leaf in zip(uses, leaves, strict=True))


def is_function(code: int) -> bool:
    """Tell whether an operator is a function such as a sine, neither algebra nor a leaf."""
    return ARITY[code] == 1 and code not in (SQUARE, NEGATE, INVERSE)


def _nats(code: int) -> float:
    if not ARITY[code]:
        return LEAF
    if code == NEGATE:
        return 0.0
    if code in (DIVIDE, INVERSE):
        return QUOTIENT
    if code in _PLAIN or code in (SQUARE, MULTIPLY):
        return PLAIN
    return FUNCTION if is_function(code) or code == POW else PLAIN
