"""Candidates of one variable, ranked by its trajectories alone."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.batches import FUNCTIONS, Spread
from atoll_coordinator.model.selection.candidates import RankedCandidates
from atoll_coordinator.model.structure.term_libraries import libraries
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program, structure
from tests.unit.coordinator.model.shooting.made import SWING, compare, measurements_of, recording

TIMES = 0.1 * np.arange(40.0)
ARITHMETIC = frozenset(BY_NAME[name].code for name in ("+", "-", "*"))
NOISE = 0.02


@pytest.fixture
def alone():
    """The comparison of y alone, and a problem whose derivatives are wrong by as much as they vary."""
    whole = recording(SWING, ([1.0, 2.0], [0.5, -1.0]), TIMES, NOISE, seed=140)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    labels = np.concatenate([part.slopes[1] for part in whole.trajectories])
    labels = labels + np.random.default_rng(141).normal(0.0, labels.std(), len(labels))
    problem = Problem(SWING.names, inputs, Target("y", "dy/dt", labels, 0.5, float(labels.std()), NOISE))
    return compare(SWING, measurements_of(whole, [1]), 1e-5), problem


def ranked(comparison, problem, programs, libraries):
    candidates = RankedCandidates(comparison, problem)
    candidates.add(programs, libraries)
    return candidates.programs


def programs(*texts):
    return [SWING.parsed(text) for text in texts]


TEXTS = ("0.5*y", "-2.5*x - 0.1*y", "-1.5*x", "-x - x*y", "exp(9.0*x*x)")


def test_the_truth_comes_first_and_what_cannot_be_simulated_last(alone):
    candidates = ranked(*alone, programs(*TEXTS), [])
    assert structure(candidates[0]) == structure(SWING.parsed("-2.5*x - 0.1*y"))
    assert structure(candidates[-1]) == structure(SWING.parsed("exp(9.0*x*x)"))
    assert {structure(candidate) for candidate in candidates} == {structure(program) for program in programs(*TEXTS)}
    assert len(candidates) == len(TEXTS)
    assert sorted(np.abs(candidates[0].constants[candidates[0].operators == 1]).tolist()) == pytest.approx(
        [0.3, 2.0], abs=0.1
    )


def test_of_equal_structures_the_first_counts(alone):
    candidates = ranked(*alone, programs("-1.5*x", "-1.7*x", "-1.5*x - 0.5*y"), [])
    assert len(candidates) == 2


def test_libraries_have_what_was_not_handed_on(alone):
    candidates = ranked(*alone, programs("0.5*y"), libraries([0, 1], ARITHMETIC))
    assert len(candidates) > 5
    text = SWING.text(candidates[0])
    assert (text.count("x"), text.count("y")) == (1, 1)


def test_a_library_of_some_variables_uses_no_other(alone):
    for program in ranked(*alone, [], libraries([1], ARITHMETIC)):
        assert set(program.left[program.operators == 0].tolist()) <= {1}


def test_what_has_no_value_on_the_rows_is_no_candidate(alone):
    assert ranked(*alone, programs("log(x - 1000.0)"), []) == []


def test_what_is_proposed_later_is_ranked_among_what_was_there(alone):
    comparison, problem = alone
    candidates = RankedCandidates(comparison, problem)
    candidates.add(programs("0.5*y", "-1.5*x"))
    candidates.add(programs("-1.7*x", "-2.5*x - 0.1*y"))
    assert structure(candidates.programs[0]) == structure(SWING.parsed("-2.5*x - 0.1*y"))
    assert len(candidates.programs) == 3  # -1.7*x is one of those before


def test_what_is_too_long_to_matter_is_no_candidate(alone):
    comparison, problem = alone
    candidates = RankedCandidates(comparison, problem)
    most = comparison.score.length(SWING.parsed("-2.5*x - 0.1*y"))
    written_long = "-2.5*x*x/x"
    candidates.add(programs("-2.5*x - 0.1*y", "0.5*y", written_long), libraries([0, 1], ARITHMETIC), most)
    assert all(comparison.score.length(program) < most for program in candidates.programs)
    assert {structure(program) for program in candidates.programs} >= {
        structure(program) for program in programs("0.5*y", "-2.5*x")
    }


class Counted:
    """Batches computed here, as if two others took them; which functions were asked for."""

    workers = 2
    threads = 1

    def __init__(self):
        self.asked = []

    def map(self, function, context, items, cancel_after=None):
        del cancel_after
        self.asked.append(function)
        return [FUNCTIONS[function](context, item) for item in items]

    def note(self, compared):
        pass


def test_sums_of_libraries_are_written_in_one_call_of_batches(alone):
    comparison, problem = alone
    given = programs("0.5*y"), list(libraries([0, 1], ARITHMETIC))
    here = RankedCandidates(comparison, problem)
    here.add(*given, most=1000.0)
    batches = Counted()
    there = RankedCandidates(replace(comparison, spread=Spread(batches)), problem)
    there.add(*given, most=1000.0)
    assert batches.asked.count("writings") == 1  # a single program is written here
    assert list(map(Program.to_bytes, there.programs)) == list(map(Program.to_bytes, here.programs))
