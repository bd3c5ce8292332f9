"""How long the pieces are that trajectories are simulated in."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection import joint_search
from atoll_coordinator.model.selection.candidates import CandidateSet, collect_candidates
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.model_selection import select_model
from atoll_coordinator.model.selection.piece_lengths import piece_remarks, refit_on_all_rows
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig, SpaceConfig
from tests.unit.coordinator.model.fitting import settings
from tests.unit.coordinator.model.shooting.made import SWING, Known, pools, table

CONFIG = JobConfig(space=SpaceConfig(operators=("-", "*")))
"""Without sums there are no libraries, which would take longer than all the rest."""


@pytest.fixture(autouse=True)
def _little_work(monkeypatch):
    monkeypatch.setattr(joint_search, "SETTINGS", settings("effort", work=300_000))


def lorenz(_, z):
    x, y, w = z
    return [10.0 * (y - x), x * (28.0 - w) - y, x * y - 8.0 / 3.0 * w]


def field_of(known, starts, times, noise, config=CONFIG, given=None, **texts):
    """Return what is modelled when the search has handed on `texts`; `given` are known equations."""
    preparation = prepare(table(known, starts, times, noise, 150), config)
    candidates = collect_candidates(preparation.dataset, config, pools(preparation, **texts))
    candidates |= {name: CandidateSet(known=known.parsed(text)) for name, text in (given or {}).items()}
    return ModellingTask(preparation.dataset, preparation.recording, config, candidates)


SWING_TEXTS = {"x": ("y",), "y": ("-1.9*x - 0.2*y",)}


def test_regular_trajectories_are_simulated_in_whole():
    task = field_of(SWING, ([1.0, 2.0], [0.5, -1.0]), 0.1 * np.arange(220.0), 0.03, **SWING_TEXTS)
    selection = select_model(task)
    assert selection.task.piece == task.piece
    assert np.diff(selection.comparison.estimator.measurements.bounds, axis=1).ravel().tolist() == [220, 220]
    assert list(piece_remarks(selection.task)) == []


def chaotic():
    """Return what is modelled: Lorenz's system, of which an initial state tells nothing after some hundred rows."""
    known = Known(("x", "y", "w"), lorenz)
    given = {"x": "10.0*(y - x)", "y": "28.0*x - x*w - y", "w": "x*y - 2.6*w"}
    return field_of(known, ([1.0, 2.0, 20.0],), 0.02 * np.arange(500.0), 0.02, given=given)


@pytest.mark.slow
def test_chaotic_ones_are_simulated_in_pieces_and_that_is_said():
    selection = select_model(chaotic())
    assert selection.task.piece in SETTINGS.shooting.lengths
    (remark,) = piece_remarks(selection.task)
    assert f"pieces of {selection.task.piece} rows" in remark
    assert "500 rows" in remark


def test_no_candidate_is_no_choice():
    texts = {"x": ("exp(9.0*x*x)",), "y": ("y*y*y*y",)}
    task = field_of(SWING, ([1.0, 2.0],), 0.1 * np.arange(40.0), 0.03, **texts)
    assert select_model(replace(task, config=JobConfig(space=SpaceConfig(operators=("exp", "*"))))) is None


@pytest.mark.slow
def test_a_choice_on_some_rows_is_fitted_to_all():
    starts = [[1.0 + 0.3 * index, 2.0] for index in range(20)]
    selection = select_model(field_of(SWING, starts, 0.1 * np.arange(80.0), 0.03, **SWING_TEXTS))
    assert selection.comparison.estimator.measurements.rows < 1_600
    whole = refit_on_all_rows(selection)
    assert whole.comparison.estimator.measurements.rows == 1_600
    values = np.sort(np.abs(whole.model.fit.system.values))
    assert values == pytest.approx([0.3, 2.0], rel=0.02)
    assert refit_on_all_rows(whole) is whole


def test_errors_of_the_integration_do_not_show_in_the_constants_of_all_rows():
    times = np.linspace(0.0, 60.0, 150)
    task = field_of(SWING, ([1.0, 2.0], [0.5, -1.0], [2.0, 0.0], [0.0, 1.5]), times, 0.02, **SWING_TEXTS)
    names, known = task.dataset.names, task.candidates
    programs = [known[name].front[0].program for name in task.variables]
    comparison = task.make_comparison(task.measurements(task.variables), task.variables)
    chosen = SelectedModel(task, comparison, comparison.fit_model(programs, 40))
    exact = ModelComparison(MultipleShooting(task.measurements(task.variables), 1e-10), names)
    exact = exact.fit_model(programs, 40)

    def distance(model):
        errors = np.sqrt(np.diag(covariance(exact.fit)))
        return np.abs((model.fit.system.values - exact.fit.system.values) / errors).max()

    assert distance(chosen.model) > 0.3
    assert distance(refit_on_all_rows(chosen).model) < 0.05
