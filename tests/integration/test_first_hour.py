"""Tables as people hand them over in the first hour: whole jobs, from the file to the verdict, in one process.

The cases and what is made of their outcomes are those of `benchmarks.first_hour`; the service runs in virtual time,
with real islands, preparing and refining.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.tasks.preparing import prepare_table
from atoll_core.config import JobConfig
from benchmarks.first_hour.campaign import BROKE, is_as_it_should_be, line, request
from benchmarks.first_hour.cases import CASES, Case
from benchmarks.first_hour.outcomes import End, Outcome, judge
from tests.simulation.harness.simulated_cluster import World, patiently
from tests.simulation.test_real_islands import RealCompute

QUICK = [
    *("6 rows a period", "8 rows a period"),
    *(
        "decay",
        "growth",
        "ramp",
        "ramp down of whole numbers",
        "free fall",
        "tanh",
        "square",
        "two decays",
        "hyperbola",
    ),
    *("called sint, cost", "called lambda, class"),
    *("decay, 3 rows", "decay, 4 rows", "decay, 12 rows"),
    *("decay from 1e-30", "decay from 1e30", "decay in nanoseconds", "decay over millions of years"),
    "0 and 1 in turn",
]
LONGER = [
    *("5 rows a period", "10 rows a period", "relaxation to 20 degrees"),
    *("called None, nan", "called prey, grey, größe", "called dx, x"),
    *("1e-30 beside 1e30", "decay, 8 rows", "white noise, 8 rows", "3 rows a period"),
    *("a recording of an enzyme", "a recording of a damped swing"),
]
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
    broken = [warning for warning in answer.get("warnings", ()) if BROKE in warning]
    end: End = "broke" if broken or (not answer and view.fault != "data") else "done" if answer else "refused"
    return Outcome(case.name, end, "".join(broken) or view.reason or "", judge(case, answer), 0.0, 0.0)


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in LONGER)])
def test_nothing_breaks_identified_laws_are_found_and_none_is_made_up(name: str, tmp_path: Path) -> None:
    with np.errstate(all="ignore"):  # as in the processes that do this
        outcome = played(CASES[name], tmp_path)
    assert is_as_it_should_be([outcome]), line(outcome)
    assert all(equation.is_found for equation in outcome.equations if equation.is_identified), line(outcome)


@pytest.mark.slow
def test_an_epidemic_with_noise_is_right_and_not_doubtful(tmp_path: Path) -> None:
    with np.errstate(all="ignore"):
        outcome = played(CASES["S + I + R = 1, 1 % of noise"], tmp_path)
    assert [(equation.is_found, equation.verdict) for equation in outcome.equations] == [(True, "good")] * 3, line(
        outcome
    )
