"""The resources of the API: what is asked, and how it is answered. See ``openapi.json``."""

import asyncio
import contextlib
import gzip
import hashlib
import json
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, cast, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import to_jsonable_python
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route

from atoll.client.client import Client
from atoll.client.over_http import MESSAGE
from atoll.export.formats import LANGUAGES, OF_RESULTS, written
from atoll.model.model import Model
from atoll.tasks.analyses import FUNCTIONS, Report, answered
from atoll.text.render import parse_picks, pick
from atoll.web.access import gateway_of
from atoll.web.connections import most_connections
from atoll.web.feed import MAX_LISTENERS, Feed
from atoll.web.gateway import BusyError, Gateway
from atoll.web.options import options_by_heading, read_options, sizes_by_name
from atoll.web.progress import progress
from atoll.web.reading import MAX_BODY, TABLE, Readers, split_files
from atoll.web.simulation import simulation_of
from atoll.web.temporary import PREFIX, held
from atoll_coordinator.result.result import Result
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, RemoteProtocolError, UnknownJobError, UnreachableError
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import ClientRequest as Question
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello
from atoll_core.wire.messages.limits import MAX_MESSAGE, MAX_PAGE_JOBS, Priority
from atoll_core.wire.messages.views import JobState, JobView, WorkerService
from atoll_core.wire.topics import is_id
from atoll_core.wire.values import encode_value

BODY_LIMIT_S: Final = 300.0
"""How long a body may take to come."""

PATIENCE_S: Final = 20.0
SLOWEST: Final = 32_000
"""A body that has come more slowly than so many bytes a second (a poor mobile network) for so long is cut off."""

MAX_COMING: Final = 8
"""Files that one user sends at a time, of which each takes room on the disk: a few pages and a program."""

MAX_OF_USER: Final = 64 * 1024**2
"""Bytes of messages of one user that are in memory, from the first that comes until the answer: four of the largest."""

MAX_OF_ALL: Final = 128 * 1024**2
"""Bytes of messages of all users."""

RESULT_S: Final = 1.0
"""For how long at least a result is given again without asking for it: any number of pages cost one question."""

SHARE: Final = 0.05
"""Of the time is spent on asking for one result, which takes long where a job has many islands."""

MAX_RESULTS: Final = 16
"""Results that are kept for that."""

MAX_WATCHED: Final = 32
"""Jobs that one stream tells about by name."""

Handler = Callable[[Request], Awaitable[Response]]


class NewPriority(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    priority: Priority


class NewSharing(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    shared: bool


class NewService(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    service: WorkerService


class NewQueue(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    paused: bool


BODIES: Final[Mapping[str, type[BaseModel]]] = {
    "set_priority": NewPriority, "set_sharing": NewSharing, "set_service": NewService, "set_queue": NewQueue,
}  # fmt: skip
"""Bodies that are JSON, by handler."""


@dataclass(frozen=True)
class _Shown:
    """The progress of a job, made once for all pages: compressed JSON, and its tag."""

    packed: bytes
    tag: str

    @classmethod
    def of(cls, result: Result) -> "_Shown":
        body = json.dumps(progress(result), allow_nan=False).encode()
        return cls(gzip.compress(body, 5), f'"{hashlib.sha256(body).hexdigest()[:32]}"')


@dataclass(frozen=True)
class _Fetched:
    """A result that was asked for, at that time (monotonic seconds)."""

    task: "asyncio.Task[tuple[Result, float]]"
    began: float = field(default_factory=time.monotonic)

    def is_over(self, *, may_be_late: bool) -> bool:
        if not self.task.done():
            return False
        if self.task.cancelled() or self.task.exception() is not None:
            return True
        took = self.task.result()[1]
        return time.monotonic() > self.began + took + max(RESULT_S, took / SHARE if may_be_late else 0.0)


async def _fetch(gateway: Gateway, job: str) -> tuple[Result, float]:
    """Return the result of a job, and how many seconds that took."""
    began = time.monotonic()
    result = await gateway.ask(lambda client: Result.of(client.result(job)))
    return result, time.monotonic() - began


class Api:
    """All resources. Feeds are one for each gateway, made when somebody listens."""

    def __init__(self, readers: Readers) -> None:
        self._readers = readers
        self._coming: Counter[object] = Counter()
        self._messages: Counter[object] = Counter()
        self._feeds: dict[object, Feed] = {}
        self._results: dict[tuple[object, str], _Fetched] = {}
        self._shown: dict[tuple[object, str], tuple[Result, asyncio.Task[_Shown]]] = {}

    def routes(self) -> list[BaseRoute]:
        """Return the routes below ``/api/v1``."""
        table: list[tuple[str, str, Handler]] = [
            ("GET", "/version", self.version),
            ("GET", "/session", self.session),
            ("GET", "/health", self.health),
            ("GET", "/metrics", self.metrics),
            ("GET", "/openapi.json", self.openapi),
            ("GET", "/options", self.options),
            ("GET", "/demo", self.demo),
            ("GET", "/events", self.events),
            ("POST", "/messages", self.messages),
            ("GET", "/jobs", self.jobs),
            ("POST", "/jobs", self.submit),
            ("POST", "/outline", self.outline),
            ("POST", "/preview", self.preview),
            ("GET", "/jobs/{job}", self.job),
            ("DELETE", "/jobs/{job}", self.delete),
            ("GET", "/jobs/{job}/result", self.result),
            ("GET", "/jobs/{job}/progress", self.progress),
            ("GET", "/jobs/{job}/islands", self.islands),
            ("GET", "/jobs/{job}/simulation", self.simulation),
            ("GET", "/jobs/{job}/report", self.report),
            ("GET", "/jobs/{job}/exports", self.exports),
            ("GET", "/jobs/{job}/exports/{format}", self.export),
            ("GET", "/jobs/{job}/logs", self.logs),
            ("POST", "/jobs/{job}/cancel", self.cancel),
            ("POST", "/jobs/{job}/pause", self.pause),
            ("POST", "/jobs/{job}/resume", self.resume),
            ("POST", "/jobs/{job}/retry", self.retry),
            ("PUT", "/jobs/{job}/priority", self.set_priority),
            ("PUT", "/jobs/{job}/sharing", self.set_sharing),
            ("GET", "/logs", self.all_logs),
            ("GET", "/workers", self.workers),
            ("PUT", "/workers/{worker}/service", self.set_service),
            ("GET", "/coordinator", self.coordinator),
            ("PUT", "/coordinator/queue", self.set_queue),
        ]
        return [Route(path, handler, methods=[method]) for method, path, handler in table]

    async def close(self) -> None:
        """End all streams, and what reads files."""
        self._readers.close()
        for feed in self._feeds.values():
            feed.stop()

    # ------------------------------------------------------------------------------------------ the process

    async def version(self, request: Request) -> Response:
        """Say which version answers."""
        return JSONResponse({"version": VERSION, "protocol": PROTOCOL_VERSION, "engine": ENGINE_REVISION, "api": "v1"})

    async def session(self, request: Request) -> Response:
        """Say as whom one asks, whether one may change anything, and where workers connect."""
        at = gateway_of(request).destination if request.scope["gateway"] is not None else None
        user = at.credentials.name if at is not None and at.credentials is not None else None
        known = {"user": user, "may_write": request.scope["may_write"], "version": VERSION}
        return JSONResponse({**known, "connect": str(at) if at is not None else None})

    async def health(self, request: Request) -> Response:
        """Say whether the coordinator answers, as probes ask."""
        if request.scope["gateway"] is None:
            return JSONResponse({"status": "ok", "coordinator": None})
        try:
            await gateway_of(request).ask(lambda client: client.queue_depth())
        except UnreachableError as error:
            return JSONResponse({"status": "unreachable", "coordinator": str(error)}, 503)
        return JSONResponse({"status": "ok", "coordinator": "answers"})

    async def metrics(self, request: Request) -> Response:
        """Give the depth of the queue and what this process does, as Prometheus reads it."""
        depth = await gateway_of(request).ask(lambda client: client.queue_depth())
        jobs = {name: value for name, value in to_jsonable_python(depth).items() if isinstance(value, int)}
        lines = ["# TYPE atoll_queue gauge", *(f'atoll_queue{{of="{name}"}} {value}' for name, value in jobs.items())]
        listeners = sum(feed.listeners for feed in self._feeds.values())
        lines += ["# TYPE atoll_web_listeners gauge", f"atoll_web_listeners {listeners}"]
        return PlainTextResponse("\n".join(lines) + "\n")

    async def openapi(self, request: Request) -> Response:
        """Give the description of this API."""
        return Response(_resource("openapi.json"), media_type="application/json")

    async def options(self, request: Request) -> Response:
        """Give the options of a job with their help."""
        return JSONResponse(options_by_heading())

    async def demo(self, request: Request) -> Response:
        """Give a small data set to try."""
        return JSONResponse({"filename": "predator_prey.csv", "text": _resource("static/predator_prey.csv")})

    # ------------------------------------------------------------------------------------------------- jobs

    async def jobs(self, request: Request) -> Response:
        """List a page of jobs, the newest first."""
        limit, cursor = _whole(request, "limit", 50, 1, MAX_PAGE_JOBS), _whole(request, "cursor", None, 0)
        prefix, state = request.query_params.get("prefix", ""), request.query_params.get("state")
        if prefix and not is_id(prefix):
            return JSONResponse({"jobs": [], "next": None})
        if state is not None and state not in get_args(JobState):
            raise HTTPException(422, f"no state of a job is called that; there are {', '.join(get_args(JobState))}")
        page = await gateway_of(request).ask(
            lambda client: client.page_of_jobs(prefix, state=cast("JobState | None", state), limit=limit, before=cursor)
        )
        return JSONResponse({"jobs": to_jsonable_python(page.jobs[::-1]), "next": page.before})

    async def job(self, request: Request) -> Response:
        """Say how a job is getting on."""
        return await self._view(request, lambda client, job: client.status(job))

    async def cancel(self, request: Request) -> Response:
        """End a job, which keeps its best equations."""
        return await self._view(request, lambda client, job: client.cancel(job))

    async def pause(self, request: Request) -> Response:
        """Have a job stop at a checkpoint and wait."""
        return await self._view(request, lambda client, job: client.pause_job(job))

    async def resume(self, request: Request) -> Response:
        """Let a paused job go on."""
        return await self._view(request, lambda client, job: client.pause_job(job, paused=False))

    async def retry(self, request: Request) -> Response:
        """Submit what failed or was cancelled once more, under another id."""
        again = request.query_params.get("id") or uuid.uuid4().hex[:12]
        if not is_id(again):
            raise HTTPException(422, "an id has 1 to 64 letters, digits, _ or -")
        response = await self._view(request, lambda client, job: client.retry(job, again), 201)
        response.headers["location"] = f"../{again}"
        return response

    async def set_priority(self, request: Request) -> Response:
        """Give a job another priority."""
        body = await _read(request, NewPriority)
        return await self._view(request, lambda client, job: client.set_priority(job, body.priority))

    async def set_sharing(self, request: Request) -> Response:
        """Let everybody see a job, or only its submitter and admins."""
        body = await _read(request, NewSharing)
        return await self._view(request, lambda client, job: client.share(job, shared=body.shared))

    async def delete(self, request: Request) -> Response:
        """Delete a job that has ended."""
        job = _job(request)
        await gateway_of(request).ask(lambda client: client.delete(job))
        return Response(status_code=204)

    async def _view(
        self, request: Request, question: Callable[[Client, str], JobView], status: int = 200
    ) -> JSONResponse:
        job = _job(request)
        view = await gateway_of(request).ask(lambda client: question(client, job))
        return JSONResponse(to_jsonable_python(view), status)

    async def logs(self, request: Request) -> Response:
        """Give the events of a job after a number, or the last ones."""
        return await self._events(request, _job(request))

    async def all_logs(self, request: Request) -> Response:
        """Give the events of workers and of all jobs that may be seen, after a number, or the last ones."""
        return await self._events(request, None)

    async def _events(self, request: Request, job: str | None) -> Response:
        after = _whole(request, "after", 0, 0) or 0
        limit, of_workers = _whole(request, "limit", 200, 1, 1000) or 200, _flag(request, "of_workers")
        events = await gateway_of(request).ask(
            lambda client: client.events(job, after, limit, of_workers=of_workers)
        )  # fmt: skip
        return JSONResponse({"events": to_jsonable_python(events)})

    async def events(self, request: Request) -> Response:
        """Tell what happens, as server-sent events."""
        jobs = request.query_params.getlist("jobs") or ["all"]
        if len(jobs) > MAX_WATCHED or any(not is_id(job) for job in jobs):
            raise HTTPException(422, f"jobs names all, or up to {MAX_WATCHED} jobs by their ids")
        last = request.headers.get("last-event-id") or request.query_params.get("after")
        if last is not None and not (last.isdecimal() and int(last) < 2**63):
            raise HTTPException(422, "Last-Event-ID is the number of an event")
        if request.method == "HEAD":  # which would listen for ever and hear nothing
            return Response(media_type="text/event-stream")
        gateway = gateway_of(request)
        feed = self._feeds.get(gateway)
        if feed is None:
            feed = self._feeds[gateway] = Feed(gateway, lambda job: self._results.pop((gateway, job), None))
        left = min(MAX_LISTENERS, most_connections() // 2) - sum(feed.listeners for feed in self._feeds.values())
        if feed.listeners >= left:  # one user leaves others as many as he has
            raise HTTPException(429, "too many pages listen already; ask for the status now and then instead")
        told = feed.listen(None if "all" in jobs else jobs, int(last) if last is not None else None)
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(_until_broken(told), media_type="text/event-stream", headers=headers)

    async def messages(self, request: Request) -> Response:
        """Answer a message of a client, as on the bus: programs of this version that a firewall keeps from it."""
        gateway = gateway_of(request)
        body = bytearray()

        def take(chunk: bytes) -> None:
            held = self._messages
            if held[gateway] + len(chunk) > MAX_OF_USER or held.total() + len(chunk) > MAX_OF_ALL:
                raise HTTPException(429, "too many messages are being sent already; send this one later", _SOON)
            held[gateway] += len(chunk)
            body.extend(chunk)

        try:
            await _receive(request, MAX_MESSAGE, take)
            return await self._exchange(gateway, bytes(body))
        finally:
            self._messages[gateway] -= len(body)

    @staticmethod
    async def _exchange(gateway: Gateway, body: bytes) -> Response:
        try:
            hello = decode(body, Greeting)
        except RemoteProtocolError:
            try:
                question = decode(body, Question)
            except RemoteProtocolError as error:
                raise HTTPException(422, f"this is no message of protocol {PROTOCOL_VERSION}: {error}") from error
            answer = await gateway.ask(lambda client: client.exchange(question))
        else:
            require_same_version(hello.body)
            welcome = await gateway.ask(lambda client: client.welcome)
            answer = encode(GreetingAnswer(body=welcome))
        if answer is None:
            raise HTTPException(503, "the coordinator did not answer in time")
        return Response(answer, media_type=MESSAGE)

    # ---------------------------------------------------------------------------------------------- results

    async def result(self, request: Request) -> Response:
        """Give result.json; while the job runs, the best so far."""
        return _download(request, (await self._result(request)).to_json(), "result.json", "application/json")

    async def progress(self, request: Request) -> Response:
        """Give what pages draw of the best so far; 304 where that has not changed."""
        key, result = (gateway_of(request), _job(request)), await self._result(request, may_be_late=True)
        known = self._shown.get(key)
        if known is None or known[0] is not result:
            known = self._shown[key] = (result, asyncio.ensure_future(run_in_threadpool(_Shown.of, result)))
            for old in [*self._shown][:-MAX_RESULTS]:
                del self._shown[old]
        shown = await asyncio.shield(known[1])
        headers = {"etag": shown.tag, "cache-control": "no-cache", "vary": "accept-encoding"}
        if request.headers.get("if-none-match") == shown.tag:
            return Response(status_code=304, headers=headers)
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(gzip.decompress(shown.packed), media_type="application/json", headers=headers)
        headers["content-encoding"] = "gzip"
        return Response(shown.packed, media_type="application/json", headers=headers)

    async def islands(self, request: Request) -> Response:
        """Say on which worker each island is, and how far."""
        job = _job(request)
        islands = await gateway_of(request).ask(lambda client: client.islands(job))
        return JSONResponse({"islands": to_jsonable_python(islands)})

    async def simulation(self, request: Request) -> Response:
        """Simulate the model from its first measured state, and along each measured trajectory, for pictures."""
        return JSONResponse(await run_in_threadpool(simulation_of, await self._chosen(request)))

    async def report(self, request: Request) -> Response:
        """Give the report as HTML; 202 while a worker makes it."""
        job = _job(request)
        waits_for, made = await gateway_of(request).ask(lambda client: client.analysis(job, *_REPORT))
        if made is None:
            return JSONResponse({"waits_for": waits_for or "is made by a worker"}, 202, {"retry-after": "1"})
        page = (await run_in_threadpool(answered, made)).text
        policy = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
        return Response(page, media_type="text/html", headers={"content-security-policy": policy})

    async def exports(self, request: Request) -> Response:
        """List the formats of exports."""
        return JSONResponse({"formats": [*LANGUAGES, *OF_RESULTS]})

    async def export(self, request: Request) -> Response:
        """Write the model in a format."""
        name, result = request.path_params["format"], await self._chosen(request)
        if name not in (*LANGUAGES, *OF_RESULTS):
            raise HTTPException(404, f"there is no format {name[:64]!r} of an export")
        text = await run_in_threadpool(_export, result, name)
        return _download(request, text, f"{_job(request)}.{name}.txt", "text/plain")

    async def _chosen(self, request: Request) -> Result:
        """Return the result of a job, with other members of the fronts where these are picked; raises UsageError."""
        picks, result = parse_picks(request.query_params.getlist("pick")), await self._result(request)
        return pick(result, picks) if picks else result

    async def _result(self, request: Request, *, may_be_late: bool = False) -> Result:
        """Return the result of a job, asked for once a second however many want it; it may be late by more for pages.

        These hear when the state of a job changes, and then get it anew. Whether a job may be seen is always asked.
        """
        job, gateway = _job(request), gateway_of(request)
        key = (gateway, job)
        known = self._results.get(key)
        if known is None or known.is_over(may_be_late=may_be_late):
            known = self._results[key] = _Fetched(asyncio.ensure_future(_fetch(gateway, job)))
            for old in [*self._results][:-MAX_RESULTS]:
                del self._results[old]
            return (await asyncio.shield(known.task))[0]
        result = (await asyncio.shield(known.task))[0]
        try:
            await gateway.ask(lambda client: client.status(job))
        except UnknownJobError:  # it was deleted, or is shared no more
            self._results.pop(key, None)
            self._shown.pop(key, None)
            raise
        return result

    # ------------------------------------------------------------------------------------------ submissions

    async def outline(self, request: Request) -> Response:
        """Say how a file is read and what would be searched."""
        async with self._made(request, "outline") as answer:
            return Response(answer.read_bytes(), media_type="application/json")

    async def preview(self, request: Request) -> Response:
        """Smooth and differentiate a file, for a look before anything is searched."""
        async with self._made(request, "preview") as answer:
            return Response(answer.read_bytes(), media_type="application/json")

    async def submit(self, request: Request) -> Response:
        """Submit a file as a job. The same id with the same contents is the same job."""
        asked = request.query_params
        job, name = asked.get("id") or uuid.uuid4().hex[:12], asked.get("name", "")
        if not is_id(job):
            raise HTTPException(422, "an id has 1 to 64 letters, digits, _ or -")
        priority, shared = _whole(request, "priority", 0, -10, 10) or 0, _flag(request, "shared")
        config = read_options(asked.get("options", ""))[1]
        async with self._made(request, "table") as answer:
            name = name or answer.with_name("name").read_text("utf-8")
            view = await gateway_of(request).ask(
                lambda client: client.hand_in(job, name, config, answer.read_bytes(), priority, shared=shared)
            )
        return JSONResponse(to_jsonable_python(view), 201, {"location": f"jobs/{job}"})

    @contextlib.asynccontextmanager
    async def _made(self, request: Request, made: str) -> AsyncIterator[Path]:
        """Yield the file that has what is made of the files and the options that were sent: see `Readers.read`."""
        asked, gateway = request.query_params, gateway_of(request)
        sizes = sizes_by_name(asked.getlist("filename"), asked.getlist("bytes"))
        options, of = asked.get("options", ""), asked.get("of")
        media_type = request.headers.get("content-type", "").partition(";")[0] if of is None else TABLE
        read_options(options)  # a mistake there is said before the file has come
        if of is not None and not is_id(of):
            raise HTTPException(422, "of names a job by its id")
        if self._coming[gateway] >= MAX_COMING:
            raise HTTPException(429, f"{MAX_COMING} files are being sent already; send this one later", _SOON)
        self._coming[gateway] += 1
        try:
            with tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as folder, held(Path(folder)):
                body = Path(folder, "body")
                with body.open("wb") as file:
                    await _receive(request, MAX_BODY, file.write)
                if of is not None:
                    await gateway.ask(lambda client: body.write_bytes(client.table(of)))
                parts = await run_in_threadpool(split_files, body, sizes)
                yield await self._readers.read(parts, options, media_type, made)
        finally:
            self._coming[gateway] -= 1

    # ------------------------------------------------------------------------------ workers and coordinator

    async def workers(self, request: Request) -> Response:
        """List the workers."""
        prefix = request.query_params.get("prefix", "")
        return JSONResponse({"workers": to_jsonable_python(await gateway_of(request).ask(lambda c: c.workers(prefix)))})

    async def set_service(self, request: Request) -> Response:
        """Cordon or drain a worker, or open it again."""
        worker, body = request.path_params["worker"], await _read(request, NewService)
        if not is_id(worker):
            raise HTTPException(404, "there is no such worker")
        views = await gateway_of(request).ask(lambda client: client.set_worker(worker, body.service))
        return JSONResponse({"workers": to_jsonable_python(views)})

    async def coordinator(self, request: Request) -> Response:
        """Give the coordinator's view of itself, and of its queue."""
        view, depth = await gateway_of(request).ask(lambda client: (client.coordinator(), client.queue_depth()))
        return JSONResponse({"coordinator": to_jsonable_python(view), "queue": to_jsonable_python(depth)})

    async def set_queue(self, request: Request) -> Response:
        """Have no more jobs taken up, or go on."""
        body = await _read(request, NewQueue)
        view = await gateway_of(request).ask(lambda client: client.pause_queue(paused=body.paused))
        return JSONResponse({"coordinator": to_jsonable_python(view)})


_SOON: Final = {"retry-after": "1"}
_REPORT: Final = (FUNCTIONS[Report], encode_value(Report()))


def _job(request: Request) -> str:
    job: str = request.path_params["job"]
    if not is_id(job):
        raise HTTPException(404, "there is no such job: ids have 1 to 64 letters, digits, _ or -")
    return job


def require_same_version(hello: Hello) -> None:
    """Raise HTTPException where a program is of a version that speaks otherwise."""
    if (hello.protocol, hello.engine) != (PROTOCOL_VERSION, ENGINE_REVISION):
        raise HTTPException(
            409,
            f"this program is Atoll {hello.version} (protocol {hello.protocol}), and {VERSION} (protocol "
            f"{PROTOCOL_VERSION}) answers; install the same version",
        )


def _whole(request: Request, name: str, default: int | None, least: int, most: int = 2**63 - 1) -> Any:
    """Return a whole number of the query; raises HTTPException."""
    text = request.query_params.get(name)
    if text is None:
        return default
    digits = text.removeprefix("-")
    if digits.isascii() and digits.isdecimal() and len(digits) < 20 and least <= int(text) <= most:
        return int(text)
    raise HTTPException(422, f"{name} must be a whole number from {least} to {most}")


def _flag(request: Request, name: str) -> bool:
    text = request.query_params.get(name, "false")
    if text not in ("true", "false"):
        raise HTTPException(422, f"{name} must be true or false")
    return text == "true"


async def _read(request: Request, kind: type[Any]) -> Any:
    """Return a small JSON body; raises HTTPException."""
    try:
        return kind.model_validate_json(await _body(request, 64 * 1024))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the body"
        raise HTTPException(422, f"{where}: {first['msg']}") from None


async def _body(request: Request, most: int) -> bytes:
    """Return the body; raises HTTPException as `_receive` does."""
    body = bytearray()
    await _receive(request, most, body.extend)
    return bytes(body)


async def _receive(request: Request, most: int, take: Callable[[bytes], object]) -> None:
    """Take the body, of bounded size and within limits of time; raises HTTPException."""
    told = request.headers.get("content-length", "0")
    too_large = HTTPException(413, f"a body may have {most:,} bytes at most; use coordinator submit for larger files")
    if told.isdecimal() and int(told) > most:
        raise too_large
    began, received = asyncio.get_running_loop().time(), 0
    try:
        async with asyncio.timeout(PATIENCE_S) as limit:
            async for chunk in request.stream():
                received += len(chunk)
                if received > most:
                    raise too_large
                take(chunk)
                limit.reschedule(began + min(BODY_LIMIT_S, PATIENCE_S + received / SLOWEST))
    except TimeoutError:
        sentence = (
            f"the body came too slowly; {SLOWEST:,} bytes a second are expected, and all of it in {BODY_LIMIT_S:.0f} s"
        )
        raise HTTPException(408, sentence, {"connection": "close"}) from None
    except ClientDisconnect:
        raise HTTPException(400, "the body was cut off") from None


def _download(request: Request, text: str, name: str, media_type: str) -> Response:
    headers = {"content-disposition": f'attachment; filename="{name}"'} if _flag(request, "download") else {}
    return Response(text, media_type=media_type, headers=headers)


def _export(result: Result, name: str) -> str:
    return OF_RESULTS[name](result) if name in OF_RESULTS else written(Model(result), name)


def _resource(name: str) -> str:
    return files("atoll.web").joinpath(name).read_text("utf-8")


async def _until_broken(told: AsyncIterator[str]) -> AsyncIterator[str]:
    """End a stream where the coordinator cannot be asked: the page connects again."""
    with contextlib.suppress(AtollError, BusyError):
        async for part in told:
            yield part
