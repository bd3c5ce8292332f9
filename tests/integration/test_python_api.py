"""The Python API finds what the command line finds, in a script without a guard, and leaves nothing behind."""

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import atoll
from tests.certificates import Lab
from tests.programs import done, started, until

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "examples" / "lotka_volterra.csv"
SCRIPT = """
import json, os, signal, sys, threading
from pathlib import Path
import atoll
from atoll.api import discover as session

def workers(host):
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().split(b"\\0")
            parent = (process / "stat").read_text().rpartition(")")[2]
        except OSError:
            continue
        if b"--supervise" in words and str(host).encode() in words and int(parent.split()[1]) != host:
            yield int(process.name)

models = [atoll.discover(sys.argv[1], workers=2)]
host = session._services[2]._process.pid
killed = [*workers(host)] if sys.argv[2] == "alone" else []
for pid in killed:
    os.kill(pid, signal.SIGKILL)
if killed:
    models.append(atoll.discover(sys.argv[1], workers=2))
print(json.dumps({
    "digests": [model.provenance["digest"] for model in models],
    "equations": [str(equation) for equation in models[0].equations],
    "threads": threading.active_count(),
    "host": host,
    "endpoint": session._services[2].endpoint,
    "mode": Path(session._services[2].endpoint.partition("/")[2]).parent.stat().st_mode & 0o777,
    "killed": len(killed),
    "is_same": session._services[2]._process.pid == host,
}))
sys.stdout.flush()
if sys.argv[2] == "killed":
    os.kill(os.getpid(), 9)
"""


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "TMPDIR": str(folder)}
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False)


def all_gone(host: int) -> bool:
    """Wait, within limits, until neither the host nor what names it as its parent is left; they end by themselves."""
    return until(lambda: not any(_belongs(process, host) for process in Path("/proc").glob("[0-9]*")))


def _belongs(process: Path, host: int) -> bool:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    number = str(host).encode()
    return process.name == str(host) or any(pair == (b"--parent", number) for pair in pairwise(words))


@pytest.fixture(scope="module")
def digest_of_run(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What ``coordinator run`` finds."""
    place = tmp_path_factory.mktemp("run")
    command = [sys.executable, "-m", "atoll", "run", str(DATA), "--workers", "2", "--out", "r"]
    assert run(command, place).returncode == 0
    return str(json.loads((place / "r" / "result.json").read_text())["digest"])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes are listed as on Linux")
def test_two_calls_give_the_digest_of_the_command_line_and_leave_nothing(tmp_path: Path, digest_of_run: str) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    before = sorted(tmp_path.iterdir())
    for ending, code in (("alone", 0), ("killed", -9)):
        done = run([sys.executable, "script.py", str(DATA), ending], tmp_path)
        assert done.returncode == code, done.stderr
        written = json.loads(done.stdout)
        calls = 2 if ending == "alone" else 1
        assert written["digests"] == [digest_of_run] * calls
        assert written["equations"] == ["dx/dt = x*(3 - x - 2*y)", "dy/dt = y*(2 - x - y)"]
        assert written["threads"] == 1
        assert written["endpoint"].startswith("unixsock-stream/")  # in a folder that no other user can enter
        assert written["mode"] == 0o700
        # Workers that die are replaced, and whatever runs their tasks: their server and its processes at least.
        assert written["killed"] >= 3 if ending == "alone" else written["killed"] == 0
        assert written["is_same"]
        assert all_gone(written["host"])
        assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_a_service_with_certificates_gives_the_same_digest_to_python_and_to_submit(
    tmp_path: Path, lab: Lab, digest_of_run: str
) -> None:
    words = ("serve", "--listen", "tls/127.0.0.1:0", "--state", "s", *lab.options("coordinator"))
    with started(tmp_path, "coordinator", *words) as serve:
        assert serve.stdout is not None
        line = next(line for line in serve.stdout if "island-worker --connect" in line)
        address = f"tls/localhost:{line.split('--connect ')[1].split()[0].rpartition(':')[2]}"
        with started(tmp_path, "island_worker", "--connect", address, "--processes", "1", *lab.options("lab1")):
            ann = ("--connect", address, *lab.options("ann"))
            assert done(tmp_path, "coordinator", "submit", str(DATA), "--out", "r", *ann).returncode == 0
            files = dict(zip(("ca", "cert", "key"), lab.files("ann"), strict=True))
            model = atoll.discover(DATA, connect=address, tls=files, progress=False)
    submitted = json.loads((tmp_path / "r" / "result.json").read_text())["digest"]
    assert (model.provenance["digest"], submitted) == (digest_of_run, digest_of_run)


@pytest.mark.slow
def test_the_local_service_ends_without_a_word_when_its_parent_is_another(tmp_path: Path) -> None:
    command = [sys.executable, "-P", "-m", "atoll.api.host", "1", "1"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path) as host:
        assert host.stderr is not None
        assert host.stderr.read() == b""
        assert host.wait(60.0) == 0
