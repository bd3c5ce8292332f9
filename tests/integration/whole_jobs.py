"""Whole jobs of small tables in one process and in virtual time, with real islands, preparing and refining."""

from pathlib import Path
from typing import Any

from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.tasks.preparing import prepare_table
from atoll_core.config import JobConfig
from atoll_core.wire.messages.views import JobView
from benchmarks.first_hour.campaign import BROKE, request
from benchmarks.first_hour.cases import Case
from benchmarks.first_hour.outcomes import End, Outcome, judge
from tests.simulation.harness.simulated_cluster import World, patiently
from tests.simulation.test_real_islands import RealCompute

ENDLESS_S = 1e6
"""Virtual seconds: epochs end a job here, never its time."""


def short(config: JobConfig) -> JobConfig:
    """Return a configuration that searches little: laws come from regression, and the rest is to be judged as it is."""
    parts: dict[str, Any] = {
        "budget": config.budget.model_copy(update={"max_epochs": 1}),
        "evolution": config.evolution.model_copy(update={"islands": 2, "population": 16}),
        "migration": config.migration.model_copy(update={"generations": 20}),
    }
    return config.model_copy(update=parts)


def played(case: Case, folder: Path) -> Outcome:
    """Play the job of a table from its file on; what is raised is not caught."""
    return outcome_of(case, *answered(case, folder))


def answered(case: Case, folder: Path) -> tuple[dict[str, Any], JobView]:
    """Return the result.json of a table, empty where there is none, and the last view of its job."""
    asked = request(case, folder)
    table = read_table(asked.files, asked.config.data)
    world = World(workers=1, compute=RealCompute, prepare=prepare_table, refiner=refine_all)
    try:
        digest = patiently(lambda: world.client.upload(table.to_bytes()))
        patiently(lambda: world.client.submit("job", case.name, short(asked.config), digest, 0))
        view = world.finish(limit_s=ENDLESS_S)
        answer = world.result() if view.state == "done" else {}
    finally:
        world.close()
    return answer, view


def outcome_of(case: Case, answer: dict[str, Any], view: JobView) -> Outcome:
    """Return how a job came out, judged by the laws of its case."""
    broken = [warning for warning in answer.get("warnings", ()) if BROKE in warning]
    end: End = "broke" if broken or (not answer and view.fault != "data") else "done" if answer else "refused"
    return Outcome(case.name, end, "".join(broken) or view.reason or "", judge(case, answer), 0.0, 0.0)
