"""What preparing hands on to refining."""

import ast
import dataclasses
import pickle
from inspect import signature
from pathlib import Path
from typing import Any

import pytest

from atoll_coordinator.model import pipeline
from atoll_coordinator.model.refinement import Pool
from atoll_coordinator.model.selection.shortcut import with_laws
from atoll_coordinator.model.sparse import product_laws
from atoll_coordinator.service.background import runner
from atoll_coordinator.service.background.dependencies import Dependencies
from atoll_coordinator.service.background.job_tasks import (
    JobPrepared,
    PreparationFailed,
    preparation_failed,
    prepare_job,
    prepare_table,
    refine,
    refine_job,
    refinement_failed,
)
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.service.monitoring.breakages import Breakages, what_to_send
from atoll_coordinator.service.store.store import Store
from atoll_core import VERSION
from tests.task_pools import LocalPool
from tests.unit.coordinator.model.sparse.ring import RING, SUMS, ring

ROOT = Path(__file__).resolve().parents[5]


def prepared() -> Prepared:
    """Return what preparing gives, as each start of a coordinator has it done."""
    outcome = prepare_job(prepare_table, "j", ring().to_bytes(), SUMS)
    assert isinstance(outcome, JobPrepared)
    return outcome.prepared


@pytest.mark.slow
def test_laws_among_many_variables_are_sought_once_in_a_job_and_are_the_same_after_a_restart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sought, tasks, find = [], [], product_laws.find_rate_laws
    monkeypatch.setattr(product_laws, "find_rate_laws", lambda rows, *space: sought.append(rows) or find(rows, *space))
    monkeypatch.setattr(pipeline, "select_model", lambda task: tasks.append(with_laws(task)))
    job, pools = prepared(), {name: Pool(()) for name in RING}
    refine_job(refine, "j", job, pools)
    assert len(sought) == len(RING)
    assert [bool(tasks[0].laws[name]) for name in RING] == [True] * 5 + [False]
    assert pickle.dumps(prepared()) == pickle.dumps(job)
    pipeline.refine_all(job.preparation, job.config, pools)
    assert len(sought) == 3 * len(RING)
    assert pickle.dumps(tasks[1].laws) == pickle.dumps(tasks[0].laws)


def test_what_breaks_says_what_to_send_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: object) -> Any:
        raise ZeroDivisionError("planted\nin two lines")

    config = SUMS.model_copy(update={"seed": 77})
    failed = prepare_job(breaks, "j", b"", config)
    assert isinstance(failed, PreparationFailed)
    job = prepared()
    refined = refine_job(breaks, "j", dataclasses.replace(job, config=config), {})
    (warning,) = refined.refinement.warnings
    assert (failed.fault, refined.refinement.end) == ("internal", "not refined")
    assert "equations are as found" in warning
    for sentence in (failed.sentence, warning):
        assert "broke (ZeroDivisionError: planted in two lines)" in sentence
        assert all(part in sentence for part in (f"Atoll {VERSION}", "seed 77", "command", "to_csv"))
        assert "\n" not in sentence


@pytest.mark.slow
def test_sentences_that_something_broke_are_made_where_they_are_told_what_to_send() -> None:
    """By `job_tasks` (above) and `breakages`; what an island says, `workers/worker_controller.py` completes."""
    sources = [path for folder in ("common", "coordinator", "island_worker") for path in (ROOT / folder).rglob("*.py")]
    names = {path.name for path in sources for node in ast.walk(ast.parse(path.read_text("utf-8")))
             if isinstance(node, ast.JoinedStr) and " broke " in ast.unparse(node)}  # fmt: skip
    assert names == {"job_tasks.py", "breakages.py", "run_queue.py"}
    assert all("to_send" in signature(part).parameters for part in (preparation_failed, refinement_failed))
    assert "please report it with" in Breakages().add("a task", ValueError("planted"))


@pytest.mark.parametrize("is_certain", [False, True])
def test_a_report_names_version_command_seed_and_data(is_certain: bool) -> None:
    sentence = what_to_send(SUMS.model_copy(update={"seed": 77}), is_certain=is_certain)
    assert ("a mistake of Atoll" in sentence) is is_certain
    assert all(part in sentence for part in (f"Atoll {VERSION}", "command or call", "seed 77", "the data", "to_csv"))


@pytest.mark.parametrize(("limit", "expected"), [(None, ["prepare"]), (20.0, ["ready", "PreparationBegun", "prepare"])])
def test_the_time_of_a_job_begins_when_its_process_is_loaded(
    monkeypatch: pytest.MonkeyPatch, limit: float | None, expected: list[str]
) -> None:
    happened: list[str] = []
    monkeypatch.setattr(runner, "ready_preparation", lambda: happened.append("ready"))
    config = SUMS.model_copy(update={"budget": SUMS.budget.model_copy(update={"max_time": limit})})
    dependencies = Dependencies(LocalPool(), preparer=lambda *_: happened.append("prepare"))  # type: ignore[arg-type, return-value]
    with Store.open(None) as store:
        tasks = runner.TaskRunner(dependencies, store, lambda item: happened.append(type(item).__name__))
        tasks.prepare("j", b"", config)
    assert happened[:-1] == expected
