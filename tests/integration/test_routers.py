"""Coordinator, worker and client that meet at routers which are none of theirs; processes and connections are real."""

import contextlib
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.wire.addresses import bindable, parse_address
from atoll_coordinator.client import connected
from tests.integration.test_processes import SEARCH, _steps, done, started, until


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which all programs run; it holds data.csv."""
    folder = tmp_path_factory.mktemp("routers")
    (folder / "data.csv").write_text(
        "\n".join(["t,x,y,dx,dy", *_steps(1.2, 0.4, 60), "", *_steps(0.5, 2.0, 60)]) + "\n"
    )
    return folder


@pytest.fixture(scope="module")
def digest(place: Path) -> str:
    """The digest of a plain run with one worker."""
    answer = done(place, "coordinator", "run", "data.csv", *SEARCH, "--workers", "1", "--out", "run", "--json")
    assert answer.returncode == 4, answer.stderr
    return str(json.loads(answer.stdout)["digest"])


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
    place: Path, digest: str
) -> None:
    central = str(bindable(parse_address("tcp/127.0.0.1:0")))
    with (
        started(place, "coordinator", "serve", "--router", central, "--state", "one", "--wait", "60"),
        routing(place, "site", "--listen", "tcp/127.0.0.1:0", "--connect", central) as (site, _),
        started(place, "island_worker", "--connect-file", "site", "--processes", "1", "--name", "far", "--wait", "90"),
        started(place, "island_worker", "--connect", central, "--processes", "1", "--name", "near", "--wait", "90"),
    ):
        with routing(place, "first", "--listen", central), connected(site, 60.0) as client:
            until(lambda: {each.worker for each in client.workers() if each.state == "ready"} == {"near", "far"})
            submit = ("submit", "data.csv", *SEARCH, "--no-wait", "--id", "j", "--connect", site)
            assert done(place, "coordinator", *submit).stdout == "j\n"
            until(lambda: client.status("j").point_evaluations > 0)
        with routing(place, "again", "--listen", central), connected(site, 60.0) as client:
            until(lambda: client.status("j").state == "done")
            assert client.result("j")["digest"] == digest
            assert {each.worker for each in client.workers() if each.state != "lost"} == {"near", "far"}
            second = done(place, "coordinator", "serve", "--router", site, "--state", "two")
            assert second.returncode == 2
            assert "a coordinator is there already" in second.stderr
            health = done(place, "coordinator", "doctor", "--connect", site, "data.csv", "--state", ".")
            assert health.returncode == 0, health.stdout
    log = (place / "coordinator.log").read_text()
    assert "router link up=False" in log
    assert "worker lost" not in log
