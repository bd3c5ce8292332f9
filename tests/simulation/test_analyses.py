"""Questions about the results of jobs: answered whatever dies meanwhile, and ended when nobody waits."""

import hashlib

import pytest

from atoll_coordinator.service.tasks.analyses import WANTED_S
from atoll_core.errors import AtollError, RefusedError
from atoll_core.task_frames import Failure
from atoll_core.wire.messages.clients import AskAnalysis
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

QUESTION = b"q"


def ended(workers: int = 2) -> World:
    """Return a world with a job that has ended."""
    world = World(workers=workers, seed=1)
    world.run(short_job(1, islands=4, generations=100, max_epochs=5))
    return world


def expected(world: World, *tables: bytes) -> bytes:
    """Return what stub tasks answer of the stored result."""
    text = world.store.result("job")
    assert text is not None
    return hashlib.sha256(b"".join([text.encode(), QUESTION, *tables])).digest()


@pytest.mark.parametrize("fate", [None, "error", "crash", "memory"])
def test_an_answer_comes_whatever_its_first_worker_meets(fate: Failure | None) -> None:
    world = ended()
    world.fate.coming = [fate]
    world.fate.met.clear()
    assert world.client.analyse("job", "report", QUESTION) == expected(world)
    assert world.fate.counts == {fate or "lost": 1}
    world.client.pause(2.0 * WANTED_S)
    controller = world.service.controller.tasks
    assert (len(controller.table), [*controller.analyses], controller._blobs) == (0, [], {})


def test_measurements_are_uploaded_and_handed_to_the_worker() -> None:
    world = ended()
    assert world.client.analyse("job", "profile", QUESTION, b"t,x\n1,2\n") == expected(world, b"t,x\n1,2\n")


def test_a_question_of_somebody_who_has_gone_is_ended_and_its_worker_is_free() -> None:
    world = ended(workers=1)
    world.background_s = 1000.0
    asked = AskAnalysis(job="job", function="report", question=QUESTION)
    world.service.controller.analyse(asked, None, world.network.now)
    world.client.pause(5.0)
    assert [task.state for task in world.service.controller.tasks.table] == ["leased"]
    world.client.pause(WANTED_S)
    assert len(world.service.controller.tasks.table) == 0
    world.background_s = 0.001
    assert world.client.analyse("job", "suggest", QUESTION) == expected(world)


def test_a_job_that_runs_or_has_gone_cannot_be_asked_about() -> None:
    world = ended()
    world.submit(short_job(1, islands=4, generations=100, max_epochs=100_000, stagnation=100_000), job="endless")
    with pytest.raises(RefusedError, match="job endless has not ended"):
        world.client.analyse("endless", "report", QUESTION)
    world.client.delete("job")
    with pytest.raises(RefusedError, match="there is no job job"):
        world.client.analyse("job", "report", QUESTION)


def test_what_fails_for_good_is_said() -> None:
    world = ended()
    world.fate.coming = ["time"]
    with pytest.raises(AtollError, match=r"the analysis failed \(planted"):
        world.client.analyse("job", "report", QUESTION)
