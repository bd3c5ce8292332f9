"""The operator's second mistake: what goes wrong after something has gone wrong, and what of it is still there."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.schema import FILE_NAME
from atoll_coordinator.service.store.store import Store
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig
from atoll_core.errors import RefusedError
from atoll_core.wire.messages.views import JobView
from tests.simulation.harness.simulated_cluster import World, comparable

SHORT = JobConfig(budget=BudgetConfig(max_epochs=2))
LONG = JobConfig(
    seed=1,
    evolution=EvolutionConfig(islands=3),
    migration=MigrationConfig(generations=20),
    budget=BudgetConfig(max_epochs=10**6, stagnation=10**6),
)


def until(world: World, state: str, job: str = "job") -> None:
    while world.client.status(job).state != state:
        world.client.pause(0.1)


def kill_all(world: World) -> None:
    for name in list(world.workers):
        world.crash(name)
    world.network.crash("coordinator")


def start_alone(world: World, away_s: float = 5.0) -> None:
    """Start the coordinator again, and no worker."""
    world.network.run(away_s)
    world.service = world.start_service()
    world.client.pause(2.0)


def refining() -> World:
    """Return a world in which a job is refined, and will be for long."""
    world = World(workers=2)
    world.submit(SHORT)
    until(world, "running")
    world.background_s = 1e6
    until(world, "refining")
    return world


def view_with_equations(world: World) -> JobView:
    """Return the view of the job once the background thread has written its equations."""
    world.background_s = 0.001
    for _ in range(20):
        view = world.client.status("job")
        if all(each.expression for each in view.variables):
            break
        world.client.pause(0.5)
    return view


# --------------------------------------------------------------------------- killed, and only the coordinator started


def test_what_a_search_has_found_is_shown_without_a_worker_and_time_goes_on() -> None:
    world = refining()
    world.client.pause(30.0)
    before, found = world.client.status("job"), world.result()
    kill_all(world)
    start_alone(world)
    after = view_with_equations(world)
    assert (after.state, after.held) == ("refining", False)
    assert after.elapsed >= before.elapsed > 30.0
    assert "waits for a worker" in (after.reason or "")
    assert [each.expression for each in after.variables] == [each.expression for each in before.variables]
    assert all(each.finished and each.expression for each in after.variables)
    assert comparable(world.result()) == comparable(found)
    assert [job.job for job in world.client.page_of_jobs(state="refining").jobs] == ["job"]
    assert world.client.page_of_jobs(state="running").jobs == ()
    world.close()


def test_a_cancelled_job_keeps_what_it_has_found_whether_or_not_a_worker_is_there() -> None:
    world = refining()
    found = world.result()
    kill_all(world)
    start_alone(world)
    view = world.client.cancel("job")
    assert view.state == "cancelled"
    kept = world.result()
    assert kept["digest"] == found["digest"]
    assert [each["expression"] for each in kept["equations"]] == [each["expression"] for each in found["equations"]]
    assert world.store.held(ALL).live == 0, "what was kept of its preparation alone is deleted with its end"
    world.close()


def test_a_search_that_was_under_way_is_shown_and_kept_from_its_last_checkpoint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
    world = World(workers=2, slowness=10.0)
    world.submit(LONG)
    while len(world.store.checkpoints("job")) < 2:
        world.client.pause(0.5)
    kill_all(world)
    start_alone(world)
    view = view_with_equations(world)
    assert view.state == "running"
    assert view.variables
    assert all(each.expression for each in view.variables)
    assert world.client.cancel("job").state == "cancelled"
    assert all(equation["expression"] for equation in world.result()["equations"])
    world.close()


def test_nothing_is_thrown_away_where_only_another_version_could_read_it() -> None:
    """Of a store of an earlier version what preparing gave is not kept, and it is made again by the first worker."""
    world = refining()
    found = world.result()
    kill_all(world)
    with world.store._transaction() as sql:
        sql.execute("UPDATE jobs SET prepared_digest = NULL")
    start_alone(world)
    with pytest.raises(RefusedError, match=r"continues a stored search.*start a worker"):
        world.client.cancel("job")
    world.background_s = 0.001
    world.start_worker("w9")
    world.finish()
    assert world.result()["digest"] == found["digest"]
    world.close()


# ------------------------------------------------------------------------------------------- paused, killed, started


@pytest.mark.parametrize("state", ["preparing", "running", "refining"])
def test_a_paused_queue_holds_up_what_is_new_and_nothing_that_had_begun(
    state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 5)
    world = World(workers=2, slowness=10.0)
    if state == "preparing":
        world.background_s = 1e6
    world.submit(LONG)
    if state == "refining":
        until(world, "running")
        world.background_s = 1e6
    until(world, state)
    world.client.pause_queue()
    world.submit(SHORT, job="new")
    kill_all(world)
    start_alone(world)
    world.background_s = 0.001
    world.start_worker("w9")
    assert world.finish().state == "done"
    assert world.client.status("new").state == "queued"
    world.client.pause_queue(paused=False)
    assert world.finish("new").state == "done"
    world.close()


# ---------------------------------------------------------------------------------- damaged, moved, restored, served


def test_a_store_that_was_damaged_moved_restored_and_served_has_all_its_jobs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, place = tmp_path / "state", ["--state", str(tmp_path / "state")]
    with Store.open(state) as store:
        for number in range(300):
            store.add_job(JobRecord(f"j{number}", "n", "{}", "", "2026"))
        assert main(["backup", str(tmp_path / "copy"), *place]) == 0
        store.add_job(JobRecord("later", "n", "{}", "", "2026"))
        wal = (state / f"{FILE_NAME}-wal").read_bytes()  # a coordinator that is killed leaves it
    (state / FILE_NAME).write_bytes(b"damaged" * 1000)
    (state / FILE_NAME).rename(tmp_path / "damaged")
    (state / f"{FILE_NAME}-wal").write_bytes(wal)
    capsys.readouterr()
    assert main(["restore", str(tmp_path / "copy"), *place, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["jobs"], told["former"], len(told["aside"])) == (300, None, 1)
    for _ in range(2):
        with Store.open(state) as store:
            assert (store.cluster, len(store.jobs())) == (told["cluster"], 300)


# ------------------------------------------------------------------------------------------- full, freed and started


def test_a_coordinator_whose_disk_was_full_starts_again_when_there_is_room(tmp_path: Path) -> None:
    with Store.open(tmp_path / "state") as store:
        for number in range(40):
            store.add_job(JobRecord(f"j{number}", "n", "x" * 4000, "", "2026"))
    program = (
        "import resource, sys\nresource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "from atoll.cli.main import main\nsys.exit(main(sys.argv[1:]))"
    )
    words = ["serve", "--listen", "tcp/127.0.0.1:0", "--state", "state"]
    command = [sys.executable, "-B", "-c", program, *words]  # without -B, compiled modules are cut off and kept
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 1, "exit code 2 keeps the service down for good"
    assert len(ended.stderr.splitlines()) == 1
    with Store.open(tmp_path / "state") as store:
        assert len(store.jobs()) == 40
