"""The choice of individuals to be measured on all rows, and their fits there."""

import math

import numpy as np
import pytest

from atoll_core.expression.operators import MULTIPLY, VARIABLE
from atoll_core.expression.simplification import complexity
from atoll_island_worker.evolution.front import from_book, from_tape, to_program
from atoll_island_worker.evolution.kernels.generation import PARTS, REFITTING
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.kernels.offers import (
    canonical,
    choose_near,
    choose_offers,
    refit,
    refit_offers,
    structure_hash,
)
from atoll_island_worker.evolution.kernels.tape import compile_tape
from atoll_island_worker.evolution.structures import MOST_TERMS, Fit, empty_scratch, empty_tape
from tests.oracles import fitting
from tests.oracles.programs import program_of
from tests.oracles.spaces import random_lists, space_of
from tests.oracles.tapes import list_of, node_values

POPULATION = 60
SPACE = space_of(("+", "-", "*", "sin"))
FITTED = Fit(4, 3, 2, 0, math.inf)


class Arena:
    def __init__(self):
        self.lists = random_lists(POPULATION, SPACE, 4)
        self.scratch = empty_scratch(POPULATION, SPACE.nodes, 2, 16, 40)
        sizes = len(self.scratch.best_of_size)
        self.offered, self.losses = np.zeros(sizes, np.uint64), np.full(sizes, math.inf)
        size = np.array([self.size(p) for p in range(POPULATION)])
        self.fitness = np.random.default_rng(4).uniform(4.0, 6.0, POPULATION) - 0.15 * size

    def choose(self):
        offers = np.zeros(len(self.offered), np.int64)
        count = choose_offers(self.lists, self.fitness, self.scratch, self.offered, self.losses, offers)
        return offers[:count].tolist()

    def choose_near(self, most, known):
        """Return the individuals chosen for the front, and the next best ones."""
        offers = np.zeros(len(self.offered) + POPULATION, np.int64)
        count = choose_offers(self.lists, self.fitness, self.scratch, self.offered, self.losses, offers)
        order = np.argsort(self.fitness, kind="stable")
        number = choose_near(self.lists, self.fitness, order, most, self.scratch, known, offers, count)
        return offers[:count].tolist(), offers[count:number].tolist()

    def hash(self, p):
        return int(structure_hash(self.scratch.canonical, canonical(self.lists, p, self.scratch)))

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
    offers = arena.choose()
    assert arena.choose() == []
    arena.fitness[offers[-1]] *= 0.6
    assert arena.choose() == []
    arena.fitness[offers[-1]] *= 0.6
    assert arena.choose() == [offers[-1]]


def near_by_definition(arena, offered, most, known):
    """Return the next best individuals of each size, in the order of fitness, with new fitnesses and structures."""
    near, structures = [], {arena.hash(p) for p in offered} | set(known)
    taken, fitnesses = {}, {}
    for p in np.argsort(arena.fitness, kind="stable").tolist():
        size = arena.size(p)
        is_same = fitnesses.get(size) == arena.fitness[p]
        if is_same or taken.get(size, 0) >= most or not math.isfinite(arena.fitness[p]):
            continue
        fitnesses[size] = arena.fitness[p]
        taken[size] = taken.get(size, 0) + 1
        if arena.hash(p) not in structures:
            structures.add(arena.hash(p))
            near.append(p)
    return near


@pytest.mark.parametrize("most", [1, 2, 5])
def test_the_next_best_of_each_size_are_chosen_beside_the_best(most):
    arena = Arena()
    arena.fitness[arena.fitness > 5.5] = math.inf
    for first, second in ((3, 4), (10, 11), (20, 21)):
        arena.lists.code[second] = arena.lists.code[first]
        arena.lists.left[second], arena.lists.right[second] = arena.lists.left[first], arena.lists.right[first]
        arena.lists.constants[second] = arena.lists.constants[first]
    arena.fitness[11] = arena.fitness[10]
    offered, near = arena.choose_near(most, np.zeros(1 << 16, np.uint64))
    assert near == near_by_definition(arena, offered, most, ())
    assert len(near) > 3 or most == 1


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
    refit(count, rows, FITTED, 0, arena.scratch.canonical, arena.scratch.work, scale, result, counters)
    assert counters[REFITTING] == 40
    assert counters.sum() == 40


class Offers:
    """A population on 40 rows, and calls of `refit_offers` for it."""

    def __init__(self, options=FITTED, lists=None, target=None):
        inputs = np.random.default_rng(6).uniform(0.5, 2.0, (2, 40))
        self.target = np.sqrt(inputs[0]) * inputs[1] if target is None else target(*inputs)
        self.inputs, self.options = inputs, options
        self.rows = padded_rows(inputs, self.target)
        self.lists = random_lists(POPULATION, SPACE, 4) if lists is None else lists
        number, nodes = self.lists.code.shape
        self.scratch = empty_scratch(number, nodes, 2, 16, 40)
        size = np.array([canonical(self.lists, p, self.scratch) for p in range(number)])
        self.fitness = np.random.default_rng(4).uniform(8.0, 9.0, number) - 0.15 * size
        self.book, self.sizes = self.scratch.book, len(self.scratch.best_of_size)
        self.counters = np.zeros(len(PARTS), np.int64)

    def refit(self, least=None, slack=math.inf):
        """Return the number of programs with a loss below `least` (sizes,); no program was offered before."""
        least = np.full(self.sizes, math.inf) if least is None else least
        offers, none = np.zeros(self.sizes, np.int64), np.zeros(self.sizes, np.uint64)
        unknown = np.full(self.sizes, math.inf)
        number = choose_offers(self.lists, self.fitness, self.scratch, none, unknown, offers)
        return refit_offers(
            self.lists, offers, number, self.rows, self.options, 4, self.scratch, least, slack, self.book, self.counters
        )

    def loss(self, k, shift, coefficients):
        """Return the loss of entry `k` with other coefficients, by its definition."""
        values = node_values(to_program(from_book(self.book, k)), self.inputs)
        terms = self.book.terms[k, : self.book.number[k]]
        output = shift + sum(a * values[term] for a, term in zip(coefficients, terms, strict=True))
        absolute, squared = fitting.errors(np.broadcast_to(output, 40), self.target)
        return absolute if self.options.loss == 0 else math.sqrt(squared)


def test_refitting_makes_no_offer_worse_and_is_counted_as_that_alone():
    offers = Offers()
    count = offers.refit()
    assert offers.counters[REFITTING] == offers.counters.sum()
    assert offers.counters[REFITTING] % 40 == 0
    assert offers.counters[REFITTING] >= 2 * 40 * count
    constant = fitting.errors(np.full(40, offers.target.mean()), offers.target)[1]
    for k in range(count):
        shift, *coefficients = offers.book.scale[k, : 1 + offers.book.number[k]]
        values = node_values(to_program(from_book(offers.book, k)), offers.inputs)
        output = shift + sum(a * values[t] for a, t in zip(coefficients, offers.book.terms[k], strict=False))
        assert fitting.errors(np.broadcast_to(output, 40), offers.target)[1] <= constant * (1.0 + 1e-9)


def test_only_what_improves_is_booked():
    offers = Offers()
    count = offers.refit()
    sizes, losses = offers.book.size[:count].copy(), offers.book.loss[:count].copy()
    least = np.full(offers.sizes, math.inf)
    least[sizes] = losses
    least[sizes[1]] = np.nextafter(losses[1], math.inf)
    assert offers.refit(least) == 1
    assert (offers.book.size[0], offers.book.loss[0]) == (sizes[1], losses[1])


def test_no_steps_are_spent_where_the_loss_is_far_from_useful():
    offers = Offers()
    assert offers.refit() > 3
    spent = offers.counters[REFITTING]
    offers.counters[:] = 0
    assert offers.refit(np.full(offers.sizes, 1e-9), slack=1.5) == 0
    assert 0 < offers.counters[REFITTING] < spent / 2
    assert offers.counters[REFITTING] % 40 == 0
    offers.counters[:] = 0
    assert offers.refit(np.full(offers.sizes, math.inf), slack=1.5) > 3
    assert offers.counters[REFITTING] == spent


def test_coefficients_next_to_one_are_also_measured_as_one():
    product = list_of(program_of([(VARIABLE, 0), (VARIABLE, 1), (MULTIPLY, 0, 1)]))
    offers = Offers(lists=product, target=lambda x, y: 1.00002 * x * y + 0.001)
    assert offers.refit() == 1
    area = offers.inputs[0] * offers.inputs[1]
    assert offers.book.scale[0, :2] == pytest.approx([0.001, 1.00002])
    expected = [0.0, 0.001, 2e-5 * area.mean(), 2e-5 * area.mean() + 0.001]
    assert offers.book.variants[0, 0] < 1e-15
    assert offers.book.variants[0, 1:] == pytest.approx([0.001, 2e-5 * abs(area).mean(), expected[3]], rel=1e-6)
