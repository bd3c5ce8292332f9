"""The reshuffle: after every epoch all solutions of all islands of a variable change places by one permutation.

The permutation is drawn from (seed, variable, epoch), so every island can compute it and it is never sent
(paper, section 2; docs/protocol.md). A block holds the solutions that one island sends to another, with their slots.
"""

import itertools
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.codec import decode_arrays, encode_arrays
from atoll_island_worker.evolution.structures import MOST_TERMS, Lists, Space, empty_lists

Slots = npt.NDArray[np.int64]

_KINDS: Final = {"slots": "i4", "code": "i1", "left": "i4", "right": "i4", "constants": "f8", "scale": "f8"}
"""Types of the arrays of a block."""


def destinations(config: JobConfig, variable: str, epoch: int) -> Slots:
    """Return the destination of every solution, shape (islands, P); a place is island * population + slot."""
    return _destinations(config.seed, variable, epoch, config.evolution.islands, config.evolution.population)


@lru_cache(maxsize=32)
def _destinations(seed: int, variable: str, epoch: int, islands: int, population: int) -> Slots:
    stream = Stream(stream_key(seed, variable, -1, epoch, "reshuffle"))
    return np.array(stream.permutation(islands * population), np.int64).reshape(islands, population)


def senders(config: JobConfig, variable: str, epoch: int, island: int) -> frozenset[int]:
    """Return the islands (never `island` itself) whose solutions the reshuffle of `epoch` sends to `island`."""
    goes_to = destinations(config, variable, epoch) // config.evolution.population
    return frozenset(np.flatnonzero((goes_to == island).any(axis=1)).tolist()) - {island}


def pack(lists: Lists, places: Slots) -> dict[int, bytes]:
    """Return a block for each destination island; `places` (P,) are the destinations of this island's solutions."""
    population = lists.code.shape[0]
    islands = places // population
    order = np.argsort(islands, kind="stable")
    sorted_islands, slots = islands[order], (places % population)[order].astype(np.int32)
    columns = {name: column[order] for name, column in lists._asdict().items()}
    columns = {name: a.astype(np.int32) if a.dtype == np.int16 else a for name, a in columns.items()}
    firsts = np.flatnonzero(np.diff(sorted_islands, prepend=-1)).tolist()
    blocks: dict[int, bytes] = {}
    for first, last in itertools.pairwise((*firsts, population)):
        arrays = {name: column[first:last] for name, column in columns.items()}
        blocks[int(sorted_islands[first])] = encode_arrays({}, {"slots": slots[first:last], **arrays})
    return blocks


def unpack(blocks: Mapping[int, bytes], population: int, space: Space, allowed: frozenset[int]) -> Lists:
    """Return the population that consists of the blocks, each solution at its slot.

    Raises:
        RemoteProtocolError: a block is malformed, has an invalid list, or the slots are not complete.
    """
    parsed = [_parsed(block, space) for _, block in sorted(blocks.items())]
    slots = np.concatenate([np.zeros(0, np.int64), *(slots for slots, _ in parsed)])
    if not ((slots >= 0) & (slots < population)).all():
        raise RemoteProtocolError("the solutions of a reshuffle have slots that do not exist")
    counts = np.bincount(slots, minlength=population)
    if (counts > 1).any():
        raise RemoteProtocolError(f"{int((counts > 1).sum())} slots are taken by several solutions of a reshuffle")
    if not counts.all():
        missing = int((counts == 0).sum())
        raise RemoteProtocolError(f"{missing} of {population} solutions are missing after a reshuffle")
    arrived = Lists(*(np.concatenate(columns) for columns in zip(*(part for _, part in parsed), strict=True)))
    check_nodes(arrived, space, allowed)
    lists = empty_lists(population, space.nodes)
    for column, values in zip(lists._asdict().values(), arrived, strict=True):
        column[slots] = values
    return lists


def _parsed(block: bytes, space: Space) -> tuple[Slots, Lists]:
    _, arrays = decode_arrays(block)
    count = arrays["slots"].size if "slots" in arrays else 0
    shapes = {"slots": (count,), "scale": (count, 1 + MOST_TERMS)}
    expected = {name: (kind, shapes.get(name, (count, space.nodes))) for name, kind in _KINDS.items()}
    actual = {name: (array.dtype.str[1:], array.shape) for name, array in arrays.items()}
    if actual != expected:
        raise RemoteProtocolError(f"a block of migrants holds {actual}, expected {expected}")
    return arrays["slots"].astype(np.int64), Lists(*(arrays[name] for name in Lists._fields))


def check_nodes(lists: Lists, space: Space, allowed: frozenset[int]) -> None:
    """Raise RemoteProtocolError unless every list is acyclic and uses only the operators of the job."""
    index = np.arange(space.nodes)
    is_terminal = index < space.terminals
    code = lists.code
    limit = np.where(is_terminal, np.where(code == VARIABLE, space.variables, 1), index)
    fits = np.where(is_terminal, (code == VARIABLE) | (code == CONSTANT), np.isin(code, sorted(allowed)))
    fits &= (lists.left >= 0) & (lists.left < limit) & (lists.right >= 0)
    fits &= lists.right < np.where(is_terminal, 1, index)
    if not fits.all():
        raise RemoteProtocolError("a list has a node that is impossible in this job")


def exchange_without_blocks(populations: Sequence[Lists], places: Slots) -> list[Lists]:
    """Return the populations of all islands after a reshuffle, for benchmarks that have all islands in one process.

    `places` (islands, P) are the destinations.
    """
    population = places.shape[1]
    columns = []
    for parts in zip(*populations, strict=True):
        column = np.empty_like(parts[0], shape=(places.size, *parts[0].shape[1:]))
        column[places.ravel()] = np.concatenate(parts)
        columns.append(column)
    firsts = range(0, places.size, population)
    return [Lists(*(column[first : first + population] for column in columns)) for first in firsts]
