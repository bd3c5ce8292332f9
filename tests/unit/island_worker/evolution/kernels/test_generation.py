"""A generation: pairs, crowding, counts of evaluations, and individuals after the fit of their constants."""

import math

import numpy as np
import pytest

from atoll_core.expression.operators import CONSTANT
from atoll_core.search.seeding import Stream
from atoll_island_worker.evolution.kernels.generation import (
    FITTING,
    OFFSPRING,
    PARTS,
    REEVALUATION,
    advance,
    develop,
    measure_all,
    residual_of_list,
)
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.kernels.variation import cross, mutate
from atoll_island_worker.evolution.structures import Coevolving, Fit, empty_lists, empty_scratch
from tests.oracles import fitting
from tests.oracles import variation as oracle
from tests.oracles.spaces import empty_coevolution, random_lists, space_of, stream_of

POPULATION, ROWS = 16, 24
SPACE = space_of(variables=2)
ALONE = Coevolving(0, 0.0, 1)
"""Settings without predictors."""

TERMS = Fit(0, 3, 2, 0, 0.25)
FITTED, GATED, PLAIN = Fit(4, 3, 2, 0, math.inf), Fit(4, 3, 2, 0, 0.25), Fit(0, 0, 2, 0, 0.25)


class Arena:
    """A population on some rows, with all arrays that a generation needs."""

    def __init__(self, options=FITTED, seed=1, **variation):
        random = np.random.default_rng(seed)
        inputs = random.uniform(0.5, 3.0, (2, ROWS))
        self.options, self.space = options, SPACE._replace(**variation)
        self.rows = padded_rows(inputs, inputs[0] * inputs[1] + np.sin(inputs[0]) + 0.1 * random.normal(size=ROWS))
        self.lists = random_lists(POPULATION, SPACE, seed)
        self.fitness = np.full(POPULATION, np.inf)
        self.scratch = empty_scratch(POPULATION, SPACE.nodes, 2, ROWS, ROWS)
        self.counters = np.zeros(len(PARTS), np.int64)
        self.stream = stream_of(seed)
        self.remeasure()

    def remeasure(self):
        measure_all(
            self.lists, self.fitness, self.rows, self.options, self.scratch, self.counters, np.int64(REEVALUATION)
        )

    def develop(self, lists, p, ceiling):
        s = self.scratch
        return develop(
            lists, p, self.rows, self.options, ceiling, s.tape, s.near, s.result, self.counters, np.int64(OFFSPRING)
        )

    def generation(self, generations=1):
        return advance(
            generations, self.lists, self.fitness, empty_coevolution(SPACE), self.space, self.options, ALONE, ROWS,
            self.rows, self.scratch, self.stream, self.counters,
        )  # fmt: skip

    def residual(self, lists, p):
        residual_of_list(lists, p, self.rows, self.options, self.scratch.tape, self.scratch.work)
        return self.scratch.work.residual[0, :ROWS].copy()

    def output(self, p):
        return self.rows.target[0, :ROWS] - self.residual(self.lists, p)

    def members(self):
        return [oracle.Member(oracle.nodes_of(self.lists, p), float(self.fitness[p])) for p in range(POPULATION)]


@pytest.mark.parametrize("options", [FITTED, PLAIN])
def test_fitness_is_the_error_of_the_individual_as_it_stands(options):
    """The stored constants and scaling of an individual give the same output that was measured."""
    arena = Arena(options)
    for _ in range(5):
        arena.generation()
    for p in np.flatnonzero(np.isfinite(arena.fitness)):
        expected = fitting.errors(arena.output(p), arena.rows.target[0, :ROWS])[0]
        assert arena.fitness[p] == pytest.approx(expected, rel=1e-12)


def test_developing_changes_live_constants_only():
    arena = Arena()
    before = random_lists(POPULATION, SPACE, 1)
    for p in range(POPULATION):
        live = oracle.live_of(oracle.nodes_of(before, p))
        for i, (old, new) in enumerate(zip(oracle.nodes_of(before, p), oracle.nodes_of(arena.lists, p), strict=True)):
            assert old[:3] == new[:3]
            assert old[3] == new[3] or (i in live and old[0] == CONSTANT)


def test_evaluations_are_counted_by_part():
    arena = Arena(PLAIN)
    assert dict(zip(PARTS, arena.counters.tolist(), strict=True)) == {
        "offspring": 0, "reevaluation": POPULATION * ROWS, "constant_fitting": 0, "refitting": 0, "coevolution": 0,
    }  # fmt: skip
    arena.generation()
    assert arena.counters[OFFSPRING] == POPULATION * ROWS
    assert arena.counters[FITTING] == 0


def test_fitting_counts_apart_and_at_most_three_for_a_row_and_step():
    arena = Arena()
    assert arena.counters[REEVALUATION] == POPULATION * ROWS
    assert 0 < arena.counters[FITTING] <= POPULATION * ROWS * 3 * FITTED.steps
    assert arena.counters[FITTING] % ROWS == 0


@pytest.mark.parametrize("options", [FITTED, GATED, PLAIN])
def test_a_generation_is_that_of_the_definition(options):
    """Parents form random pairs with two children; a child replaces the parent that it resembles if it is no worse.

    With fits, a child that is the same program as a settled parent takes the parent's loss and is not counted.
    """
    arena, reference = Arena(options), Arena(options)
    settled = reference.scratch.settled.copy()
    inherited = 0
    for _ in range(6):
        stream, before = Stream(int(arena.stream[0])), arena.members()
        arena.generation()
        after = arena.members()
        order = stream.permutation(POPULATION)
        children = empty_lists(2, SPACE.nodes)
        for first, second in zip(order[::2], order[1::2], strict=True):
            cross(children, reference.lists, first, second, SPACE, reference_stream := stream_of(stream._state))
            for q in range(2):
                mutate(children, q, SPACE, reference_stream)
            stream = Stream(int(reference_stream[0]))
            ceiling = options.gate * max(before[first].fitness, before[second].fitness)
            fits, is_settled = [], []
            for q in range(2):
                nodes = oracle.nodes_of(children, q)
                parents = donors(options, first, second)
                same = [p for p in parents if settled[p] and oracle.is_same(before[p].nodes, nodes)]
                fits.append(before[same[0]].fitness if same else float(reference.develop(children, q, ceiling)))
                is_settled.append(bool(same) or bool(reference.scratch.near.settled[0]))
                inherited += bool(same)
            born = tuple(oracle.Member(oracle.nodes_of(children, q), fits[q]) for q in range(2))
            expected = oracle.survivors((before[first], before[second]), born)
            assert (after[first], after[second]) == expected
            for p, winner in zip((first, second), expected, strict=True):
                settled[p] = next((is_settled[q] for q in range(2) if winner is born[q]), settled[p])
        for mine, theirs in zip(reference.lists, arena.lists, strict=True):
            mine[...] = theirs
        np.testing.assert_array_equal(arena.scratch.settled, settled)
        np.testing.assert_array_equal(arena.counters, reference.counters)
    assert (inherited > 0) == (options is not PLAIN)


def donors(options, first, second):
    """Return the parents whose loss a child may take over; none without fits."""
    return (first, second) if options is not PLAIN else ()


def test_inheriting_a_loss_saves_evaluations_and_changes_nothing_else():
    """Without steps for constants, a child that is the same program as its parent has the same loss."""
    heirs, measured = Arena(TERMS), Arena(TERMS)
    for _ in range(10):
        measured.scratch.settled[:] = False  # no child takes over a loss
        heirs.generation()
        measured.generation()
        for mine, theirs in zip(heirs.lists, measured.lists, strict=True):
            assert mine.tobytes() == theirs.tobytes()
        assert heirs.fitness.tobytes() == measured.fitness.tobytes()
    assert heirs.counters[OFFSPRING] < measured.counters[OFFSPRING] == 10 * POPULATION * ROWS


def test_many_generations_at_once_are_those_one_by_one():
    once, singly = Arena(), Arena()
    assert once.generation(7) == 7
    assert sum(singly.generation() for _ in range(7)) == 7
    assert once.members() == singly.members()
    np.testing.assert_array_equal(once.counters, singly.counters)
    np.testing.assert_array_equal(once.stream, singly.stream)


def test_nobody_s_place_is_ever_taken_by_someone_worse():
    arena = Arena()
    for _ in range(10):
        before = arena.fitness.copy()
        arena.generation()
        assert (arena.fitness <= before).all()
