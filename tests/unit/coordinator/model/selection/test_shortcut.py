"""Laws that stand at the noise level are fitted together; where they do not, the long way is taken."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.inference.conclusion import conclude
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import FrontMember, Law
from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.model.selection import proposals
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.model_selection import select_model
from atoll_coordinator.model.selection.shortcut import add_laws, select_laws
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import PRESETS, JobConfig, SpaceConfig
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import Known, pools, table
from tests.unit.coordinator.model.sparse.lorenz import NAMES, TERMS, monomials, prepared
from tests.unit.coordinator.model.sparse.ring import RING, SUMS, TRUTHS, ring


def task_of(*sample, **options):
    preparation = prepared(*sample, **options)
    candidates = {name: CandidateSet() for name in NAMES}
    return ModellingTask(preparation.dataset, preparation.recording, PRESETS["default"], candidates)


def concluded(task):
    selection = select_model(task)
    assert selection is not None
    return selection, conclude(selection, Preparation(task.dataset, task.recording))


def test_lorenz_with_five_percent_of_noise_is_found_without_a_search_and_called_good():
    selection, refinement = concluded(task_of(1000, 0.05, trajectories=2))
    assert selection.task.piece < 300
    for name in NAMES:
        equation = refinement.equations[name]
        assert monomials(to_infix(equation.program, NAMES)) == TERMS[name], name
        assert equation.grade == "good", equation.reason


@pytest.mark.slow
def test_lorenz_by_a_solver_of_tolerance_1e_6_has_no_further_terms():
    _, refinement = concluded(task_of(1000, 0.0, step=0.02, rtol=1e-6, atol=1e-9, method="RK45"))
    for name in NAMES:
        assert monomials(to_infix(refinement.equations[name].program, NAMES)) == TERMS[name], name


@pytest.mark.slow
def test_pieces_are_as_long_as_errors_of_the_size_of_the_noise_stay_small():
    lengths = [select_laws(add_laws(task_of(1000, noise, trajectories=2))).task.piece for noise in (0.002, 0.05)]
    assert lengths[0] > 1.3 * lengths[1]


@pytest.mark.parametrize(("digits", "is_exact"), [(None, True), (5, False)])
def test_of_few_rows_only_exact_residuals_make_laws_the_model(digits, is_exact, caplog):
    known = Known(("x", "y"), lambda _, z: [1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]])
    config = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "/")))
    measured = table(known, [(10.0, 5.0)], np.linspace(0.0, 30.0, 200))
    if digits is not None:
        measured = replace(measured, columns=measured.columns.round(digits))
    preparation = prepare(measured, config)
    with caplog.at_level("INFO"):
        refined = refine_all(preparation, config, pools(preparation, x=("1.1*x - 0.4*x*y",), y=("0.1*x*y - 0.4*y",)))
    assert ("the nearest candidates" in caplog.text) is not is_exact
    assert refined.equations["x"].grade == "exact"
    assert [len(refined.equations[name].constants) for name in ("x", "y")] == [2, 2]


def test_without_a_law_at_the_noise_level_the_long_way_is_taken():
    task = add_laws(task_of(150, 0.05))
    assert select_laws(task) is None
    assert task.longest == 150


@pytest.mark.slow
def test_pieces_without_noise_are_no_longer_than_double_precision_determines_constants_from():
    """Errors grow e-fold in 0.9: over 250 rows of 0.02 a hundred-fold, and a thousand-fold where they grow fastest."""
    assert select_laws(add_laws(task_of(1000, 0.0, step=0.02, trajectories=3))).task.piece < 300


@cache
def clean_task():
    """Return the task of one long trajectory without noise."""
    return add_laws(task_of(800, 0.0, step=0.02))


def converged_task(texts, *, with_law):
    """Return the task of Lorenz's system without noise, to whose equations a search has converged as written."""
    task = clean_task()
    settled = {
        name: Refined(None, from_infix(text, NAMES), error=1e-12, mse=1e-24)
        for name, text in zip(NAMES, texts, strict=True)
    }
    return replace(task, settled=settled, laws=task.laws if with_law else dict.fromkeys(NAMES, ()))


@pytest.mark.slow
def test_equations_that_a_search_without_noise_has_converged_to_stand_beside_laws_and_in_their_place():
    texts = ("10*(y - x)", "x*(28 - z) - y", "x*y - 2.5*z - 1/6*z")
    for with_law in (True, False):
        selected = select_laws(converged_task(texts, with_law=with_law))
        for name, program in zip(NAMES, selected.model.programs, strict=True):
            assert monomials(to_infix(program, NAMES)) == TERMS[name], name


@pytest.mark.slow
def test_equations_without_a_law_must_be_exact_for_no_search_around_them():
    texts = ("10*(y - x)", "x*(28 - z) - y", "x*y")
    assert select_laws(converged_task(texts, with_law=False)) is None


WRONG = "x1*x0 - x2*x3"
"""A law of the third state of the ring, whose truth is x1*x0 - x2."""


def ring_with_a_wrong_law():
    """Return the preparation of the ring with noise, and its laws."""
    preparation = prepare(ring(0.01), SUMS)
    texts = {**TRUTHS, "x2": WRONG, "x5": "2/(1 + x0*x0) - x5"}
    laws = {name: (Law(from_infix(text, RING), 1.0, 1.0, True, is_of_rates=True),) for name, text in texts.items()}
    return preparation, [laws]


def forms(programs):
    return [monomials(to_infix(program, RING), RING) for program in programs]


def test_one_wrong_law_gives_way_to_another_candidate_and_leaves_the_others_as_they_are(monkeypatch):
    monkeypatch.setattr(proposals, "_pursue", lambda *_: ())
    preparation, laws = ring_with_a_wrong_law()
    candidates = {name: CandidateSet() for name in RING}
    candidates["x2"] = CandidateSet((FrontMember(from_infix("x0*x1 - 0.9*x2", RING), 0.1, 0.01),))
    task = ModellingTask(preparation.dataset, preparation.recording, SUMS, candidates, among_many=laws)
    assert select_laws(add_laws(task)) is None
    selected = select_model(task)
    assert forms(selected.model.programs[:5]) == forms(from_infix(text, RING) for text in TRUTHS.values())
