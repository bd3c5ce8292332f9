"""The web process with real programs: jobs over HTTP, streams that go on after deaths, TLS and users."""

import contextlib
import hashlib
import json
import math
import os
import signal
import socket
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from atoll.client.over_http import TOKEN as VARIABLE
from atoll_core.wire.messages.views import FINAL_STATES
from tests.certificates import HAS_OPENSSL, Lab
from tests.programs import done, serving, started, until

TOKEN = "a-token-that-tests-know"
CSV = b"t,x\n" + b"".join(b"%.17g,%.17g\n" % (0.1 * row, math.exp(-0.05 * row)) for row in range(120))


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


class Page:
    """What a browser, or a program, asks the web process."""

    def __init__(self, base: str, token: str | None = TOKEN, context: ssl.SSLContext | None = None) -> None:
        self.base = base
        self.context = context
        self.headers = {} if token is None else {"Authorization": f"Bearer {token}"}

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any]:
        request = urllib.request.Request(f"{self.base}/api/v1/{path}", body, {**self.headers, **headers}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=30.0, context=self.context) as answer:
                return answer.status, _content(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, _content(error.read())

    def is_up(self) -> bool:
        with contextlib.suppress(OSError):
            return self.ask("GET", "version")[0] == 200
        return False

    def state(self, job: str) -> str:
        return str(self.ask("GET", f"jobs/{job}")[1].get("state"))

    def submit(self, job: str, **options: str) -> None:
        query = f"filename=d.csv&id={job}&options={urllib.request.quote(json.dumps(options))}"  # type: ignore[attr-defined]
        status, answer = self.ask("POST", f"jobs?{query}", CSV)
        assert (status, answer.get("job")) == (201, job), answer


def _content(body: bytes) -> Any:
    with contextlib.suppress(ValueError):
        return json.loads(body)
    return body.decode("utf-8", "replace")


class Listening(threading.Thread):
    """Follows the events of a job as a page does: from where it was, again after each cut."""

    def __init__(self, page: Page, job: str) -> None:
        super().__init__(daemon=True)
        self.page, self.job = page, job
        self.numbers: list[int] = []
        self.kinds: list[str] = []
        self.cuts = 0
        self.is_over = threading.Event()
        self.start()

    def run(self) -> None:
        while not self.is_over.is_set():
            headers = {**self.page.headers, "Last-Event-ID": str(self.numbers[-1] if self.numbers else 0)}
            request = urllib.request.Request(f"{self.page.base}/api/v1/events?jobs={self.job}", headers=headers)
            with contextlib.suppress(OSError, ValueError), urllib.request.urlopen(request, timeout=15.0) as answer:
                for line in answer:
                    if line.startswith(b"data: ") and b'"number"' in line:
                        event = json.loads(line[6:])
                        self.numbers.append(event["number"])
                        self.kinds.append(event["event"])
                    if self.is_over.is_set():
                        return
            self.cuts += 1
            time.sleep(0.1)


@contextlib.contextmanager
def web(place: Path, address: str, port: int, *arguments: str, token: str = TOKEN) -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, token)
        with started(
            place, "coordinator", "web", "--connect", address, "--listen", f"127.0.0.1:{port}", *arguments
        ) as one:
            yield one


@pytest.fixture
def service(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    with serving(tmp_path, "state") as (address, _), started(tmp_path, "island_worker", "--connect", address):
        yield tmp_path, address


def test_a_job_by_http_ends_as_one_by_the_command_line_and_its_stream_survives_kills(service) -> None:
    place, address = service
    page = Page(f"http://127.0.0.1:{free_port()}")
    port = int(page.base.rpartition(":")[2])
    with web(place, address, port) as process:
        until(page.is_up)
        heard = Listening(page, "j1")
        page.submit("j1", seed="3")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    with web(place, address, port) as process:
        until(page.is_up)
        until(lambda: page.state("j1") in FINAL_STATES)
        until(lambda: "done" in heard.kinds)
        heard.is_over.set()
        _, logs = page.ask("GET", "jobs/j1/logs?limit=1000&after=1")
        numbers = [event["number"] for event in logs["events"]]
        assert [number for number in heard.numbers if number > 1] == numbers[: len(heard.numbers)]
        assert heard.cuts >= 1
        _, result = page.ask("GET", "jobs/j1/result")
        (place / "d.csv").write_bytes(CSV)
        assert (
            done(place, "coordinator", "run", "d.csv", "--seed", "3", "--out", "same", "--workers", "1").returncode == 0
        )
        alone = json.loads((place / "same" / "result.json").read_text())
        assert result["digest"] == alone["digest"]
        assert page.ask("GET", "jobs/j1/progress")[1]["equations"][0]["verdict"]
        assert (
            "dx" in page.ask("GET", "jobs/j1/exports/latex")[1] or "frac" in page.ask("GET", "jobs/j1/exports/latex")[1]
        )
        until(lambda: page.ask("GET", "jobs/j1/report")[0] == 200)
        assert page.ask("GET", "jobs/j1/report")[1].startswith("<!DOCTYPE html>")
        url = f"{page.base}/?token={TOKEN}"
        shown = done(place, "coordinator", "result", "j1", "--connect", url)
        assert (shown.returncode, shown.stdout.startswith("dx/dt = ")) == (0, True), shown.stderr
        again = done(place, "coordinator", "submit", "d.csv", "--seed", "3", "--id", "j2", "--json", "--connect", url)
        assert json.loads(again.stdout)["digest"] == alone["digest"], again.stderr
        refused = done(place, "coordinator", "ping", "--connect", f"{page.base}/?token=another")
        assert (refused.returncode, "token is unknown" in refused.stderr) == (2, True)
        assert page.ask("DELETE", "jobs/j1")[0] == 204
        assert page.ask("GET", "jobs/j1")[0] == 404
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) in (0, 143, -signal.SIGTERM)


def test_the_token_of_an_address_is_in_no_output(service, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in what commands print, nor in results, reports, exports, logs, tracebacks or the store."""
    place, address = service
    monkeypatch.setenv("XDG_STATE_HOME", str(place / "home"))  # of tracebacks
    (place / "d.csv").write_bytes(CSV)
    base = f"http://127.0.0.1:{free_port()}"
    there = ("--connect", f"{base}/?token={TOKEN}")
    said: list[tuple[tuple[str, ...], str]] = []

    def do(*words: str) -> int:
        ended = done(place, "coordinator", *words)
        said.append((words, ended.stdout + ended.stderr))
        return ended.returncode

    with web(place, address, int(base.rpartition(":")[2])):
        until(Page(base).is_up)
        assert do("submit", "d.csv", "--max-epochs", "2", "--id", "j", "--out", "o", *there) == 0
        for words in (
            ("status", "j"), ("status", "j", "--json"), ("jobs",), ("workers",), ("logs", "j"), ("doctor",), ("ping",),
            ("result", "j"), ("result", "j", "--json"), ("report", "j", "--output", "r.html"),
            ("export", "j", "--format", "python", "--output", "m.py"), ("export", "j", "--format", "latex"),
            ("share", "j"), ("delete", "j"), ("result", "j"),
        ):  # fmt: skip
            do(*words, *there)
    for words in (
        ("ping", *there), ("jobs", "--connect", f"{base}?x=1&token={TOKEN}"), ("jobs", "--connekt", there[1]),
        ("jobs", there[1]), ("jobs", "--connect", f"htp://lab?token={TOKEN}"), ("adapt", *there),
        ("serve", "--http", f"127.0.0.1:0?token={TOKEN}"), ("run", there[1]), ("submit", there[1], *there),
    ):  # fmt: skip
        assert do(*words) != 0
    shown = [words for words, text in said if TOKEN in text]
    files = [file for file in place.rglob("*") if file.is_file()]
    assert {"result.json", "r.html", "m.py", "coordinator.log", "atoll.sqlite3"} <= {file.name for file in files}
    assert (shown, [file for file in files if TOKEN.encode() in file.read_bytes()]) == ([], [])
    assert json.loads((place / "o" / "result.json").read_text())["command"].endswith(f"--connect {base}/")


def test_without_its_coordinator_the_page_stays_and_says_so(tmp_path: Path) -> None:
    page = Page(f"http://127.0.0.1:{free_port()}", token=None)
    with web(tmp_path, "tcp/127.0.0.1:9", int(page.base.rpartition(":")[2]), "--look-without-token"):
        until(page.is_up)
        status, answer = page.ask("GET", "jobs")
        assert status == 503
        assert "127.0.0.1:9" in answer["detail"]


def test_what_cannot_be_listened_at_is_refused_in_a_sentence(tmp_path: Path) -> None:
    refused = done(tmp_path, "coordinator", "web", "--connect", "tcp/127.0.0.1:9", "--listen", "0.0.0.0:7480")
    assert refused.returncode == 2
    assert "needs TLS" in refused.stderr
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        taken.listen()
        refused = done(tmp_path, "coordinator", "web", "--connect", "tcp/127.0.0.1:9", "--listen", f"127.0.0.1:{port}")
    assert refused.returncode == 1, "the address may be free later"
    assert "is not possible" in refused.stderr


@pytest.mark.skipif(not HAS_OPENSSL, reason="no openssl")
@pytest.mark.slow
def test_users_have_tokens_for_their_certificates_and_see_their_own_jobs(lab: Lab, tmp_path: Path) -> None:
    users = {"ann": "token-of-ann-0123456789", "bob": "token-of-bob-0123456789"}
    assert {*users} <= {*_names(lab)}, "the lab has these users"
    with started(
        tmp_path, "coordinator", "serve", "--listen", "tls/127.0.0.1:0", "--state", "state",
        *lab.options("coordinator"), "--roster", str(lab.folder / "roster.toml"),
    ) as coordinator:  # fmt: skip
        address = _address(coordinator)
        lines = "".join(_entry(lab, name, token) for name, token in users.items())
        (tmp_path / "users.toml").write_text(lines)
        (tmp_path / "users.toml").chmod(0o600)
        port, (authority, certificate, key) = free_port(), lab.files("coordinator")
        context = ssl.create_default_context(cafile=str(authority))
        context.check_hostname = False
        pages = {name: Page(f"https://127.0.0.1:{port}", token, context) for name, token in users.items()}
        nobody = Page(f"https://127.0.0.1:{port}", None, context)
        with web(tmp_path, address, port, *lab.options("eve"), "--users", "users.toml", "--cert", str(certificate),
                 "--key", str(key)):  # fmt: skip
            until(pages["ann"].is_up)
            pages["ann"].submit("mine")
            assert pages["ann"].state("mine") in ("queued", "preparing")
            assert pages["bob"].ask("GET", "jobs/mine")[0] == 404
            for method, path in _operations():
                status = pages["bob"].ask(method, path, BODIES.get(path.rpartition("/")[2]))[0]
                expected = {("DELETE", "jobs/mine"): 204, ("GET", "jobs/mine/exports"): 200}  # as of no job at all
                assert status == expected.get((method, path), 404), (method, path)
            assert pages["bob"].ask("DELETE", "jobs/none")[0] == 204
            assert pages["ann"].state("mine") in ("queued", "preparing")
            for method, path in (("PUT", "coordinator/queue"), ("PUT", "workers/lab1/service")):
                status = pages["bob"].ask(method, path, BODIES[path.rpartition("/")[2]])[0]
                assert status in (404, 409), path
            assert pages["bob"].ask("POST", "outline?of=mine", b"")[0] == 404
            assert pages["bob"].ask("GET", "jobs")[1]["jobs"] == []
            assert nobody.ask("GET", "jobs")[0] == 401
            assert pages["ann"].ask("GET", "session")[1]["user"] == "ann"
            assert pages["ann"].ask("POST", "jobs/mine/cancel")[1]["state"] == "cancelled"


BODIES = {
    "priority": b'{"priority": 1}', "sharing": b'{"shared": true}', "queue": b'{"paused": true}',
    "service": b'{"service": "cordoned"}',
}  # fmt: skip


def _operations() -> list[tuple[str, str]]:
    """Return all operations on a job of the description, on job "mine"."""
    from atoll.web.description import describe

    paths = {path: methods for path, methods in describe()["paths"].items() if "{job}" in path}
    return [
        (method.upper(), path[1:].replace("{job}", "mine").replace("{format}", "python"))
        for path, methods in paths.items()
        for method in methods
    ]


def _names(lab: Lab) -> Mapping[str, Any]:
    return {place.name: place for place in lab.folder.iterdir() if place.is_dir()}


def _address(process: Any) -> str:
    for line in process.stdout:
        if "island-worker --connect" in line:
            return f"tls/127.0.0.1:{line.split()[-1].rpartition(chr(58))[2]}"
    raise AssertionError("the coordinator never said how to start a worker")


def _entry(lab: Lab, name: str, token: str) -> str:
    authority, certificate, key = lab.files(name)
    digest = hashlib.sha256(token.encode()).hexdigest()
    return (
        f'[{name}]\ntoken_sha256 = "{digest}"\ntls_ca = "{authority}"\ntls_cert = "{certificate}"\ntls_key = "{key}"\n'
    )
