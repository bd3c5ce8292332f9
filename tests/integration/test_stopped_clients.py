"""Clients that ask for large answers and are stopped before they take them keep nobody else from an answer."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from atoll.client.client import Client, connected
from atoll_core.config import JobConfig
from atoll_core.wire.addresses import destination, parse_address
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count
from atoll_core.wire.security.credentials import load
from tests.certificates import Lab
from tests.integration import stopped_client
from tests.programs import environment, serving, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc tells who has stopped and which links are up")

ESTABLISHED = "01"
STOPPED = 8
"""Clients that stop: more than the threads of zenoh that read, by itself."""
ASKED = 60
AFTERWARDS = 500
TABLE = b"t,x\n" + b"1.5,2.5\n" * (5 * CHUNK_SIZE // 16)


def test_stopped_clients_keep_no_other_client_from_an_answer(tmp_path: Path) -> None:
    """Until the coordinator has closed the links of all of them, and after that."""
    with serving(tmp_path, "state") as (address, _), connected(address) as other:
        other.hand_in("job", "a table", JobConfig(), TABLE)
        with stopped(address, other.welcome.realm, "stopped") as clients:
            port = parse_address(address).port
            until(lambda: answers(other) and are_stopped(clients) and links(port) == 1)
            assert all(answers(other) for _ in range(AFTERWARDS))
            assert are_stopped(clients)


@pytest.mark.slow
def test_stopped_clients_of_one_user_keep_no_other_user_from_an_answer(tmp_path: Path, lab: Lab) -> None:
    """Until that user gets the same table by another client, whose turn comes when the stopped ones are given up."""
    options = ("--roster", str(lab.folder / "roster.toml"), *lab.options("coordinator"))
    with serving(tmp_path, "state", "tls/127.0.0.1:0", *options) as (printed, _):
        address = f"tls/localhost:{parse_address(printed).port}"
        with user(address, lab, "bob") as bob, user(address, lab, "ann") as ann, ThreadPoolExecutor(1) as thread:
            bob.hand_in("job", "a table", JobConfig(), TABLE, shared=True)
            with stopped(address, ann.welcome.realm, "bob", *map(str, lab.files("bob"))) as clients:
                until(lambda: answers(ann) and are_stopped(clients))
                table = thread.submit(bob.table, "job")
                until(lambda: answers(ann) and table.done())
                assert table.result() == TABLE
                assert all(answers(ann) for _ in range(AFTERWARDS))
                assert are_stopped(clients)


@contextlib.contextmanager
def user(address: str, lab: Lab, name: str) -> Iterator[Client]:
    with connected(destination(address, load(*lab.files(name), use="connect"))) as client:
        yield client


@contextlib.contextmanager
def stopped(address: str, realm: str, name: str, *files: str) -> Iterator[list[int]]:
    """Have clients ask for the table of the job and stop; yield their processes, which may not be so far yet."""
    words = [address, realm, name, "job", str(chunk_count(len(TABLE))), str(ASKED), *files]
    with contextlib.ExitStack() as stack:
        processes = [
            stack.enter_context(subprocess.Popen([sys.executable, stopped_client.__file__, *words], env=environment()))
            for _ in range(STOPPED)
        ]
        for process in processes:
            stack.callback(process.kill)
        yield [process.pid for process in processes]


def answers(client: Client) -> bool:
    """Ask the coordinator something small; raises UnreachableError when there is no answer within 5 s."""
    return client.status("job", limit_s=5.0).name == "a table"


def are_stopped(pids: list[int]) -> bool:
    return all(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T" for pid in pids)


def links(port: int) -> int:
    """Return how many connections of a local port are up on its side."""
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(row[1].endswith(f":{port:04X}") and row[3] == ESTABLISHED for row in rows)
