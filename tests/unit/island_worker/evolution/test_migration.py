"""The reshuffle: one permutation of all places, and blocks that are believed only when they add up."""

import math

import numpy as np
import pytest

from atoll_core.config import EvolutionConfig, JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import EXP
from atoll_core.wire.codec import decode_arrays, encode_arrays
from atoll_island_worker.evolution.migration import destinations, pack, senders, unpack
from tests.oracles.spaces import random_lists, space_of

ISLANDS, POPULATION = 5, 12
CONFIG = JobConfig(seed=9, evolution=EvolutionConfig(islands=ISLANDS, population=POPULATION))
SPACE = space_of()
ALLOWED = frozenset(SPACE.operators.tolist())


def blocks_for(island, epoch=0):
    """Return the populations of all islands and the blocks that are due at `island`."""
    populations = [random_lists(POPULATION, SPACE, seed) for seed in range(ISLANDS)]
    places = destinations(CONFIG, "x", epoch)
    sent = [pack(lists, places[source]) for source, lists in enumerate(populations)]
    return populations, {source: blocks[island] for source, blocks in enumerate(sent) if island in blocks}


@pytest.mark.parametrize("epoch", range(4))
def test_every_place_is_left_and_taken_exactly_once(epoch):
    places = destinations(CONFIG, "x", epoch)
    assert places.shape == (ISLANDS, POPULATION)
    assert sorted(places.ravel()) == list(range(ISLANDS * POPULATION))


def test_each_epoch_variable_and_seed_has_a_reshuffle_of_its_own():
    drawn = [(CONFIG, "x", 0), (CONFIG, "x", 1), (CONFIG, "y", 0), (CONFIG.model_copy(update={"seed": 10}), "x", 0)]
    assert len({destinations(*arguments).tobytes() for arguments in drawn}) == 4


def test_the_senders_of_an_island_are_the_others_whose_solutions_go_there():
    small = JobConfig(evolution=EvolutionConfig(islands=30, population=4))
    goes_to = destinations(small, "x", 3) // 4
    for island in range(30):
        assert senders(small, "x", 3, island) == {other for other in range(30) if island in goes_to[other]} - {island}


@pytest.mark.parametrize("island", range(ISLANDS))
def test_every_solution_arrives_whole_at_its_slot(island):
    populations, blocks = blocks_for(island)
    arrived = unpack(blocks, POPULATION, SPACE, ALLOWED)
    places = destinations(CONFIG, "x", 0)
    for source, slot in np.argwhere(places // POPULATION == island):
        target = places[source, slot] % POPULATION
        for column, sent in zip(arrived, populations[source], strict=True):
            assert column.dtype == sent.dtype
            np.testing.assert_array_equal(column[target], sent[slot])


def test_the_order_of_arrival_does_not_matter():
    _, blocks = blocks_for(2)
    backwards = dict(reversed(blocks.items()))
    for one, two in zip(*(unpack(arrived, POPULATION, SPACE, ALLOWED) for arrived in (blocks, backwards)), strict=True):
        np.testing.assert_array_equal(one, two)


def rewritten(block, **changes):
    header, arrays = decode_arrays(block)
    return encode_arrays(header, {name: changes.get(name, array) for name, array in arrays.items()})


def altered(block, name, place, value):
    _, arrays = decode_arrays(block)
    column = arrays[name].copy()
    column[place] = value
    return rewritten(block, **{name: column})


LAST = (0, SPACE.nodes - 1)
SPOILED = {
    "no bytes": lambda block: b"",
    "half of it": lambda block: block[: len(block) // 2],
    "something behind it": lambda block: block + b"x",
    "an array less": lambda block: encode_arrays({}, {"slots": decode_arrays(block)[1]["slots"]}),
    "a slot too many": lambda block: rewritten(block, slots=np.append(decode_arrays(block)[1]["slots"], 0)),
    "slots in a square": lambda block: rewritten(block, slots=decode_arrays(block)[1]["slots"][:, None]),
    "one slot that is no list": lambda block: rewritten(block, slots=np.array(3, np.int32)),
    "slots that are no numbers": lambda block: rewritten(block, slots=decode_arrays(block)[1]["slots"] * math.nan),
    "a slot that does not exist": lambda block: altered(block, "slots", 0, POPULATION),
    "a negative slot": lambda block: altered(block, "slots", 0, -1),
    "shorter lists": lambda block: rewritten(block, code=decode_arrays(block)[1]["code"][:, 1:]),
    "a scaling too short": lambda block: rewritten(block, scale=decode_arrays(block)[1]["scale"][:, :2]),
    "an operator of another job": lambda block: altered(block, "code", LAST, EXP),
    "an unknown operator": lambda block: altered(block, "code", LAST, 99),
    "a negative operator": lambda block: altered(block, "code", LAST, -1),
    "a terminal among the operators": lambda block: altered(block, "code", LAST, 0),
    "an operator among the terminals": lambda block: altered(block, "code", (0, 0), 2),
    "a cycle": lambda block: altered(block, "left", LAST, SPACE.nodes - 1),
    "a cycle on the right": lambda block: altered(block, "right", LAST, SPACE.nodes - 1),
    "a node before the first": lambda block: altered(block, "left", LAST, -1),
    "a variable that does not exist": lambda block: altered(altered(block, "code", (0, 0), 0), "left", (0, 0), 2),
    "operators that are no whole numbers": lambda block: rewritten(block, code=decode_arrays(block)[1]["code"] + 0.5),
}  # fmt: skip


@pytest.mark.parametrize("how", SPOILED)
def test_a_spoiled_block_is_refused(how):
    _, blocks = blocks_for(1)
    blocks[3] = SPOILED[how](blocks[3])
    with pytest.raises(RemoteProtocolError):
        unpack(blocks, POPULATION, SPACE, ALLOWED)


def test_missing_and_overlapping_blocks_are_refused():
    _, blocks = blocks_for(1)
    missing = {source: block for source, block in blocks.items() if source != 2}
    with pytest.raises(RemoteProtocolError, match="missing"):
        unpack(missing, POPULATION, SPACE, ALLOWED)
    with pytest.raises(RemoteProtocolError, match="taken"):
        unpack({**blocks, 2: blocks[3]}, POPULATION, SPACE, ALLOWED)
    twice = decode_arrays(blocks[3])[1]["slots"].copy()
    assert len(twice) > 1
    twice[1] = twice[0]
    with pytest.raises(RemoteProtocolError, match="taken"):
        unpack({**blocks, 3: rewritten(blocks[3], slots=twice)}, POPULATION, SPACE, ALLOWED)
