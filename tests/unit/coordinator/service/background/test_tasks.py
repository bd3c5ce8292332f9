"""What preparing hands on to refining."""

import pickle

import pytest

from atoll_coordinator.model import pipeline
from atoll_coordinator.model.refinement import Pool
from atoll_coordinator.model.selection.shortcut import with_laws
from atoll_coordinator.model.sparse import laws
from atoll_coordinator.service.background.tasks import JobPrepared, prepare_job, prepare_table, refine, refine_job
from atoll_coordinator.service.jobs.job import Prepared
from tests.unit.coordinator.model.sparse.ring import RING, SUMS, ring


def prepared() -> Prepared:
    """Return what preparing gives, as each start of a coordinator has it done."""
    outcome = prepare_job(prepare_table, "j", ring().to_bytes(), SUMS)
    assert isinstance(outcome, JobPrepared)
    return outcome.prepared


def test_laws_among_many_variables_are_sought_once_in_a_job_and_are_the_same_after_a_restart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sought, tasks, find = [], [], laws.find_rate_laws
    monkeypatch.setattr(laws, "find_rate_laws", lambda rows, *space: sought.append(rows) or find(rows, *space))
    monkeypatch.setattr(pipeline, "select_model", lambda task: tasks.append(with_laws(task)))
    job, pools = prepared(), {name: Pool(()) for name in RING}
    refine_job(refine, "j", job, pools)
    assert len(sought) == len(RING)
    assert [bool(tasks[0].laws[name]) for name in RING] == [True] * 5 + [False]
    assert pickle.dumps(prepared()) == pickle.dumps(job)
    pipeline.refine_all(job.preparation, job.config, pools)
    assert len(sought) == 3 * len(RING)
    assert pickle.dumps(tasks[1].laws) == pickle.dumps(tasks[0].laws)
