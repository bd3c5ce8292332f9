"""The last stage of the selection: under noise each equation gains or loses one term at a time."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.score import Score
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.selection.begun import looked_again
from tests.unit.coordinator.model.shooting.made import Known, table
from tests.unit.coordinator.model.sparse.lorenz import monomials

SWING = Known(("x", "y"), lambda _, z: [z[1], -2.0 * z[0] - 0.3 * z[1]])
TIMES = 0.05 * np.arange(60.0)
CONFIG = JobConfig(space=SpaceConfig(operators=("+", "-", "*")))


def selected(texts, noise, config=CONFIG, **options):
    """Return what is selected when these equations of x and y are all that there is."""
    prepared = prepare(table(SWING, ([2.0, 0.0], [0.0, -3.0]), TIMES, noise, seed=5), config)
    candidates = {name: CandidateSet() for name in SWING.states}
    task = ModellingTask(prepared.dataset, prepared.recording, config, candidates, **options)
    model = task.comparison.fit_model([from_infix(text, SWING.names) for text in texts])
    return SelectedModel(task, *task.comparison.calibrate(model))


def terms(selection):
    return [monomials(to_infix(program, SWING.names), SWING.names) for program in selection.model.programs]


@pytest.mark.parametrize(
    "texts",
    [("y", "-2.1*x"), ("y", "-0.5*y"), ("y", "-2*x - 0.3*y + 0.05*x*y"), ("y + 0.1", "-2*x - 0.3*y - 0.02*y*y")],
)
def test_each_equation_gains_and_loses_terms_as_the_trajectories_have_it(texts):
    before = selected(texts, noise=0.1)
    after = looked_again("terms hidden by noise", before)
    assert terms(after) == [{"y"}, {"x", "y"}]


def test_a_missing_term_is_found_where_the_residuals_seem_to_leave_no_room(monkeypatch):
    before = selected(("y", "-2.1*x"), noise=0.2)
    monkeypatch.setattr(Score, "possible_gain", lambda *_: 0.0)
    assert terms(looked_again("terms hidden by noise", before)) == [{"y"}, {"x", "y"}]


def test_an_equation_with_functions_gives_way_to_a_sum_of_products_and_stays_its_rival():
    before = selected(("y", "1.4*sin(5.0 - 1.5*x) - 0.3*y"), noise=0.2)
    before = replace(before, lists=[[SWING.parsed("y")], [SWING.parsed("-1.5*x")]])
    after = looked_again("terms hidden by noise", before)
    assert terms(after) == [{"y"}, {"x", "y"}]
    kept = {
        SWING.text(model.programs[1])
        for (equation, _), model in after.comparison.fitted_models.items()
        if equation == 1
    }
    assert any("sin" in text for text in kept)


def test_the_shortest_description_stays_itself():
    before = selected(("y", "-2*x - 0.3*y"), noise=0.1)
    assert looked_again("terms hidden by noise", before) is before


def test_nothing_is_tried_without_noise_nor_of_laws_among_many_variables():
    exact = selected(("y", "-2*x - 0.3*y"), noise=0.0)
    assert looked_again("terms hidden by noise", exact) is exact
    laws = {"y": (Law(from_infix("-2*x", SWING.names), 1.0, 1.0, True, is_of_rates=True),)}
    before = selected(("y", "-2.1*x"), noise=0.1, laws=laws)
    assert looked_again("terms hidden by noise", before) is before


def test_an_equation_gains_no_variable_and_no_size_that_it_may_not_have():
    for space in ({"variables_of": {"y": ("x",)}}, {"max_size": 3}):
        before = selected(("y", "-2.1*x"), 0.1, JobConfig(space=SpaceConfig(operators=("+", "-", "*"), **space)))
        assert terms(looked_again("terms hidden by noise", before))[1] == {"x"}
