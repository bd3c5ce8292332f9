"""Which individuals are measured on all rows."""

import math

import numpy as np

from common.expression.algebra import complexity
from island_worker.evolution.formula import from_tape, to_program
from island_worker.evolution.kernels_generation import PARTS, REFITTING
from island_worker.evolution.kernels_offers import canonical, choose_offers, refit, structure_hash
from island_worker.evolution.kernels_rows import padded_rows
from island_worker.evolution.kernels_tape import compile_tape
from island_worker.evolution.structures import MOST_TERMS, Fit, empty_scratch, empty_tape
from tests.oracles.spaces import random_lists, space_of

POPULATION = 60
SPACE = space_of(("+", "-", "*", "sin"))


class Arena:
    def __init__(self):
        self.lists = random_lists(POPULATION, SPACE, 4)
        self.scratch = empty_scratch(POPULATION, SPACE.nodes, 2, 16, 40)
        sizes = len(self.scratch.best_of_size)
        self.offered, self.losses = np.zeros(sizes, np.uint64), np.full(sizes, math.inf)
        size = np.array([self.size(p) for p in range(POPULATION)])
        self.fitness = np.random.default_rng(4).uniform(4.0, 6.0, POPULATION) - 0.15 * size

    def choose(self):
        chosen = np.zeros(len(self.offered), np.int64)
        count = choose_offers(self.lists, self.fitness, self.scratch, self.offered, self.losses, chosen)
        return chosen[:count].tolist()

    def size(self, p):
        tape = empty_tape(SPACE.nodes)
        lists = self.lists
        count = compile_tape(lists, p, tape)
        return complexity(to_program(from_tape(tape, count)))


def test_chosen_are_the_best_of_each_size_that_no_smaller_one_equals():
    arena = Arena()
    expected, least = [], math.inf
    for size in range(SPACE.nodes + 1):
        of_size = [p for p in range(POPULATION) if arena.size(p) == size]
        best = min(of_size, key=lambda p: arena.fitness[p], default=None)
        if best is not None and arena.fitness[best] < least:
            least = arena.fitness[best]
            expected.append(best)
    assert arena.choose() == expected
    assert len(expected) > 3


def test_the_same_structure_is_offered_again_only_when_its_loss_has_halved():
    arena = Arena()
    chosen = arena.choose()
    assert arena.choose() == []
    arena.fitness[chosen[-1]] *= 0.6
    assert arena.choose() == []
    arena.fitness[chosen[-1]] *= 0.6
    assert arena.choose() == [chosen[-1]]


def test_individuals_without_a_finite_loss_are_not_offered():
    arena = Arena()
    arena.fitness[:] = math.inf
    assert arena.choose() == []
    arena.fitness[7] = 1.0
    assert arena.choose() == [7]


def test_a_structure_s_hash_leaves_constants_out_and_nothing_else():
    arena = Arena()
    sizes = [canonical(arena.lists, p, arena.scratch) for p in range(POPULATION)]
    p = int(np.argmax(sizes))
    tape, size = arena.scratch.canonical, canonical(arena.lists, p, arena.scratch)
    original = structure_hash(tape, size)
    tape.constants[:] += 1.0
    assert structure_hash(tape, size) == original
    assert structure_hash(tape, size - 1) != original
    for column in (tape.code, tape.left, tape.right):
        column[size - 1] += 1
        assert structure_hash(tape, size) != original
        column[size - 1] -= 1


def test_refits_are_counted_and_leave_a_quarter_of_the_rows_for_each_constant():
    arena = Arena()
    inputs = np.random.default_rng(5).uniform(0.5, 2.0, (2, 40))
    rows, counters = padded_rows(inputs, inputs[0]), np.zeros(len(PARTS), np.int64)
    scale, result = np.zeros(1 + MOST_TERMS), np.zeros(2)
    count = canonical(arena.lists, 0, arena.scratch)
    refit(count, rows, Fit(4, 3, 2, 0), 0, arena.scratch.canonical, arena.scratch.work, scale, result, counters)
    assert counters[REFITTING] == 40
    assert counters.sum() == 40
