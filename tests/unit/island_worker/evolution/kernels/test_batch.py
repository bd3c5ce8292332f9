"""Lists measured in batches: the bits of one list after the other."""

import numpy as np
import pytest

from atoll.expression.operators import BY_NAME, VARIABLE
from atoll_island_worker.evolution.kernels.batch import BATCH, empty_batch, measure_lists
from atoll_island_worker.evolution.kernels.fit import errors
from atoll_island_worker.evolution.kernels.generation import residual_of_list
from atoll_island_worker.evolution.kernels.rows import padded_rows
from atoll_island_worker.evolution.structures import Fit, empty_lists, empty_tape, empty_work
from tests.oracles.spaces import DEFAULT, random_lists, space_of

AS_IT_STANDS = Fit(steps=0, terms=0, least=0, loss=0, gate=1.0)
ALL = tuple(BY_NAME)


def random_rows(count, variables=2, keeps_waves=True):
    random = np.random.default_rng(count)
    inputs, target = random.uniform(-3.0, 3.0, (variables, count)), random.normal(size=count)
    return padded_rows(inputs, target, keeps_waves)


def one_by_one(lists, rows):
    """Return the mean absolute and squared errors of each list, (P, 2), as single lists are measured."""
    nodes = lists.code.shape[1]
    tape, work, result = empty_tape(nodes), empty_work(nodes, rows.length), np.zeros((len(lists.code), 2))
    for p in range(len(lists.code)):
        residual_of_list(lists, p, rows, AS_IT_STANDS, tape, work)
        errors(rows, work, result[p])
    return result


def in_batches(lists, terminals, rows, loss=0):
    losses = np.zeros(len(lists.code))
    measure_lists(losses, lists, terminals, rows, loss, empty_batch(lists.code.shape[1], rows))
    return losses


def assert_same_bits(lists, terminals, rows):
    expected = one_by_one(lists, rows)
    for loss in (0, 1):
        assert in_batches(lists, terminals, rows, loss).tobytes() == expected[:, loss].tobytes()
    return expected


@pytest.mark.parametrize("count", [1, 2, 5, BATCH, BATCH + 1, 2 * BATCH + 6])
def test_any_number_of_lists_has_the_losses_of_each_by_itself(count):
    lists = random_lists(count, space_of(DEFAULT), seed=count)
    expected = assert_same_bits(lists, 7, random_rows(16))
    assert np.isfinite(expected).any()


@pytest.mark.parametrize("keeps_waves", [True, False])
@pytest.mark.parametrize("rows", [5, 16, 40])
def test_all_operators_at_any_number_of_rows(rows, keeps_waves):
    lists = random_lists(3 * BATCH, space_of(ALL), seed=rows)
    expected = assert_same_bits(lists, 7, random_rows(rows, keeps_waves=keeps_waves))
    assert np.isinf(expected).any()
    assert len(np.unique(expected)) > BATCH


@pytest.mark.parametrize(("terminals", "operators"), [(7, 57), (7, 58), (7, 130), (70, 60), (1, 1)])
def test_lists_of_any_length(terminals, operators):
    """Of 64 nodes and of more, with more terminals than a word has bits, and of two nodes."""
    space = space_of(DEFAULT, terminals, operators, variables=3)
    assert_same_bits(random_lists(BATCH, space, seed=operators), terminals, random_rows(16, variables=3))


def test_a_list_may_be_a_terminal_alone():
    lists = empty_lists(2, 1)
    lists.code[0], lists.left[0] = VARIABLE, 1
    lists.code[1], lists.constants[1] = 1, 2.5
    rows = random_rows(16)
    expected = assert_same_bits(lists, 1, rows)
    assert expected[1, 0] == pytest.approx(np.abs(rows.target - 2.5).mean())


def test_scratch_can_be_used_again():
    """Nothing of an earlier batch, with more levels and other operators, remains."""
    rows, space = random_rows(16), space_of(ALL)
    batch = empty_batch(space.nodes, rows)
    for seed, count in ((1, BATCH), (2, 10), (3, BATCH + 10)):
        lists = random_lists(count, space, seed)
        losses = np.zeros(count)
        measure_lists(losses, lists, 7, rows, 0, batch)
        assert losses.tobytes() == one_by_one(lists, rows)[:, 0].tobytes()


def test_what_is_not_finite_is_infinite():
    """1 / 0 at one row, and a residual whose square overflows."""
    lists = empty_lists(2, 4)
    lists.code[:] = [0, 1, 5, 2]
    lists.left[:, 2:], lists.right[:, 2:] = [1, 2], [0, 2]
    lists.constants[:, 1] = 1.0, 1e200
    rows = padded_rows(np.linspace(0.0, 1.0, 16)[None] + [[0.0]], np.zeros(16))
    assert np.isinf(in_batches(lists, 2, rows)).all()
    assert np.isinf(one_by_one(lists, rows)).all()
