"""The front of one island: its invariants, what is offered to it, and what pruning leaves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, PredictorConfig, SpaceConfig
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from atoll_island_worker.evolution.front import Front, FrontUpdater, RunnersUp
from atoll_island_worker.evolution.kernels.generation import PARTS, REFITTING
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import empty_lists
from tests.oracles import fitting
from tests.oracles.tapes import list_of, node_values

QUICK = settings(max_examples=200, deadline=None, derandomize=True, database=None)
ERRORS = st.one_of(st.sampled_from([0.0, 1.0, math.inf, math.nan]), st.floats(0.0, 3.0))
ENTRIES = st.lists(
    st.builds(
        FrontEntry, st.integers(1, 6), ERRORS, st.just(0.0), st.integers(0, 2), st.integers(0, 9), st.integers(0, 1),
        st.binary(max_size=2),
    ),
    max_size=30,
)  # fmt: skip
NAMES = ("x", "y")


def front_of(entries):
    front = Front()
    added = [front.add(entry) for entry in entries]
    return front, added


@pytest.mark.slow
@QUICK
@given(ENTRIES)
def test_a_front_falls_in_error_as_it_rises_in_complexity(entries):
    kept = front_of(entries)[0].entries
    assert all(math.isfinite(entry.error) for entry in kept)
    assert [e.complexity for e in kept] == sorted({e.complexity for e in kept})
    assert [e.error for e in kept] == sorted({e.error for e in kept}, reverse=True)


@pytest.mark.slow
@QUICK
@given(ENTRIES)
def test_nothing_that_was_offered_is_better_than_what_was_kept(entries):
    front, added = front_of(entries)
    for entry, was_added in zip(entries, added, strict=True):
        assert not entry.error < front.error_at(entry.complexity)
        assert was_added or not any(kept is entry for kept in front.entries)
    finite = [entry.error for entry in entries if math.isfinite(entry.error)]
    assert front.least_error() == (min(finite) if finite else None)


class Arena:
    """A front, and a way to offer it expressions, on 100 rows of a problem."""

    def __init__(self, truth, steps=4, runners_up=0, **space):
        number = np.arange(100)
        self.x, self.y = 0.5 + number * 37 % 41 / 20.0, 0.25 + number * 29 % 43 / 25.0
        values = truth(self.x, self.y)
        target = Target("x", "dx/dt", values, 0.0, float(values.std()))
        config = JobConfig(
            space=SpaceConfig(terminals=7, **space),
            evolution=EvolutionConfig(constant_fit_steps=steps, linear_terms=3 if steps else 0),
            predictors=PredictorConfig(rows=16),
            budget=BudgetConfig(target_error=1e-9),
        )
        self.setup = IslandSetup(Problem(NAMES, np.stack([self.x, self.y]), target), config, 0)
        self.front = Front()
        self.runners_up = RunnersUp(runners_up)
        self.offering = FrontUpdater(self.setup, self.front, self.runners_up)
        self.counters = np.zeros(len(PARTS), np.int64)
        self.additions = []

    def offer(self, text):
        """Offer one individual that is the expression `text`; return what improved the front."""
        return self.offer_all(text)[0]

    def offer_all(self, text):
        """Offer likewise; return what improved the front and the runners-up."""
        program, nodes = list_of(from_infix(text, NAMES)), self.setup.space.nodes
        lists, room = empty_lists(1, nodes), nodes - program.code.shape[1]
        for mine, theirs in zip(lists[:4], program[:4], strict=True):
            mine[:, room:] = theirs
        is_operator = lists.code[0] > 1
        lists.left[0, is_operator] += room
        lists.right[0, is_operator] += room
        improvements = self.offering.offer(lists, np.ones(1), self.counters, (0, 10, 0), offers_next_best=True)
        self.additions += improvements[0]
        return improvements

    def texts(self):
        return [to_infix(Program.from_bytes(e.program, 2), NAMES) for e in self.front.entries]


def test_an_offer_is_refitted_on_all_rows_and_counted():
    arena = Arena(lambda x, y: 3.0 * np.exp(-0.0 * x) + 2.0 * x / (y + 0.7), steps=4)
    improvements = arena.offer("x/(y + 0.5)")
    assert improvements
    assert arena.front.entries[-1].error < 1e-9
    assert arena.counters.sum() == arena.counters[REFITTING] > 100


def test_coefficients_near_one_and_shifts_near_zero_are_dropped_when_that_costs_nothing():
    arena = Arena(lambda x, y: x * y - x)
    arena.offer("x*y - x")
    assert arena.texts()[-1] == "x*y - x"
    assert arena.front.entries[-1].error < 1e-14


def test_without_fitting_an_individual_is_measured_as_it_stands():
    arena = Arena(lambda x, y: 2.0 * x, steps=0)
    arena.offer("3.0*x")
    assert arena.texts() == ["3.0*x"]
    assert arena.front.entries[0].error == pytest.approx(arena.x.mean())
    assert arena.counters[REFITTING] == 200


def test_what_is_larger_than_allowed_or_not_finite_does_not_enter():
    arena = Arena(lambda x, y: x * y, max_size=2)
    assert not arena.offer("x*y + x")
    arena = Arena(lambda x, y: x * y, operators=("+", "-", "*", "/"))
    assert not arena.offer("x/(y - y)")


def test_pruning_leaves_out_what_is_superfluous():
    """An equation with a part that cancels is reduced as long as the target is still met."""
    arena = Arena(lambda x, y: 3.0 * x - 2.0 * x * y)
    arena.offer("3.0*x - 2.0*x*(y + (x + 0.5)/(x + 0.5) - 1.0)")
    target = 1e-9 * arena.setup.deviation
    before = arena.front.entries[-1]
    assert before.error <= target
    additions = arena.offering.prune(target, arena.counters, (0, 10, 0))
    assert additions
    simplest = next(e for e in arena.front.entries if e.error <= target)
    assert simplest.complexity < before.complexity
    assert simplest.complexity <= 9


def test_pruning_turns_a_difference_from_next_to_nothing_into_a_negative():
    arena = Arena(lambda x, y: -x)
    arena.offer("y*1e-17 - x")
    arena.offering.prune(1e-9 * arena.setup.deviation, arena.counters, (0, 10, 0))
    simplest = next(e for e in arena.front.entries if e.error <= 1e-9 * arena.setup.deviation)
    assert to_infix(Program.from_bytes(simplest.program, 2), ("x", "y")) == "-x"


def noisy(x, y):
    """Return values that no equation meets: the seventh digit decides nothing, the first does."""
    return 3.0 * x - 2.0 * x * y + 0.3 * np.sin(1e3 * (x + 7.0 * y))


def offered(arena, texts):
    for text in texts:
        arena.offer(text)
    return arena.runners_up.entries


BESIDE = (
    "3.0*x - 2.0*x*y", "x*(1.5 - y)", "x*y + x + y", "x - x*(y + 0.2)", "2.0*x - x*y - y*x", "sin(x) - x*y", "x/y",
    "x/y - y", "(x*x - x*y)/x", "y - x", "x - y", "x*y", "y*x - 0.1", "x*x - y", "cos(x) - x*y*y", "x + sin(y)*x",
)  # fmt: skip


def test_runners_up_are_measured_on_all_rows_and_no_two_are_one_function():
    """Their errors are those of their programs, and no two programs agree at every row, whatever they look like."""
    arena = Arena(noisy, runners_up=4)
    near, front = offered(arena, BESIDE), arena.front.entries
    values = []
    for entry in (*near, *front):
        program = Program.from_bytes(entry.program, 2)
        output = np.broadcast_to(node_values(program, arena.setup.every.inputs[:, :100])[-1], 100)
        absolute, squared = fitting.errors(output, arena.setup.every.target[0, :100])
        assert (entry.error, entry.mse) == (pytest.approx(absolute), pytest.approx(squared))
        values.append(output)
    assert len(near) > 4
    tolerance = 1e-6 * arena.setup.deviation
    for i, output in enumerate(values):
        assert not any(np.abs(output - other).max() < tolerance for other in values[i + 1 :]), i
    sizes = [entry.complexity for entry in near]
    assert max(sizes.count(size) for size in sizes) <= 4
    assert all(entry.error >= arena.front.error_at(entry.complexity) for entry in near)
