"""Which candidates each variable has."""

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.model.selection.candidates import collect_candidates
from atoll_coordinator.model.selection.model_selection import STAGES, Choice, select_model
from atoll_coordinator.model.selection.shortcut import add_laws
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import BudgetConfig, JobConfig, SpaceConfig
from tests.unit.coordinator.model.shooting.made import Known, pools, table


def final_candidates(task):
    """Return the candidates of each equation that are searched."""
    choice = Choice(add_laws(task))
    for stage in STAGES:
        if stage.name == "search among the candidates":
            break
        if stage.is_due(choice):
            choice = stage.run(choice)
    return choice.pool.lists


DRAG = Known(("v",), lambda _, z: [-0.05 * z[0] ** 2])
CLOSE = "100.0*cos(0.0316227766*v) - 100.0"
"""Differs from the truth by less than a thousandth, which counts as found here."""
NO_LIBRARIES = JobConfig(space=SpaceConfig(operators=("-", "*")))
CONFIG = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "cos")), budget=BudgetConfig(target_error=1e-2))


@pytest.fixture(scope="module")
def prepared():
    return prepare(table(DRAG, ([3.0], [2.0]), 0.1 * np.arange(60.0)), CONFIG)


def selected(prepared, text):
    """Return the equation that is selected when a converged search has found `text`."""
    entries = pools(prepared, v=(text,))
    (entry,) = entries["v"].front
    settled = {"v": Refined(0, DRAG.parsed(text), entry.error, entry.mse)}
    candidates = collect_candidates(prepared.dataset, CONFIG, entries)
    task = ModellingTask(prepared.dataset, prepared.recording, CONFIG, candidates, settled)
    (program,) = select_model(task).model.programs
    return program


@pytest.mark.slow
def test_trajectories_show_that_the_equation_of_a_converged_search_only_comes_close(prepared):
    program = selected(prepared, CLOSE)
    text = DRAG.text(program)
    assert "cos" not in text
    assert "v*v" in text or "v**2" in text


SPIRAL = Known(("a", "b"), lambda _, z: [-0.2 * z[0] + z[1], -z[0]])


@pytest.mark.parametrize(("rate_law_variables", "sizes"), [(("a",), (1, 2)), (("a", "b"), (2, 2))])
def test_an_equation_among_many_that_has_a_law_has_no_other_candidates_unless_all_have(rate_law_variables, sizes):
    measured = prepare(table(SPIRAL, ([3.0, 1.0], [1.0, 2.0]), 0.1 * np.arange(40.0)), NO_LIBRARIES)
    entries = pools(measured, a=("b", "-a"), b=("b", "-b"))
    laws = {
        name: (Law(SPIRAL.parsed("b - 0.3*a"), 10.0, 0.5, is_tested=True, is_of_rates=True),)
        for name in rate_law_variables
    }
    candidates = collect_candidates(measured.dataset, NO_LIBRARIES, entries)
    task = ModellingTask(measured.dataset, measured.recording, NO_LIBRARIES, candidates, laws=laws)
    lists = final_candidates(task)
    assert tuple(min(len(ranked_list), 2) for ranked_list in lists) == sizes
