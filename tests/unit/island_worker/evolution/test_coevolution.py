"""Predictors and trainers: judged by their definitions, renewed in turn, and never dearer than allowed."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.expression.kernels.tape import functions_address
from atoll_island_worker.evolution.island import begin_coevolution, evolve, measure_population, renew_trainer
from atoll_island_worker.evolution.kernels.generation import COEVOLUTION, PARTS, REEVALUATION
from atoll_island_worker.evolution.kernels.measured_rows import gather, padded_rows
from atoll_island_worker.evolution.kernels.predictors import judge, predictor_generation
from atoll_island_worker.evolution.kernels.trainers import most_disputed, train
from atoll_island_worker.evolution.structures import Coevolving, Fit, empty_rows, empty_scratch
from tests.oracles import coevolution as oracle
from tests.oracles import variation
from tests.oracles.spaces import empty_coevolution, random_lists, space_of, stream_of

POPULATION, ROWS, SAMPLE, PREDICTORS, TRAINERS = 16, 70, 8, 6, 5
SPACE = space_of(("+", "-", "*"))
PLAIN, FITTED = Fit(0, 0, 2, 0, math.inf), Fit(3, 3, 2, 0, 0.25)
QUICK = settings(max_examples=60, deadline=None, derandomize=True, database=None)


class Arena:
    """A population, its predictors and trainers, on rows of a problem."""

    def __init__(self, options=PLAIN, seed=1, rows=ROWS, relative=0):
        self.relative = relative
        random = np.random.default_rng(seed)
        self.options, self.random = options, random
        self.every = padded_rows(random.uniform(-1.0, 1.0, (2, rows)), random.normal(size=rows))
        self.rows = empty_rows(2, SAMPLE, 0)
        self.lists = random_lists(POPULATION, SPACE, seed)
        self.fitness = np.full(POPULATION, np.inf)
        self.scratch = empty_scratch(POPULATION, SPACE.nodes, 2, SAMPLE, rows)
        self.counters = np.zeros(len(PARTS), np.int64)
        self.stream = stream_of(seed)
        self.coevolution = empty_coevolution(SPACE, PREDICTORS, SAMPLE, TRAINERS, rows)

    def setup(self, effort=0.0, renewal=50):
        return SimpleNamespace(
            every=self.every, rows=self.rows, space=SPACE, fit=self.options, scratch=self.scratch,
            coevolving=Coevolving(1, effort, renewal, self.relative),
            call=lambda kernel, *arguments: kernel(*arguments),
        )  # fmt: skip

    def begin(self):
        setup = self.setup()
        begin_coevolution(setup, self.lists, self.coevolution, self.stream, self.counters)
        measure_population(setup, self.lists, self.fitness, self.coevolution, self.counters, REEVALUATION)
        return self

    def step(self):
        children = self.scratch.predictor_children
        return predictor_generation(self.coevolution, self.relative, self.every.length, children, self.stream)

    def renew(self):
        return renew_trainer(self.setup(), self.lists, self.coevolution, self.counters)

    def evolve(self, generations, effort, renewal=50):
        evolve(
            self.setup(effort, renewal), generations, self.lists, self.fitness, self.coevolution, self.stream,
            self.counters,
        )  # fmt: skip

    def qualities(self):
        losses, relative = self.coevolution.losses, bool(self.relative)
        return [oracle.quality(losses, rows, relative) for rows in self.coevolution.predictors]


@pytest.mark.parametrize("loss", [0, 1])
def test_a_trainer_is_measured_at_every_row(loss):
    arena = Arena(Fit(0, 0, 2, loss, math.inf)).begin()
    for t in range(TRAINERS):
        train(arena.coevolution, t, arena.every, arena.options, arena.scratch.tape, arena.scratch.work, arena.counters)
        expected = oracle.losses(arena.coevolution.trainers, t, arena.every, arena.options)
        np.testing.assert_allclose(arena.coevolution.losses[t], expected, rtol=1e-12)
        assert arena.coevolution.exact[t] == pytest.approx(expected.mean(), rel=1e-12)


def test_at_the_beginning_trainers_are_individuals_and_are_all_counted():
    arena = Arena()
    individuals = [variation.nodes_of(arena.lists, p) for p in range(POPULATION)]
    arena.begin()
    for t in range(TRAINERS):
        assert variation.nodes_of(arena.coevolution.trainers, t) in individuals
    assert arena.counters[COEVOLUTION] == TRAINERS * ROWS
    assert (arena.coevolution.predictors >= 0).all()
    assert (arena.coevolution.predictors < ROWS).all()
    assert sorted(arena.coevolution.born) == list(range(-TRAINERS, 0))


@QUICK
@given(st.integers(0, 2**32 - 1), st.integers(0, 1))
def test_predictors_are_judged_by_their_definition(seed, relative):
    arena = Arena(seed=seed, relative=relative).begin()
    assert arena.coevolution.quality == pytest.approx(arena.qualities(), rel=1e-9, abs=1e-12)
    assert arena.coevolution.best[0] == int(np.argmin(arena.coevolution.quality))


def test_a_trainer_that_is_not_finite_is_left_out():
    arena = Arena().begin()
    arena.coevolution.losses[2, 5], arena.coevolution.exact[2] = math.nan, math.inf
    rows = arena.coevolution.predictors[0]
    assert judge(arena.coevolution, 0, rows) == pytest.approx(oracle.quality(arena.coevolution.losses, rows))
    arena.coevolution.exact[:] = math.inf
    assert judge(arena.coevolution, 0, rows) == math.inf


@pytest.mark.slow
@QUICK
@given(st.integers(0, 2**32 - 1))
def test_predictors_only_get_better_and_a_change_of_the_measuring_rows_is_told(seed):
    arena = Arena(seed=seed).begin()
    coevolution = arena.coevolution
    for clock in range(1, 30):
        quality, measuring = coevolution.quality.copy(), coevolution.predictors[coevolution.best[0]].copy()
        changed = arena.step()
        assert (coevolution.quality <= quality).all()
        assert coevolution.quality == pytest.approx(arena.qualities(), rel=1e-9, abs=1e-12)
        assert coevolution.quality[coevolution.best[0]] == coevolution.quality.min()
        assert bool(changed) == bool((coevolution.predictors[coevolution.best[0]] != measuring).any())
        assert ((coevolution.predictors >= 0) & (coevolution.predictors < ROWS)).all()
        assert coevolution.clock[0] == clock


@pytest.mark.parametrize("relative", [0, 1])
def test_the_most_disputed_individual_is_the_one_predictors_disagree_on(relative):
    arena = Arena(relative=relative).begin()
    individual = most_disputed(
        arena.lists, arena.coevolution, arena.every, arena.scratch.spare, PLAIN, relative, arena.scratch,
        arena.counters,
    )  # fmt: skip
    losses = [oracle.losses(arena.lists, p, arena.every, PLAIN) for p in range(POPULATION)]
    spread = [oracle.disagreement(row_losses, arena.coevolution.predictors, bool(relative)) for row_losses in losses]
    assert individual == int(np.argmax(spread))
    assert arena.counters[COEVOLUTION] == TRAINERS * ROWS + POPULATION * PREDICTORS * SAMPLE


def test_renewal_replaces_the_oldest_trainer_in_turn_with_its_whole_scaling():
    arena = Arena(FITTED).begin()
    for turn in range(TRAINERS):
        arena.coevolution.clock[0] += 10
        oldest = int(np.argmin(arena.coevolution.born))
        kept = [variation.nodes_of(arena.coevolution.trainers, t) for t in range(TRAINERS) if t != oldest]
        arena.renew()
        assert oldest == turn
        assert arena.coevolution.born[oldest] == arena.coevolution.clock[0]
        assert kept == [variation.nodes_of(arena.coevolution.trainers, t) for t in range(TRAINERS) if t != oldest]
        nodes = variation.nodes_of(arena.coevolution.trainers, oldest)
        source = [variation.nodes_of(arena.lists, p) for p in range(POPULATION)].index(nodes)
        np.testing.assert_array_equal(arena.coevolution.trainers.scale[oldest], arena.lists.scale[source])
    assert arena.coevolution.quality == pytest.approx(arena.qualities(), rel=1e-9)


def test_gathered_rows_are_those_named_and_the_last_pads():
    arena = Arena()
    index = np.array([5, 69, 5, 0, 1, 2, 3, 4])
    gather(arena.rows, arena.every, index, functions_address())
    padded = np.append(index, np.full(8, 4))
    np.testing.assert_array_equal(arena.rows.inputs, arena.every.inputs[:, padded])
    np.testing.assert_array_equal(arena.rows.target, arena.every.target[:, padded])


@pytest.mark.parametrize("options", [PLAIN, FITTED])
@pytest.mark.parametrize("effort", [0.02, 0.05, 0.3])
def test_the_counted_share_of_coevolution_stays_below_its_cap(options, effort):
    """It may be passed by one renewal, which is begun when the share is still below."""
    arena = Arena(options).begin()
    renewal_costs = POPULATION * PREDICTORS * SAMPLE + ROWS
    for _ in range(40):
        clock = int(arena.coevolution.clock[0])
        arena.evolve(10, effort, renewal=3)
        spent, total = int(arena.counters[COEVOLUTION]), int(arena.counters.sum())
        assert spent <= max(effort * total + renewal_costs, TRAINERS * ROWS)
    assert clock > 0


def test_the_population_is_measured_on_the_best_predictor_s_rows():
    arena = Arena().begin()
    arena.evolve(30, 0.5, renewal=4)
    rows = arena.coevolution.predictors[arena.coevolution.best[0]]
    for p in range(POPULATION):
        expected = oracle.predicted(oracle.losses(arena.lists, p, arena.every, PLAIN), rows)
        assert arena.fitness[p] == pytest.approx(expected, rel=1e-12)
