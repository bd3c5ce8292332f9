"""Spaces and populations for tests of the evolution."""

import numpy as np

from common.expression.operators import BY_NAME
from island_worker.evolution.kernels_random import Stream
from island_worker.evolution.kernels_variation import random_list
from island_worker.evolution.structures import Lists, Space, empty_lists

DEFAULT = ("+", "-", "*", "/", "sin", "cos")


def space_of(
    names: tuple[str, ...] = DEFAULT,
    terminals: int = 7,
    operators: int = 25,
    variables: int = 2,
    scales: tuple[float, ...] = (1.0,),
    mutation: float = 0.05,
    crossover: float = 0.75,
) -> Space:
    """Return a space as an island's setting makes it."""
    codes = np.array(sorted(BY_NAME[name].code for name in names), np.int64)
    return Space(terminals, terminals + operators, variables, codes, np.array(scales), crossover, mutation)


def stream_of(seed: int) -> Stream:
    """Return a stream for kernels."""
    return np.array([seed], np.uint64)


def random_lists(count: int, space: Space, seed: int) -> Lists:
    """Return `count` random lists."""
    lists, stream = empty_lists(count, space.nodes), stream_of(seed)
    for p in range(count):
        random_list(lists, p, space, stream)
    return lists
