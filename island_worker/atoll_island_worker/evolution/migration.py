"""The reshuffle: after every epoch all solutions of all islands of a variable change places by one permutation.

The permutation is drawn from (seed, variable, epoch), so every island can compute it and it is never sent
(paper, section 2; docs/protocol.md). A block holds the solutions that one island sends to another, with their slots.
"""

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
    return {
        int(island): _block(lists, np.flatnonzero(islands == island), places % population)
        for island in np.unique(islands)
    }


def _block(lists: Lists, rows: Slots, slots: Slots) -> bytes:
    arrays = {name: column[rows] for name, column in lists._asdict().items()}
    arrays = {name: a.astype(np.int32) if a.dtype == np.int16 else a for name, a in arrays.items()}
    return encode_arrays({}, {"slots": slots[rows].astype(np.int32), **arrays})


def unpack(blocks: Mapping[int, bytes], population: int, space: Space, allowed: frozenset[int]) -> Lists:
    """Return the population that consists of the blocks, each solution at its slot.

    Raises:
        RemoteProtocolError: a block is malformed, has an invalid list, or the slots are not complete.
    """
    lists = empty_lists(population, space.nodes)
    taken = np.zeros(population, np.bool_)
    for source, block in sorted(blocks.items()):
        slots, part = _parsed(block, space, allowed)
        exist = ((slots >= 0) & (slots < population)).all()
        if not exist or taken[slots].any() or len(np.unique(slots)) < len(slots):
            raise RemoteProtocolError(f"the solutions from island {source} claim slots that are taken or do not exist")
        taken[slots] = True
        for column, values in zip(lists._asdict().values(), part, strict=True):
            column[slots] = values
    if not taken.all():
        missing = int(population - taken.sum())
        raise RemoteProtocolError(f"{missing} of {population} solutions are missing after a reshuffle")
    return lists


def _parsed(block: bytes, space: Space, allowed: frozenset[int]) -> tuple[Slots, Lists]:
    _, arrays = decode_arrays(block)
    count = arrays["slots"].size if "slots" in arrays else 0
    shapes = {"slots": (count,), "scale": (count, 1 + MOST_TERMS)}
    expected = {name: (kind, shapes.get(name, (count, space.nodes))) for name, kind in _KINDS.items()}
    actual = {name: (array.dtype.str[1:], array.shape) for name, array in arrays.items()}
    if actual != expected:
        raise RemoteProtocolError(f"a block of migrants holds {actual}, expected {expected}")
    slots, lists = arrays["slots"].astype(np.int64), Lists(*(arrays[name] for name in Lists._fields))
    check_nodes(lists, space, allowed)
    return slots, lists


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
