"""What must be whole is whole, at whichever of its commits the coordinator dies."""

import hashlib
from dataclasses import replace
from itertools import count

import pytest

from atoll_coordinator.service.jobs.job import Job, JobAction
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.tasks.background import Dependencies
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import ClientRequest, Submit, Upload
from atoll_core.wire.security.roles import RoleBindings
from tests.simulation.bus.network import SimulatedNetwork
from tests.simulation.harness.fault_schedule import JobPlan
from tests.simulation.harness.participants import Cast
from tests.simulation.harness.schedule_run import ScheduleRun, calm_schedule
from tests.simulation.harness.simulated_disk import CoordinatorDied, Disk

TABLE = b"x,y"
DIGEST = hashlib.sha256(TABLE).hexdigest()
UPLOAD = encode(ClientRequest(body=Upload(blob=DIGEST, size=len(TABLE), index=0, sha256=DIGEST, data=TABLE)))


@pytest.mark.parametrize("before", [True, False])
def test_a_job_that_is_kept_has_its_submitter(before: bool) -> None:
    request = encode(ClientRequest(body=Submit(job="j", name="n", config=JobConfig(), table=DIGEST)))
    for commits in count(1):
        disk = Disk()
        store = disk.open(lambda seconds: None)
        network = SimulatedNetwork(0, None)
        bus = network.bus("coordinator", is_router=True)
        dependencies = Dependencies(background=lambda work: work())  # no other thread is in the store when it dies
        service = Service(bus, store, dependencies=dependencies, role_bindings=RoleBindings({"ann": "submitter"}))
        service._requests.answer(Query(topics.client(store.cluster, "ann-1"), UPLOAD, None))
        disk.die_at(commits, before)
        try:
            service._requests.answer(Query(topics.client(store.cluster, "ann-1"), request, None))
            is_over = True
        except CoordinatorDied:
            is_over = False
        disk.forget_death()
        again = disk.open(lambda seconds: None)
        assert again.submitter("j") == ("ann" if again.job("j") is not None else None), commits
        disk.close()
        if is_over:
            assert commits > 1
            return


def test_a_start_writes_only_once_it_is_under_way_and_may_be_tried_again() -> None:
    """Uploads that no job uses are deleted at the start: a full disk or a death there ends this start alone."""
    disk = Disk()
    store = disk.open(lambda seconds: None)
    network = SimulatedNetwork(0, None)
    service = Service(network.bus("coordinator", is_router=True), store)
    service._requests.answer(Query(topics.client(store.cluster, "ann-1"), UPLOAD, None))
    assert store.has_blob(DIGEST)
    store.is_dead = True
    network.crash("coordinator")
    for commits in count(1):
        again = disk.open(lambda seconds: None)
        disk.die_at(commits, before=True)
        service = Service(network.bus("coordinator", is_router=True), again)
        try:
            service.start()
        except CoordinatorDied:
            again.is_dead = True
            network.crash("coordinator")
            continue
        assert commits > 1
        assert not again.has_blob(DIGEST)
        disk.close()
        return


TIMED = JobConfig(
    seed=1,
    evolution=EvolutionConfig(islands=3),
    migration=MigrationConfig(generations=20),
    budget=BudgetConfig(max_epochs=10**6, stagnation=10**6, max_time=2.0),
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["die-before-commit", "die-after-commit"])
@pytest.mark.parametrize("commits", range(1, 4))
def test_time_ends_all_variables_or_none(kind: str, commits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
    cast = Cast(job=lambda seed: (TIMED, "x,y,z"))
    stage = ScheduleRun(replace(calm_schedule(0), workers=2, slowness=10.0), cast)
    participants, tick, cuts = stage.participants, Job.tick, []

    def deadly(job: Job, now: float) -> list[JobAction]:
        actions = tick(job, now)
        if actions and not cuts:
            participants.down_s = 1.0
            participants.disk.die_at(commits, before=kind == "die-before-commit")
            participants.at(participants.network.now + 0.5, lambda: cuts.append(participants.disk.cuts()))
        return actions

    monkeypatch.setattr(Job, "tick", deadly)
    result = stage.result_of(JobPlan(0))
    assert cuts[0] in (0, 3)
    assert {equation["why"] for equation in result["equations"]} == {"max-time"}
    assert any("dies at commit" in line for line in participants.story)
