"""Island workers on real Dask and Ray clusters of this machine: machines are killed, leave, come; the answer stays."""

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import atoll.workers
from atoll.client.client import Client
from atoll.client.local_processes import worker_command
from atoll.workers import Handle
from atoll_coordinator.result.result import Result
from atoll_core.errors import AtollError
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.service import Machines, running
from benchmarks.harness.systems import table_of, trajectories
from tests.integration.dask_cluster import dask_cluster
from tests.programs import all_gone, children, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # those of Dask and Ray are theirs
]
EPOCHS = 30
_RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
"""Has Ray send nothing to its makers, and write no token into the home folder."""


@pytest.fixture(scope="module")
def service() -> Iterator[tuple[Machines, Client]]:
    """A coordinator without workers."""
    with running(0) as (machines, client):
        yield machines, client


@pytest.fixture(scope="module")
def expected(service: tuple[Machines, Client]) -> str:
    """The digest that plain workers give, started by hand."""
    machines, client = service
    with subprocess.Popen(worker_command(machines.address, "plain", 2), start_new_session=True) as workers:
        try:
            return finished(client, submitted(client, "plain"))
        finally:
            workers.kill()


def submitted(client: Client, name: str) -> str:
    config = configured(seed=5, budget={**UNENDING, "max_epochs": EPOCHS}, islands=4)
    client.submit(name, name, config, client.upload(table_of(trajectories("lotka_volterra")).to_bytes()))
    return name


def finished(client: Client, job: str) -> str:
    """Follow a job to its end; return its digest."""
    until(lambda: client.status(job).state in FINAL_STATES)
    view = client.status(job)
    assert view.state == "done", view.reason
    return str(Result.of(client.result(job)).digest)


def has_come_to(client: Client, job: str, epoch: int) -> bool:
    """Tell whether a search has come so far, and go on only while it has not ended."""
    view = client.status(job)
    assert view.state not in FINAL_STATES, "it ended too soon for anything to happen in between"
    return any(variable.epoch >= epoch for variable in view.variables)


def ready(client: Client, number: int) -> bool:
    return until(lambda: sum(worker.state not in ("compiling", "lost") for worker in client.workers()) >= number)


def test_a_job_on_dask_outlives_workers_that_are_killed_added_and_retired(
    service: tuple[Machines, Client], expected: str
) -> None:
    distributed = pytest.importorskip("distributed")
    machines, client = service
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster, set_as_default=False) as dask,
        atoll.workers.start_on(dask, connect=machines.address) as handle,
    ):
        ready(client, 2)
        assert [one.processes for one in handle.machines().values()] == [1, 1]
        job = submitted(client, "dask")
        until(lambda: has_come_to(client, job, 2))
        victim, pid = next(iter(dask.run(os.getpid).items()))
        os.kill(pid, signal.SIGKILL)
        until(lambda: victim not in handle.machines() and len(handle.machines()) == 2)  # its nanny starts another
        cluster.scale(3)
        until(lambda: len(handle.machines()) == 3)
        dask.retire_workers([next(iter(handle.machines()))])
        until(lambda: len(handle.machines()) == 2)
        assert finished(client, job) == expected
        handle.check()
        pids = [child for pid in dask.run(os.getpid).values() for child in children(pid) if _is_program(child)]
        assert len(pids) == 2
        handle.close()
        assert not handle.machines()
        assert all_gone(pids)
        assert len(dask.run(os.getpid)) == 2, "the cluster itself goes on"


def _is_program(pid: int) -> bool:
    return "atoll_island_worker" in Path(f"/proc/{pid}/cmdline").read_text()


def test_why_the_workers_of_a_dask_cluster_ended_is_said() -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        atoll.workers.start_on(cluster.scheduler_address, connect="tcp/127.0.0.1:9", wait=0, workers=2) as handle,
    ):
        until(lambda: all(one.exit_code is not None for one in handle.machines().values()))
        with pytest.raises(AtollError, match=r"tcp://.* have ended with exit code 3 \(the coordinator could not be"):
            handle.check()


def test_a_job_on_ray_outlives_actors_and_nodes_that_are_killed_and_added(
    service: tuple[Machines, Client], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster as RayCluster

    for name, value in _RAY.items():
        monkeypatch.setenv(name, value)
    machines, client = service
    cluster = RayCluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        ray.init(address=cluster.address, log_to_driver=False)
        with atoll.workers.start_on(ray, connect=machines.address) as handle:
            ready(client, 1)
            job = submitted(client, "ray")
            until(lambda: has_come_to(client, job, 2))
            node = cluster.add_node(num_cpus=1)
            until(lambda: len(handle.machines()) == 2)
            actor = next(iter(handle._actors.values()))
            os.kill(ray.get(actor.__ray_call__.remote(lambda _: os.getpid())), signal.SIGKILL)  # Ray starts it again
            until(lambda: len(handle.machines()) == 2)
            cluster.remove_node(node, allow_graceful=False)
            until(lambda: len(handle.machines()) == 1)
            assert finished(client, job) == expected
            handle.check()
            handle.close()
            assert not handle.machines()
    finally:
        ray.shutdown()
        cluster.shutdown()


@pytest.fixture
def without_atoll(tmp_path: Path) -> str:
    """A folder that, among those of modules, has Atoll missing."""
    (tmp_path / "atoll").mkdir()
    (tmp_path / "atoll" / "__init__.py").write_text("raise ModuleNotFoundError('No module named atoll')\n")
    return str(tmp_path)


def test_a_dask_cluster_without_atoll_is_told_so(without_atoll: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setenv("PYTHONPATH", without_atoll)
    with dask_cluster(1) as dask:
        with pytest.raises(AtollError, match=r"did not start island workers .*No module named atoll.*same version"):
            atoll.workers.start_on(dask, connect="tcp/127.0.0.1:9")
        assert len(dask.run(os.getpid)) == 1


def test_a_ray_cluster_without_atoll_is_told_so(without_atoll: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    for name, value in _RAY.items():
        monkeypatch.setenv(name, value)
    environment = {"env_vars": {"PYTHONPATH": without_atoll}}
    ray.init(num_cpus=1, include_dashboard=False, runtime_env=environment, log_to_driver=False)
    try:
        with atoll.workers.start_on(ray, connect="tcp/127.0.0.1:9") as handle:
            until(lambda: _complaint(handle))
            assert "could not be started (ModuleNotFoundError: No module named atoll)" in _complaint(handle)
    finally:
        ray.shutdown()


def _complaint(handle: Handle) -> str:
    try:
        handle.check()
    except AtollError as error:
        return str(error)
    return ""
