"""Coordinator, workers and routers as processes of several machines: who finds whom, and who is left when one dies."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.client.client import connected
from atoll_core.wire.addresses import bindable, parse_address
from tests.programs import LIMIT_S, ROOT, all_gone, children, done, environment, serving, started, until

SEARCH = ["--derivatives", "dx,dy", "--seed", "3", "--islands", "3", "--target-error", "1e-300", "--max-epochs", "4"]


def _steps(x: float, y: float, count: int) -> Iterator[str]:
    """Two competing species by Runge and Kutta's fourth-order rule, and their derivatives: what is left to refine then
    takes least.
    """

    def slope(x: float, y: float) -> tuple[float, float]:
        return 3 * x - 2 * x * y - x * x, 2 * y - x * y - y * y

    h = 0.02
    for step in range(count):
        a = slope(x, y)
        yield f"{step * h:.2f},{x!r},{y!r},{a[0]:.9f},{a[1]:.9f}"
        b = slope(x + h / 2 * a[0], y + h / 2 * a[1])
        c = slope(x + h / 2 * b[0], y + h / 2 * b[1])
        d = slope(x + h * c[0], y + h * c[1])
        x += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        y += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])


@pytest.fixture(scope="module", autouse=True)
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which all programs run; it holds data.csv."""
    folder = tmp_path_factory.mktemp("machines")
    (folder / "data.csv").write_text(
        "\n".join(["t,x,y,dx,dy", *_steps(1.2, 0.4, 60), "", *_steps(0.5, 2.0, 60)]) + "\n"
    )
    return folder


@pytest.fixture(scope="module")
def digest(place: Path) -> str:
    """The digest of a plain run with one worker."""
    answer = done(place, "coordinator", "run", "data.csv", *SEARCH, "--workers", "1", "--out", "run", "--json")
    assert answer.returncode == 4, answer.stderr
    written = json.loads(answer.stdout)["digest"]
    assert isinstance(written, str)
    return written


@pytest.mark.slow
def test_a_job_on_several_machines_has_the_digest_of_a_run_on_one(place: Path, digest: str) -> None:
    with serving(place, "one") as (address, _), connected(address) as coordinator:
        worker = started(place, "island_worker", "--connect", address, "--processes", "2", "--name", "lab")
        with worker as several, started(place, "island_worker", "--connect", address, "--processes", "1") as single:
            until(lambda: len(coordinator.workers()) == 3)
            assert {"lab-0", "lab-1"} < {worker.worker for worker in coordinator.workers()}
            pids = children(several.pid)
            assert len(pids) == 3  # with the server of tasks
            followed = done(place, "coordinator", "submit", "data.csv", *SEARCH, "--id", "j", "--connect", address)
            assert followed.returncode == 4, followed.stderr
            assert coordinator.status("j").state == "done"
            assert coordinator.result("j")["digest"] == digest
            for process in (several, single):
                process.send_signal(signal.SIGTERM)
                assert process.wait(LIMIT_S) == 0
            assert until(lambda: all_gone(pids))


@pytest.mark.slow
def test_workers_that_are_killed_with_their_parent_leave_nothing_and_others_finish_the_job(
    place: Path, digest: str
) -> None:
    with serving(place, "two") as (address, _), connected(address) as coordinator:
        with started(place, "island_worker", "--connect", address, "--processes", "2", "--name", "first") as parent:
            submitted = done(
                place, "coordinator", "submit", "data.csv", *SEARCH, "--id", "j", "--no-wait", "--connect", address
            )
            assert submitted.stdout == "j\n", submitted.stderr
            until(lambda: coordinator.status("j").point_evaluations > 0)
            pids = children(parent.pid)
            parent.kill()
            assert until(lambda: all_gone(pids))
        with started(place, "island_worker", "--connect", address, "--processes", "1", "--name", "second"):
            until(lambda: coordinator.status("j").state == "done")
            assert coordinator.result("j")["digest"] == digest


@pytest.mark.slow
def test_a_worker_without_a_coordinator_says_so_and_ends_with_3(place: Path) -> None:
    for processes in ("1", "2"):
        options = ["--connect", "tcp/127.0.0.1:9", "--processes", processes, "--wait", "0.5"]
        answer = done(place, "island_worker", *options)
        assert answer.returncode == 3
        assert answer.stdout == ""
        assert answer.stderr.count("no coordinator answers at tcp/127.0.0.1:9") == 1
        assert "Traceback" not in answer.stderr


@pytest.mark.slow
def test_a_worker_whose_coordinator_stays_away_says_so_and_ends_with_3(place: Path) -> None:
    with serving(place, "three") as (address, process):
        options = ["--connect", address, "--processes", "1", "--wait", "1"]
        with started(place, "island_worker", *options) as worker:
            with connected(address) as coordinator:
                until(coordinator.workers)
            process.kill()
            assert worker.wait(LIMIT_S) == 3
    assert "the coordinator has not answered for 1 s" in (place / "island_worker.log").read_text()


def test_a_process_that_is_killed_is_started_again_under_its_name(place: Path) -> None:
    with serving(place, "six") as (address, _), connected(address) as coordinator:
        family = started(place, "island_worker", "--connect", address, "--processes", "2", "--name", "again")
        with family as parent:
            until(lambda: len(coordinator.workers()) == 2)
            before = {worker.worker: worker.pid for worker in coordinator.workers()}
            os.kill(before["again-0"], signal.SIGKILL)
            until(
                lambda: {worker.worker: worker.pid for worker in coordinator.workers()}["again-0"] != before["again-0"]
            )
            assert {worker.worker: worker.pid for worker in coordinator.workers()}["again-1"] == before["again-1"]
            parent.send_signal(signal.SIGTERM)
            assert parent.wait(LIMIT_S) == 0
    said = (place / "island_worker.log").read_text()
    assert f"process {before['again-0']} (again-0) was ended by signal 9; it is started again in 1 s" in said


@pytest.mark.slow
def test_a_coordinator_that_is_killed_while_it_refines_refines_again(place: Path, digest: str) -> None:
    submission = ["coordinator", "submit", "data.csv", *SEARCH, "--id", "j", "--no-wait", "--connect"]
    with serving(place, "seven") as (address, process), connected(address) as coordinator:
        worker = started(place, "island_worker", "--connect", address, "--processes", "1")
        with worker:
            assert done(place, *submission, address).returncode == 0
            until(lambda: coordinator.status("j").state == "refining")
            process.kill()
            process.wait(LIMIT_S)
    with serving(place, "seven") as (address, _), connected(address) as coordinator:
        assert coordinator.status("j").state in ("queued", "preparing", "running", "refining")
        with started(place, "island_worker", "--connect", address, "--processes", "1"):
            until(lambda: coordinator.status("j").state == "done")
            assert coordinator.result("j")["digest"] == digest


@contextlib.contextmanager
def routing(place: Path, name: str, *words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run a router; yield the address that it left in its file."""
    file = place / name
    file.unlink(missing_ok=True)
    with started(place, "coordinator", "router", "--connect-file", name, *words) as process:
        until(file.exists)
        yield file.read_text().split()[0], process


@pytest.mark.slow
def test_a_job_through_two_routers_one_of_which_is_killed_under_way_has_the_same_digest(
    place: Path, tmp_path: Path, digest: str
) -> None:
    place = Path(shutil.copy(place / "data.csv", tmp_path)).parent
    central = str(bindable(parse_address("tcp/127.0.0.1:0")))
    with (
        started(place, "coordinator", "serve", "--router", central, "--state", "one", "--wait", "60"),
        routing(place, "site", "--listen", "tcp/127.0.0.1:0", "--connect", central) as (site, _),
        started(place, "island_worker", "--connect-file", "site", "--processes", "1", "--name", "far", "--wait", "90"),
        started(place, "island_worker", "--connect", central, "--processes", "1", "--name", "near", "--wait", "90"),
    ):
        with routing(place, "first", "--listen", central), connected(site, 60.0) as client:
            until(lambda: {worker.worker for worker in client.workers() if worker.state == "ready"} == {"near", "far"})
            submit = ("submit", "data.csv", *SEARCH, "--no-wait", "--id", "j", "--connect", site)
            assert done(place, "coordinator", *submit).stdout == "j\n"
            until(lambda: client.status("j").point_evaluations > 0)
        with routing(place, "again", "--listen", central), connected(site, 60.0) as client:
            until(lambda: client.status("j").state == "done")
            assert client.result("j")["digest"] == digest
            assert {worker.worker for worker in client.workers() if worker.state != "lost"} == {"near", "far"}
            second = done(place, "coordinator", "serve", "--router", site, "--state", "two")
            assert second.returncode == 1
            assert "another coordinator already answers behind the router" in second.stderr
            health = done(place, "coordinator", "doctor", "--connect", site, "data.csv", "--state", ".")
            assert health.returncode == 0, health.stdout
    log = (place / "coordinator.log").read_text()
    assert "router link up=False" in log
    assert "worker lost" not in log


SRUN = """#!/bin/bash
while [[ $1 == --* ]]; do shift; done
echo $$ >"$ATOLL_DIR/step"
exec "$@"
"""
"""Stands for Slurm's own: runs the command of a step here, and `SCANCEL` signals it."""

SCANCEL = '#!/bin/bash\nkill -USR1 "$(cat "$ATOLL_DIR/step")"\n'


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_a_slurm_job_has_the_digest_and_lets_nobody_else_in(place: Path, digest: str) -> None:
    """Only Slurm is a stand-in: openssl makes the certificates, with which coordinator, worker and client meet."""
    programs, folder = place / "bin", place / "slurm"
    programs.mkdir()
    ours = {
        name: f'#!/bin/bash\nexec {sys.executable} -m {module} "$@"\n'
        for name, module in {"coordinator": "atoll", "island-worker": "atoll_island_worker"}.items()
    }
    for name, text in {**ours, "srun": SRUN, "scancel": SCANCEL}.items():
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    surroundings = {
        **environment(), "PATH": f"{programs}:{os.environ['PATH']}", "ATOLL_DIR": str(folder), "SLURM_JOB_ID": "7",
        "SLURM_CPUS_PER_TASK": "1",
    }  # fmt: skip
    script = ["bash", str(ROOT / "deploy/slurm/atoll.sbatch"), "data.csv", *SEARCH]
    with subprocess.Popen(script, cwd=place, env=surroundings, stdout=subprocess.DEVNULL, text=True) as job:
        try:
            until(lambda: (folder / "address").exists() or job.poll() is not None)
            address = (folder / "address").read_text().split()[-1]
            assert address.startswith("tls/")
            stranger = done(place, "coordinator", "jobs", "--connect", address.replace("tls/", "tcp/"))
            assert stranger.returncode == 2, stranger.stderr
            assert "asks for TLS" in stranger.stderr
            assert job.wait(LIMIT_S) == 4
        finally:
            job.kill()
    assert json.loads((folder / "result" / "result.json").read_text())["digest"] == digest
