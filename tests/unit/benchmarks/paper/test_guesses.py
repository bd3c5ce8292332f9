"""The benchmark of guesses: its equations, guesses and table."""

import numpy as np
import pytest

from atoll_core.expression.text.parsing import from_infix
from benchmarks.paper.guesses import EQUATIONS, KINDS, Found, Task, config_of, rows, search
from benchmarks.paper.readings_runs import equation_problem

LIMIT = 3e5


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(EQUATIONS)))
def test_a_guess_of_the_right_form_is_found_with_little_work(index):
    found = search(Task(index, "form", 100, LIMIT))
    assert found.has_hit
    assert found.evaluations < LIMIT


def test_a_search_ends_at_its_limit():
    found = search(Task(2, "wrong", 100, 2e5))
    assert (found.has_hit, found.evaluations) == (False, 2e5)


@pytest.mark.parametrize("guessed", EQUATIONS)
def test_every_guess_can_be_read_and_enters_the_configuration(guessed):
    problem = equation_problem(guessed.system, guessed.variable, 100)
    assert np.isfinite(problem.target.values).all()
    for kind in KINDS:
        guesses = config_of(guessed, kind, 100, problem).prior.guesses
        assert len(guesses) == (kind != "none")
        for text in guesses.get(guessed.variable, ()):
            assert len(from_infix(text, problem.names)) > 0


def test_the_table_has_medians_and_their_geometric_means():
    results = [
        Found(Task(index, kind, seed, 1e6), 1e3 * (seed + 1), seed < 2)
        for index in range(len(EQUATIONS))
        for kind in KINDS
        for seed in range(3)
    ]
    *lines, last = rows(results)
    assert len(lines) == len(EQUATIONS)
    assert lines[0] == ("glider theta", *["2e+03 (2 of 3)"] * 4)
    assert last == ("geometric mean", *["2e+03"] * 4)
