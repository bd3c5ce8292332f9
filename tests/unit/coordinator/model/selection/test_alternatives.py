"""What came closest, and who wins a close ranking."""

from types import SimpleNamespace

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection import alternatives as alternatives
from atoll_coordinator.model.selection.alternatives import rank_alternatives
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.cross_validation import Validation
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.expression.program import structure
from tests.unit.coordinator.model.shooting.made import SWING, table

TIMES = 0.1 * np.arange(30.0)
STARTS = ([1.0, 2.0], [0.5, -1.0], [2.0, 0.3])
TRUTH = "-2.1*x - 0.3*y"
OTHERS = ("-1.9*x", "-2.1*x - 0.3*y + 0.01*x*x", "-0.3*y - 2.1*x", "-2.1*x - 0.2*y + 0.1*x*y", "0.3 - 2.0*x")


def selection(starts=STARTS, known=(), data=None):
    """Return the selection of the truth, with others that were tried."""
    config = JobConfig(data=data) if data is not None else JobConfig()
    preparation = prepare(table(SWING, starts, TIMES, 0.05, 130), config)
    candidates = {name: CandidateSet(known=SWING.parsed("y") if name in known else None) for name in ("x", "y")}
    task = ModellingTask(preparation.dataset, preparation.recording, config, candidates)
    comparison = task.make_comparison(task.measurements(task.variables), task.variables)
    best = comparison.fit_model([SWING.parsed("y"), SWING.parsed(TRUTH)])
    comparison.narrow_down(best, 1, [SWING.parsed(text) for text in (TRUTH, *OTHERS)], ((12, 20),))
    best = comparison.fit_from(best, best.programs, 20)
    return SelectedModel(task, comparison, best)


def ranked_by(chosen):
    return rank_alternatives(chosen, chosen.task.dataset.inputs)


def test_rivals_are_other_functions_and_no_better():
    chosen = selection()
    ranking = ranked_by(chosen)
    assert ranking.selection is chosen
    assert ranking.alternatives[0] == ()
    forms = [structure(alternative.model.programs[1]) for alternative in ranking.alternatives[1]]
    assert structure(SWING.parsed("-0.3*y - 2.1*x")) not in forms
    assert structure(SWING.parsed("-1.9*x")) in forms
    nats = [alternative.model.nats for alternative in ranking.alternatives[1]]
    assert nats == sorted(nats)
    assert nats[0] > chosen.model.nats
    assert len(forms) <= SETTINGS.effort.beam


def test_without_time_nothing_is_validated(monkeypatch):
    monkeypatch.setattr(Validation, "of", lambda *_: None)
    ranking = ranked_by(selection())
    assert ranking.validated is None
    assert [alternative.validated for alternative in ranking.alternatives[1]] == [None] * len(ranking.alternatives[1])
    assert ranking.alternatives[1]


def test_only_close_ones_are_validated():
    chosen = selection()
    for alternative in ranked_by(chosen).alternatives[1]:
        is_close = alternative.model.nats <= chosen.model.nats + SETTINGS.inference.distinct_nats
        assert (alternative.validated is not None) == is_close


def test_with_two_trajectories_nothing_is_validated():
    ranking = ranked_by(selection(STARTS[:2]))
    assert ranking.validated is None
    assert all(alternative.validated is None for alternative in ranking.alternatives[1])


def test_a_known_equation_has_no_rivals():
    assert ranked_by(selection(known=["y"])).alternatives == ((), ())


def test_the_ranking_ends_with_the_work_of_a_part_however_many_alternatives_are_shorter(monkeypatch):
    estimator = SimpleNamespace(work=7)
    comparison = SimpleNamespace(estimator=estimator)
    looks = []

    def ever_shorter(selection, _):
        looks.append(selection.model.nats)
        estimator.work += SETTINGS.effort.work // 3 + 1
        return [[SimpleNamespace(nats=selection.model.nats - 1.0)]]

    monkeypatch.setattr(alternatives, "_find_all_alternatives", ever_shorter)
    begun = SelectedModel(None, comparison, SimpleNamespace(nats=0.0))
    selection, models = alternatives._select_shortest(begun, np.zeros((1, 1)))
    assert looks == [0.0, -1.0, -2.0]
    assert (selection.model.nats, models[0][0].nats) == (-2.0, -3.0)
