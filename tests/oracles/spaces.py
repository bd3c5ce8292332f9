"""Spaces and populations for tests of the evolution."""

from typing import Any

import numpy as np

from atoll_core.expression.operators import BY_NAME
from atoll_island_worker.evolution.kernels.random import Stream
from atoll_island_worker.evolution.kernels.variation import random_list
from atoll_island_worker.evolution.structures import Coevolution, Lists, Space, empty_lists

DEFAULT = ("+", "-", "*", "/", "sin", "cos")


def space_of(
    names: tuple[str, ...] = DEFAULT,
    terminals: int = 7,
    operators: int = 25,
    variables: int = 2,
    scales: tuple[float, ...] = (1.0,),
    mutation: float = 0.05,
    crossover: float = 0.75,
    steps: int = 0,
    **reading: Any,
) -> Space:
    """Return a space as an island's setting makes it."""
    codes = np.array(sorted(BY_NAME[name].code for name in names), np.int64)
    return Space(
        terminals, terminals + operators, variables, codes, np.array(scales), crossover, mutation, steps, **reading
    )


def stream_of(seed: int) -> Stream:
    """Return a stream for kernels."""
    return np.array([seed], np.uint64)


def random_lists(count: int, space: Space, seed: int) -> Lists:
    """Return `count` random lists."""
    lists, stream = empty_lists(count, space.nodes), stream_of(seed)
    for p in range(count):
        random_list(lists, p, space, stream)
    return lists


def empty_coevolution(
    space: Space, predictors: int = 1, sample: int = 1, trainers: int = 1, rows: int = 1
) -> Coevolution:
    """Return predictors of `sample` rows and trainers on `rows`, not yet drawn; by default of no use to anybody."""
    return Coevolution(
        predictors=np.zeros((predictors, sample), np.int64),
        quality=np.zeros(predictors),
        trainers=empty_lists(trainers, space.nodes),
        exact=np.zeros(trainers),
        losses=np.zeros((trainers, rows)),
        born=np.zeros(trainers, np.int64),
        best=np.zeros(1, np.int64),
        clock=np.zeros(1, np.int64),
        due=np.zeros(2, np.bool_),
    )
