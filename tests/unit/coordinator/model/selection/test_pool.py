"""The pool of candidates: stages of proposals, the best system of a few, and when no more are needed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.selection.candidates import collect_candidates
from atoll_coordinator.model.selection.pool import CandidatePool
from atoll_coordinator.model.selection.score import Score
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.expression.program import structure
from tests.unit.coordinator.model.shooting.made import Known, pools, table

CONFIG = JobConfig(space=SpaceConfig(operators=("+", "-", "*")))
SPIRAL = Known(("a", "b"), lambda _, z: [-0.2 * z[0] + z[1], -z[0]])
WRONG, TRUTH = {"a": "b", "b": "-a"}, {"a": "b - 0.3*a", "b": "-1.1*a"}
LONG = {"a": "b - 0.3*a + 0.1*a*a - 0.2*b*b + 0.1*a*b", "b": "-1.1*a + 0.2*b*b + 0.1*a*b - 0.1*b*b*b"}


@pytest.fixture
def task():
    measured = prepare(table(SPIRAL, ([3.0, 1.0], [1.0, 2.0]), 0.1 * np.arange(60.0), 0.02, 160), CONFIG)
    candidates = collect_candidates(measured.dataset, CONFIG, pools(measured, a=("b",), b=("-a",)))
    return ModellingTask(measured.dataset, measured.recording, CONFIG, candidates)


def proposer(texts, asked=None):
    def propose(task, name, most):
        if asked is not None:
            asked.append(most)
        return [SPIRAL.parsed(texts[name])]

    return propose


def test_a_better_system_takes_the_place_of_the_best(task):
    pool = CandidatePool(task, task.comparison, {})
    pool.add(proposer(WRONG))
    assert not pool.is_sufficient
    pool.add(proposer(TRUTH))
    assert [len(candidates) for candidates in pool.lists] == [2, 2]
    assert structure(pool.best.programs[0]) == structure(SPIRAL.parsed("b - 0.3*a"))


def test_beside_a_system_that_leaves_noise_alone_only_what_is_short_is_taken_in(task):
    pool, asked = CandidatePool(task, task.comparison, {}), []
    pool.add(proposer(TRUTH, asked))
    assert asked == [math.inf, math.inf]
    before = [list(candidates) for candidates in pool.lists]
    pool.add(proposer(LONG, asked))
    assert all(math.isfinite(most) for most in asked[2:])
    assert pool.lists == before
    assert not pool.comparison.score.may_be_improved(pool.best)


def test_a_system_that_is_longer_than_laws_are_ends_no_stage(monkeypatch):
    """However little it leaves: a law that was not proposed may be far shorter."""
    measured = prepare(table(SPIRAL, ([3.0, 1.0], [1.0, 2.0]), 0.1 * np.arange(60.0)), CONFIG)
    candidates = collect_candidates(measured.dataset, CONFIG, pools(measured, a=("b",), b=("-a",)))
    exact = ModellingTask(measured.dataset, measured.recording, CONFIG, candidates)
    pool = CandidatePool(exact, exact.comparison, {})
    monkeypatch.setattr(Score, "may_be_improved", lambda *_: False)
    pool.add(proposer(LONG))
    assert pool.longest > SETTINGS.selection.usual_length
    assert not pool.is_sufficient
    pool.add(proposer(TRUTH))
    assert pool.longest < SETTINGS.selection.usual_length
    assert pool.is_sufficient


def test_equations_that_are_given_have_no_other_candidates(task):
    given = SPIRAL.parsed("b - 0.2*a")
    pool = CandidatePool(task, task.comparison, {"a": [given]})
    pool.add(proposer(TRUTH))
    assert pool.lists[0] == [given]
    assert pool.best.programs[1].operators.tolist()


def test_without_time_what_the_search_found_is_simulated(task):
    """Nothing is proposed any more, but a system is there to be shown and judged."""
    late, asked = replace(task, deadline=Deadline(0.0)), []
    pool = CandidatePool(late, late.comparison, {})
    pool.add(proposer(TRUTH, asked))
    assert asked == []
    assert [structure(program) for program in pool.best.programs] == [
        structure(SPIRAL.parsed("b")), structure(SPIRAL.parsed("-a")),
    ]  # fmt: skip
