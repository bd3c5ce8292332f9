"""What `start_on` refuses before anything is sent to a cluster."""

import builtins
import sys
import threading
from collections.abc import Mapping, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from atoll.workers import start_on
from atoll.workers.start import Handle, MachineWorkers, ProgramOptions, WorkerProgram, _options, limited
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_island_worker.cli import _parse
from tests.programs import until

ADDRESS = "tcp/127.0.0.1:7447"
RAY = ModuleType("ray")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"connect": None}, "connect must be an address such as 'tcp/HOST:7447', but None was given"),
        ({"connect": "tcp://host:7447"}, "address 'tcp://host:7447' was found where tcp/HOST:PORT was expected"),
        ({"workers": 0}, "workers must be a whole number from 1 to 1024, but 0 was given"),
        ({"workers": True}, "workers must be a whole number from 1 to 1024, but True was given"),
        ({"workers": "2"}, "workers must be a whole number from 1 to 1024, but '2' was given"),
        ({"wait": -1}, "wait must be a number of seconds, at least 0, but -1 was given"),
        ({"grace": float("nan")}, "grace must be a number of seconds, at least 0, but nan was given"),
        ({"grace": "30s"}, "grace must be a number of seconds, at least 0, but '30s' was given"),
        ({"tls": {"ca": "a.pem"}}, "tls must have the files ca, cert, key by these names, but"),
        ({"tls": {"ca": "a", "cert": "b", "key": "c"}}, "tcp/127.0.0.1:7447 is not encrypted, but tls was given"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError) as raised:
        start_on(RAY, **{"connect": ADDRESS, **options})
    assert str(raised.value).startswith(sentence)


@pytest.mark.parametrize("client", [None, 3, SimpleNamespace(run=print), ModuleType("dask"), object])
def test_what_is_no_cluster_is_refused(client: object) -> None:
    with pytest.raises(UsageError, match=r"a distributed\.Client, the module ray, or the address of a cluster was exp"):
        start_on(client, connect=ADDRESS)


@pytest.mark.parametrize(
    ("client", "package", "extra"),
    [("tcp://scheduler:8786", "distributed", "dask"), ("auto", "ray", "ray"), ("ray://head:10001", "ray", "ray")],
)
def test_a_package_that_is_missing_is_named(
    client: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(name: str, *_: object) -> ModuleType:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr("importlib.import_module", find)
    with pytest.raises(UsageError) as raised:
        start_on(client, connect=ADDRESS)
    assert str(raised.value) == (
        f"{package} is not installed, but workers on such a cluster need it; run: pip install 'atoll[{extra}]'"
    )


def test_neither_dask_nor_ray_is_needed_to_import_it() -> None:
    import subprocess
    import sys

    script = (
        "import sys; sys.modules.update(dict.fromkeys(('distributed', 'dask', 'ray')));"
        "import atoll.workers; print(atoll.workers.start_on.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "start_on\n", done.stderr


def test_what_a_program_is_told_is_plain() -> None:
    files = {"ca": "a.pem", "cert": "c.pem", "key": "k.pem"}
    options = _options("tls/lab:7447", files, 5, 2.5)
    assert (options.connect, options.wait_s, options.grace_s, options.tls) == ("tls/lab:7447", 5.0, 2.5, files)
    kinds = {type(value) for value in (options.connect, options.wait_s, options.grace_s, *options.tls.values())}
    assert kinds <= {getattr(builtins, name) for name in ("str", "float")}


OPTIONS = ProgramOptions("tls/lab:7447", 7.0, 3.0, {"ca": "a.pem", "cert": "c.pem", "key": "k.pem"})


class Machines(Handle):
    def __init__(self, **machines: MachineWorkers) -> None:
        self.found = machines
        self.is_closed = False

    def machines(self) -> Mapping[str, MachineWorkers]:
        return self.found

    def close(self) -> None:
        self.is_closed = True


def test_the_command_is_one_that_the_program_understands(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[Sequence[str]] = []
    monkeypatch.setattr("subprocess.Popen", lambda command, **_: commands.append(command))
    WorkerProgram(OPTIONS, 4)
    (command,) = commands
    assert list(command[:3]) == [sys.executable, "-m", "atoll_island_worker"]
    read = _parse(command[3:])
    assert (read.connect, read.processes, read.wait, read.grace) == ("tls/lab:7447", 4, 7.0, 3.0)
    assert (read.tls_ca, read.tls_cert, read.tls_key) == ("a.pem", "c.pem", "k.pem")
    assert read.supervise
    assert read.parent
    assert read.name is None


def test_the_end_of_a_program_is_seen() -> None:
    made = WorkerProgram(ProgramOptions("tcp/127.0.0.1:9", 0.0, 0.0), 1)
    until(lambda: made.exit_code() is not None)
    assert made.exit_code() == 3
    made.drain()


def test_a_handle_says_which_machine_has_lost_its_workers_and_why() -> None:
    Machines(first=MachineWorkers(2, None)).check()
    with pytest.raises(AtollError) as raised:
        Machines(first=MachineWorkers(2, None), second=MachineWorkers(1, 2)).check()
    assert str(raised.value) == (
        "the island workers of second have ended with exit code 2 (bad options, or refused by the coordinator); see "
        "the log of the process of that machine in the cluster"
    )


def test_the_end_of_a_block_ends_the_workers() -> None:
    with Machines() as handle:
        assert not handle.is_closed
    assert handle.is_closed


def test_what_a_call_returns_or_raises_comes_through() -> None:
    assert limited(lambda: 3, 60.0, "it has not answered") == 3
    assert limited(lambda: None, 60.0, "it has not answered") is None
    with pytest.raises(ZeroDivisionError):
        limited(lambda: 1 // 0, 60.0, "it has not answered")


def test_a_call_that_takes_longer_is_left() -> None:
    end = threading.Event()
    with pytest.raises(UnreachableError, match=r"it has not answered within 0.01 s; one of its machines may hang"):
        limited(end.wait, 0.01, "it has not answered")
    end.set()
