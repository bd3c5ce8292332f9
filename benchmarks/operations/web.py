"""What pages cost: the first view, many pages on one job, and requests that nobody should send.

A coordinator, a worker and ``coordinator web`` as real programs. Pages listen as browsers do, by one stream each and by
fetching progress as often as the page does.

    python -m benchmarks.operations.web                  # first view, 100 pages on one job
    python -m benchmarks.operations.web --islands 1024   # the same of a job with so many islands
    python -m benchmarks.operations.web --fuzz 1000000   # requests at random
    python -m benchmarks.operations.web --fuzz 1000000 --jobs 30000   # the same against so many stored jobs
"""

import asyncio
import gzip
import os
import random
import re
import statistics
import sys
import time
import urllib.request
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, get_args

from atoll.client.client import Client
from atoll.client.over_http import TOKEN
from atoll.terminal.output import note, say
from atoll_core.config import EvolutionConfig
from atoll_core.errors import AtollError
from atoll_core.wire.messages.views import FINAL_STATES, JobState
from benchmarks.harness.accounts import processor_seconds, status
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import COORDINATOR, Machines, running, wait_until
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.harness.tables import Columns
from benchmarks.operations.many_jobs import filled
from benchmarks.operations.scale import ENDLESS

JOB: Final = "watched"
WEB: Final = "web"
SECRET: Final = "a-token-for-a-benchmark"
READY_LIMIT_S: Final = 600.0

FIRST_VIEW: Final = 100_000
"""Bytes of the first view at most."""
A_MINUTE: Final = 200_000
"""Bytes a minute and page after it at most."""
GOALS: Final = (0.05, 0.30)
"""Cores that 100 pages may cost in the coordinator and in the web process."""

_ANSWER_LIMIT_S: Final = 2.0
"""How long an answer to what may be no whole request is waited for."""

_WHOLE: Final = 0.25
"""Share of the requests that ask for something of a stored job, or for a list of jobs, as a page does."""

_PACE: Final = 1_000.0
"""Bytes a second, at most, that a page fetches of progress."""


@dataclass(frozen=True)
class Watched:
    """What the processes took, in cores, and what each page got in a minute."""

    pages: int
    coordinator: float
    web: float
    resident: int
    bytes_a_minute: float
    events: float


@contextmanager
def served(islands: int, jobs: int = 0, **settings: Any) -> Iterator[tuple[Machines, int]]:
    """Run all programs, with a job without an end and `jobs` ended ones; yield the port of the web process.

    `settings` are those of `Machines`.
    """
    with TemporaryDirectory(prefix="atoll-benchmark-") as made:
        if jobs:
            note(f"filling a store with {jobs} jobs")
            filled(Path(made) / "state", jobs)
        with _served(islands, Path(made), **settings) as both:
            yield both


@contextmanager
def _served(islands: int, folder: Path, **settings: Any) -> Iterator[tuple[Machines, int]]:
    with running(1, folder, **settings) as (machines, client):
        port = _start_web(machines)
        config = configured(0, budget=ENDLESS)
        config = config.model_copy(update={"evolution": config.evolution.model_copy(update={"islands": islands})})
        client.submit(JOB, JOB, config, client.upload(table_of(trajectories("lotka_volterra")).to_bytes()))
        late = "the job was not under way"
        wait_until(client, lambda: any(one.epoch for one in client.status(JOB).variables), late, READY_LIMIT_S)
        yield machines, port


def first_view(port: int) -> tuple[int, float]:
    """Return bytes and milliseconds of the page with all that it names and asks first."""
    base, began, total = f"http://127.0.0.1:{port}/", time.perf_counter(), 0
    waiting, seen = ["", "api/v1/session", "api/v1/jobs?limit=50"], set[str]()
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        request = urllib.request.Request(base + path, headers={"Accept-Encoding": "gzip"})
        with urllib.request.urlopen(request) as answer:
            body = answer.read()
            total += len(body) + len(str(answer.headers))
            text = gzip.decompress(body) if answer.headers.get("content-encoding") == "gzip" else body
        if path == "" or path.endswith(".js"):
            waiting += _named(text.decode(), path)
    return total, 1000.0 * (time.perf_counter() - began)


def _named(text: str, path: str) -> list[str]:
    """Return the files that a page or a module loads at once; what a module imports later is left out."""
    if path == "":
        return [name for name in re.findall(r'(?:src|href)="(static/[^"]+)"', text) if name]
    return [f"static/{name}" for name in re.findall(r'^(?:import|export) [^"]*"\./([^"]+)"', text, re.MULTILINE)]


class Pages:
    """Pages that listen, each as one of a browser of its own."""

    def __init__(self, port: int, job: str = JOB) -> None:
        self._port, self._job = port, job
        self.bytes = self.events = 0

    async def watch(self, number: int, seconds: float) -> None:
        """Let so many pages listen for so long."""
        tasks = [asyncio.create_task(one) for _ in range(number) for one in (self._listen(), self._fetch())]
        await asyncio.sleep(seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _listen(self) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        try:
            writer.write(_request(f"/api/v1/events?jobs={self._job}"))
            while line := await reader.readline():
                self.bytes += len(line)
                self.events += line.startswith(b"event:")
        finally:
            writer.close()

    async def _fetch(self) -> None:
        tag = ""
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        while True:
            further = f"Accept-Encoding: gzip\r\nIf-None-Match: {tag}\r\n"
            writer.write(_request(f"/api/v1/jobs/{self._job}/progress", further))
            answer = await reader.readuntil(b"\r\n\r\n")
            length = re.search(rb"content-length: (\d+)", answer)
            answer += await reader.readexactly(int(length[1]) if length else 0)
            self.bytes += len(answer)
            found = re.search(rb"etag: (\S+)", answer)
            tag = found[1].decode() if found else tag
            await asyncio.sleep(max(2.0, len(answer) / _PACE))


def _request(path: str, further: str = "") -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{further}\r\n".encode()


def watched(machines: Machines, port: int, pages: int, seconds: float) -> Watched:
    """Return what so many pages take."""
    pids = machines.pid(COORDINATOR), machines.pid(WEB)
    watching = Pages(port)

    async def go() -> tuple[list[float], float]:
        task = asyncio.create_task(watching.watch(pages, seconds + 5.0))
        await asyncio.sleep(5.0)  # what comes first is not counted
        watching.bytes = watching.events = 0
        before, began = [processor_seconds(pid) for pid in pids], time.monotonic()
        await asyncio.sleep(seconds)
        taken = time.monotonic() - began
        cores = [(processor_seconds(pid) - first) / taken for pid, first in zip(pids, before, strict=True)]
        task.cancel()
        return cores, taken

    (coordinator, web), taken = asyncio.run(go())
    each = max(1, pages)
    return Watched(
        pages, coordinator, web, status(pids[1], "VmRSS"), watching.bytes / each * 60.0 / taken,
        watching.events / each / taken,
    )  # fmt: skip


_METHODS: Final = (b"GET", b"POST", b"PUT", b"DELETE", b"HEAD", b"PATCH", b"OPTIONS")
_PATHS: Final = (
    b"/", b"/api/v1/jobs", b"/api/v1/jobs/watched", b"/api/v1/jobs/none", b"/api/v1/workers", b"/api/v1/outline",
    b"/api/v1/messages", b"/api/v1/options", b"/static/main.js", b"/static/../app.py", b"/progress", b"/result",
    b"/logs", b"/exports/python", b"?limit=", b'&options={"seed":', b"%00", b"../", b"?after=-1", b"9" * 20,
    b"<script>", b"?of=watched", b"\xff",
)  # fmt: skip
_BODIES: Final = (b"{}", b"[[[[", b"null", b'"', b" ", b"\r\n", b"t,x\n1,2\n", b"\xff\x00")


_OF_A_JOB: Final = (
    "", "/result", "/progress", "/islands", "/islands?of=x", "/simulation", "/report", "/exports", "/exports/python",
    "/exports/sbml", "/logs", "/logs?limit=1000", "/logs?after=2",
)  # fmt: skip
_TO_A_JOB: Final = (
    ("POST", "/cancel"), ("POST", "/pause"), ("POST", "/resume"), ("PUT", "/priority"), ("PUT", "/sharing"),
    ("DELETE", ""),
)  # fmt: skip
_OF_THE_SERVICE: Final = ("health", "metrics", "workers", "coordinator", "logs", "session", "options", "openapi.json")


def _whole_request(draw: random.Random, jobs: int) -> tuple[bytes, bytes]:
    """Return method and path of a request as a page makes it; one in twenty changes or deletes a stored job."""
    job, kind = f"/api/v1/jobs/job-{draw.randrange(jobs):06d}", draw.random()
    if kind < 0.05:
        method, path = draw.choice(_TO_A_JOB)
        return method.encode(), (job + path).encode()
    if kind < 0.5:
        return b"GET", (job + draw.choice(_OF_A_JOB)).encode()
    if kind < 0.7:
        return b"GET", f"/api/v1/{draw.choice(_OF_THE_SERVICE)}".encode()
    state = draw.choice(("", *get_args(JobState), "none"))
    words = [f"limit={draw.choice((1, 20, 50, 100, 10**9))}", f"state={state}" if state else ""]
    words += [f"cursor={draw.randrange(2 * jobs)}", f"prefix=job-{draw.randrange(jobs):06d}"[: draw.randint(8, 17)]]
    return b"GET", f"/api/v1/jobs?{'&'.join(draw.sample(words, draw.randint(1, 4)))}".encode()


def _fuzzed(draw: random.Random, jobs: int) -> bytes:
    """Return one request, which may be none; a quarter of them are refused by their host or lack the token."""
    method = draw.choice(_METHODS)
    path = b"".join(draw.choices(_PATHS, k=draw.randint(1, 3)))
    path = path if path.startswith(b"/") else b"/api/v1/jobs" + path
    if jobs and draw.random() < _WHOLE:
        method, path = _whole_request(draw, jobs)
    body = draw.randbytes(draw.randint(0, 200)) if draw.random() < 0.3 else b"".join(draw.choices(_BODIES, k=3))
    host = b"127.0.0.1" if draw.random() < 0.9 else b"evil.example"
    token = SECRET.encode() if draw.random() < 0.85 else draw.randbytes(4).hex().encode()
    lines = [method + b" " + path + b" HTTP/1.1", b"Host: " + host, b"Authorization: Bearer " + token]
    if draw.random() < 0.1:
        lines.append(b"X-" + draw.randbytes(3).hex().encode() + b": " + draw.randbytes(6).hex().encode())
    lines.append(b"Content-Length: " + str(len(body)).encode())
    request = b"\r\n".join(lines) + b"\r\n\r\n" + body
    if draw.random() < 0.02:  # malformed
        place = draw.randrange(len(request))
        request = request[:place] + draw.randbytes(3) + request[place:]
    return request


async def _fuzz(port: int, number: int, seed: int, jobs: int) -> Counter[str]:
    """Send so many requests over connections that are kept; return how often each status was answered."""
    draw, counts = random.Random(seed), Counter[str]()
    reader = writer = None
    for _ in range(number):
        if writer is None:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
        assert reader is not None
        request = _fuzzed(draw, jobs)
        try:
            writer.write(request)
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _ANSWER_LIMIT_S)
            counts[head[9:12].decode()] += 1
            length = re.search(rb"content-length: (\d+)", head)
            is_head = request.startswith(b"HEAD ")
            if length is None and not is_head:
                raise ConnectionError  # a stream, or of unknown length: not to be waited for
            if length is not None and not is_head:
                await reader.readexactly(int(length[1]))
            if b"connection: close" in head:
                raise ConnectionError
        except (OSError, asyncio.IncompleteReadError, TimeoutError) as error:
            counts[type(error).__name__] += isinstance(error, TimeoutError)
            writer.close()
            writer = None
    if writer is not None:
        writer.close()
    return counts


def fuzz(machines: Machines, port: int, number: int, jobs: int) -> int:
    """Send requests at random; print what came back; return 1 where anything of ours broke."""
    began, lanes = time.monotonic(), 32
    before = {name: status(machines.pid(name), "VmRSS") for name in (WEB, COORDINATOR)}

    async def go() -> Counter[str]:
        parts = [_fuzz(port, number // lanes, seed, jobs) for seed in range(lanes)]
        return sum(await asyncio.gather(*parts), Counter())

    counts = asyncio.run(go())
    seconds = time.monotonic() - began
    say(
        f"{counts.total():,} answers to {number:,} requests in {seconds:.0f} s: "
        + ", ".join(f"{count:,} x {name}" for name, count in sorted(counts.items()) if count)
    )
    for name, first in before.items():
        after, most = (status(machines.pid(name), field) for field in ("VmRSS", "VmHWM"))
        say(f"memory of {name}: {first / 1e6:.0f} MB before, {after / 1e6:.0f} after, {most / 1e6:.0f} at most")
    return int(any(name.startswith("5") and name != "503" for name in counts))


def searches(pages: int, repeats: int) -> int:
    """Search the same job with and without pages that watch it, in turn; return 1 where results differ."""
    seconds: dict[int, list[float]] = {0: [], pages: []}
    digests: set[str] = set()
    with running(1) as (machines, client):
        port = _start_web(machines)
        table = client.upload(table_of(trajectories("lotka_volterra", noise=0.05)).to_bytes())
        for number in range(2 * repeats):
            shown, job = pages * (number % 2), f"{JOB}{number}"
            client.submit(job, job, configured(3), table)

            async def watch(shown: int = shown, job: str = job) -> None:
                await asyncio.gather(Pages(port, job).watch(shown, 600.0), _until_ended(client, job))

            with suppress(EndedError):
                asyncio.run(watch())
            seconds[shown].append(client.status(job).elapsed)
            digests.add(str(client.result(job)["digest"]))
    with_, without = (statistics.median(seconds[number]) for number in (pages, 0))
    say(f"median of {repeats}: {with_:.2f} s with {pages} pages, {without:.2f} s without; {len(digests)} digest(s)")
    return int(len(digests) > 1)


class EndedError(Exception):
    """Raised to end the watching of a job that has ended."""


async def _until_ended(client: Client, job: str) -> None:
    while client.status(job).state not in FINAL_STATES:
        await asyncio.sleep(0.2)
    raise EndedError


def _start_web(machines: Machines) -> int:
    """Start the web process; return its port once it answers."""
    port = _free_port()
    os.environ[TOKEN] = SECRET
    command = [sys.executable, "-m", "atoll", "web", "--connect", machines.address]
    machines.start_program(WEB, [*command, "--listen", f"127.0.0.1:{port}"])
    _wait_for(port)
    return port


def _free_port() -> int:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def _wait_for(port: int) -> None:
    end = time.monotonic() + READY_LIMIT_S
    while True:
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/version").close()
            return
        except OSError as error:
            if time.monotonic() > end:
                raise AtollError("the web process did not answer in time") from error
            time.sleep(0.2)


@program(
    "benchmarks.operations.web",
    __doc__,
    option("--pages", type=whole, default=100, help="how many pages watch the job (%(default)s)"),
    option("--seconds", type=positive, default=30.0, help="length of each of two measurements (%(default)g)"),
    option("--islands", type=whole, default=EvolutionConfig().islands, help="of the job, each equation (%(default)s)"),
    option("--fuzz", type=whole, default=0, help="send so many requests at random instead"),
    option("--jobs", type=whole, default=0, help="ended jobs that the store holds before (%(default)s)"),
    option("--searches", type=whole, default=0, help="search so many times with the pages and without instead"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 where a goal is missed, else 0."""
    if options.searches:
        return searches(options.pages, options.searches)
    record = Record("web", options.words, options.out)
    with served(options.islands, options.jobs) as (machines, port):
        if options.fuzz:
            return fuzz(machines, port, options.fuzz, options.jobs)
        views = [first_view(port) for _ in range(5)]
        size, took = views[0][0], sorted(view[1] for view in views)[2]
        note("the first view is measured")
        none = watched(machines, port, 0, options.seconds)
        all_ = watched(machines, port, options.pages, options.seconds)
    say(f"first view: {size:,} bytes, {took:.0f} ms in the median of 5 (goal {FIRST_VIEW:,} and 300)")
    say(
        Columns(
            "pages={pages} | coordinator, cores={coordinator:.3f} | web, cores={web:.3f} | MB={resident:B.0f} | "
            "bytes a minute each={bytes_a_minute:.0f} | events/s each={events:.2f}"
        ).table([none, replace(all_)])
    )
    cost = all_.coordinator - none.coordinator, all_.web - none.web
    say(f"\n{options.pages} pages cost {cost[0]:.3f} and {cost[1]:.3f} of a core (goals {GOALS}); load {load():.1f}")
    record.write(first_view=[size, took], watched=[asdict(none), asdict(all_)], cost=cost)
    missed = size > FIRST_VIEW or all_.bytes_a_minute > A_MINUTE or cost[0] > GOALS[0] or cost[1] > GOALS[1]
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
