"""The handlers of the API. `operations` explains their declarations, and ``openapi.json`` lists all operations.

How it works: a handler finds the `Gateway` of the user who sent the request, asks the coordinator through it, and
returns plain data; the coordinator checks the user's rights. A result is fetched once and shared by all requests of a
user for at least `RESULT_S` seconds, and the charts of its progress are compressed once (`_Packed`). If fetching takes
long, pages get an older result, so that fetching takes at most the share `SHARE` of the time. Uploaded files are read
in another process (`reading`).

Doubtful: a shared result may be some seconds old. When the state of a job changes, the feed drops the shared result, so
pages get the final result. Without a listening page there is no feed, and a program may get the result of a second ago.
"""

import asyncio
import contextlib
import gzip
import hashlib
import json
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, BeforeValidator, Field
from pydantic_core import to_jsonable_python
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route

from atoll.api.model import Model
from atoll.client.client import Client
from atoll.client.over_http import MESSAGE
from atoll.export.formats import LANGUAGES, RESULT_FORMATS, export_model
from atoll.tasks.analyses import FUNCTIONS, Report, answered
from atoll.text.render import parse_picks, pick
from atoll.web.access import gateway_of
from atoll.web.connections import most_connections
from atoll.web.feed import MAX_LISTENERS, Feed
from atoll.web.gateway import BusyError, Gateway
from atoll.web.operations import Body, Operation, QueryParameters, operation, receive
from atoll.web.page_options import options_by_heading, read_options, sizes_by_name
from atoll.web.pictures import progress, simulation_of
from atoll.web.reading import PREFIX, Readers, locked, split_files
from atoll.web.reading_task import MAX_BODY, TABLE
from atoll_coordinator.result.result import Result
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, RemoteProtocolError, UnknownJobError, UnreachableError
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import ClientRequest as Question
from atoll_core.wire.messages.clients import QueueDepth
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello
from atoll_core.wire.messages.limits import MAX_MESSAGE, MAX_PAGE_JOBS, Id, Priority
from atoll_core.wire.messages.views import (
    CoordinatorView,
    EventView,
    IslandView,
    JobState,
    JobView,
    WorkerService,
    WorkerView,
)
from atoll_core.wire.topics import is_id
from atoll_core.wire.values import encode_value

MAX_COMING: Final = 8
"""Maximum number of files that a user sends at a time, since they take disk space: enough for a few pages."""

MAX_OF_USER: Final = 64 * 1024**2
"""Maximum bytes of a user's messages in memory, from the first byte until the answer: enough for four messages
of the largest size."""

MAX_OF_ALL: Final = 128 * 1024**2
"""Maximum bytes of messages of all users in memory."""

RESULT_S: Final = 1.0
"""Shortest time in seconds for which a result is reused, so that any number of pages cost one request."""

SHARE: Final = 0.05
"""Largest share of the time that is spent on fetching one result: fetching is slow for a job with many islands."""

MAX_RESULTS: Final = 16
"""Maximum number of results that are kept for reuse."""

MAX_WATCHED: Final = 32
"""Maximum number of jobs that one stream may name."""

_SOON: Final = {"retry-after": "1"}
_REPORT: Final = (FUNCTIONS[Report], encode_value(Report()))
_FILES: Final = ("application/octet-stream", "text/csv", TABLE)

# ----------------------------------------------------------------------------------------- requests and answers


def _truth(value: object) -> object:
    if value not in ("true", "false"):
        raise ValueError("true or false was expected")
    return value == "true"


Flag = Annotated[bool, BeforeValidator(_truth)]
_PICK: Final = "use other equations: VARIABLE=NUMBER of a member of its front, from 0"
_OPTIONS: Final = "options of the command line by name, as a JSON object: texts, true, or lists of texts"


class JobsQuery(QueryParameters):
    limit: int = Field(50, ge=1, le=MAX_PAGE_JOBS, description="maximum number of jobs")
    cursor: int | None = Field(None, ge=0, lt=2**63, description="`next` of the previous page")
    prefix: str = Field("", description="the beginning of the ids of the jobs")
    state: JobState | None = Field(None, description="only jobs in this state")


class FileQuery(QueryParameters):
    filename: list[str] = Field(
        [], description="name of each file, whose ending gives the format; together they are one table"
    )
    bytes: list[str] = Field([], description="bytes of each file, if the body has several files one after another")
    options: str = Field("", description=_OPTIONS)
    of: Id | None = Field(None, description="id of a job whose data are used instead of a body")


class SubmitQuery(FileQuery):
    id: Id | None = Field(None, description="the job's id: the same id with the same contents is the same job")
    name: str = Field("", description="a label for lists")
    priority: Priority = Field(0, description="priority among the jobs of the user")
    shared: Flag = Field(False, description="let all users see the job")


class RetryQuery(QueryParameters):
    id: Id | None = Field(None, description="the new job's id")


class LogQuery(QueryParameters):
    after: int = Field(0, ge=0, lt=2**63, description="the number of an event")
    limit: int = Field(200, ge=1, le=1000, description="maximum number of events")
    of_workers: Flag = Field(False, description="only log lines of workers")


class StreamQuery(QueryParameters):
    jobs: list[Id] = Field(["all"], max_length=MAX_WATCHED, description="ids of jobs, or all")
    after: int | None = Field(
        None, ge=0, lt=2**63, description="number of the last event, like the header Last-Event-ID"
    )


class ResultQuery(QueryParameters):
    download: Flag = Field(False, description="whether to answer with a file to save")


class PickQuery(QueryParameters):
    pick: list[str] = Field([], description=_PICK)


class ExportQuery(ResultQuery, PickQuery):
    pass


class WorkersQuery(QueryParameters):
    prefix: str = Field("", description="the beginning of the names of the workers")


class NewPriority(Body):
    priority: Priority


class NewSharing(Body):
    shared: bool


class NewService(Body):
    service: WorkerService


class NewQueue(Body):
    paused: bool


class JobPage(BaseModel):
    jobs: tuple[JobView, ...]
    next: int | None


class Events(BaseModel):
    events: tuple[EventView, ...]


class Islands(BaseModel):
    islands: tuple[IslandView, ...]


class WorkerViews(BaseModel):
    workers: tuple[WorkerView, ...]


class CoordinatorStatus(BaseModel):
    coordinator: CoordinatorView | None
    queue: QueueDepth | None = None


# ------------------------------------------------------------------------------------------------------------ results


@dataclass(frozen=True)
class _Packed:
    """The progress of a job, encoded once for all pages: compressed JSON, and its entity tag."""

    content: bytes
    tag: str

    @classmethod
    def of(cls, result: Result) -> "_Packed":
        body = json.dumps(progress(result), allow_nan=False).encode()
        return cls(gzip.compress(body, 5), f'"{hashlib.sha256(body).hexdigest()[:32]}"')


@dataclass(frozen=True)
class _Fetched:
    """A result that is being fetched or was fetched; `began` is the start in monotonic seconds."""

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
    """Return the result of a job, and the duration of the request in seconds."""
    began = time.monotonic()
    result = await gateway.ask(lambda client: Result.of(client.result(job)))
    return result, time.monotonic() - began


class Api:
    """All operations. Each gateway has one feed, which is created for its first listener."""

    def __init__(self, readers: Readers) -> None:
        self._readers = readers
        self._coming: Counter[object] = Counter()
        self._messages: Counter[object] = Counter()
        self._feeds: dict[object, Feed] = {}
        self._results: dict[tuple[object, str], _Fetched] = {}
        self._packed: dict[tuple[object, str], tuple[Result, asyncio.Task[_Packed]]] = {}

    def routes(self) -> list[BaseRoute]:
        """Return the routes below ``/api/v1``."""
        return [
            Route(declared.path, partial(declared.call, handler), methods=[declared.method])
            for declared, handler in self.operations()
        ]

    def operations(self) -> list[tuple[Operation, Callable[..., Any]]]:
        """Return the operations with their handlers."""
        handlers = [getattr(self, name) for name in vars(Api)]
        return [(handler.operation, handler) for handler in handlers if hasattr(handler, "operation")]

    async def close(self) -> None:
        """End all streams."""
        for feed in self._feeds.values():
            feed.stop()

    # ------------------------------------------------------------------------------------------ the process

    @operation("GET", "/version")
    async def version(self, request: Request) -> dict[str, Any]:
        """Return the version of this program."""
        return {"version": VERSION, "protocol": PROTOCOL_VERSION, "engine": ENGINE_REVISION, "api": "v1"}

    @operation("GET", "/session")
    async def session(self, request: Request) -> dict[str, Any]:
        """Return the user of this token, whether the user may change anything, and the address for workers."""
        at = gateway_of(request).destination if request.scope["gateway"] is not None else None
        user = at.credentials.name if at is not None and at.credentials is not None else None
        known = {"user": user, "may_write": request.scope["may_write"], "version": VERSION}
        return {**known, "connect": str(at) if at is not None else None}

    @operation("GET", "/health", _503="the coordinator does not answer")
    async def health(self, request: Request) -> dict[str, Any] | Response:
        """Return whether the coordinator answers, for probes."""
        if request.scope["gateway"] is None:
            return {"status": "ok", "coordinator": None}
        try:
            await gateway_of(request).ask(lambda client: client.queue_depth())
        except UnreachableError as error:
            return JSONResponse({"status": "unreachable", "coordinator": str(error)}, 503)
        return {"status": "ok", "coordinator": "answers"}

    @operation("GET", "/metrics", media="text/plain")
    async def metrics(self, request: Request) -> Response:
        """Return the depth of the queue and the number of listening pages of this process, for Prometheus."""
        depth = await gateway_of(request).ask(lambda client: client.queue_depth())
        jobs = {name: value for name, value in to_jsonable_python(depth).items() if isinstance(value, int)}
        lines = ["# TYPE atoll_queue gauge", *(f'atoll_queue{{of="{name}"}} {value}' for name, value in jobs.items())]
        listeners = sum(feed.listeners for feed in self._feeds.values())
        lines += ["# TYPE atoll_web_listeners gauge", f"atoll_web_listeners {listeners}"]
        return PlainTextResponse("\n".join(lines) + "\n")

    @operation("GET", "/openapi.json")
    async def openapi(self, request: Request) -> Response:
        """Return the description of this API."""
        return Response(_resource("openapi.json"), media_type="application/json")

    @operation("GET", "/options")
    async def options(self, request: Request) -> dict[str, Any]:
        """Return the options of a job with their help."""
        return options_by_heading()

    @operation("GET", "/demo")
    async def demo(self, request: Request) -> dict[str, Any]:
        """Return a small example data set."""
        return {"filename": "predator_prey.csv", "text": _resource("static/predator_prey.csv")}

    @operation("GET", "/events", media="text/event-stream")
    async def events(self, request: Request, query: StreamQuery) -> Response:
        """Send events and changes of jobs as they happen, as server-sent events."""
        last = request.headers.get("last-event-id")
        if last is not None and not (last.isdecimal() and int(last) < 2**63):
            raise HTTPException(422, "Last-Event-ID must be the number of an event")
        after = int(last) if last else query.after
        if request.method == "HEAD":  # a stream without a body would never end
            return Response(media_type="text/event-stream")
        gateway = gateway_of(request)
        feed = self._feeds.get(gateway)
        if feed is None:
            feed = self._feeds[gateway] = Feed(gateway, lambda job: self._results.pop((gateway, job), None))
        left = min(MAX_LISTENERS, most_connections() // 2) - sum(feed.listeners for feed in self._feeds.values())
        if feed.listeners >= left:  # one user may take at most half of the free places
            raise HTTPException(429, "too many pages are listening; close one, or poll the status of a job instead")
        parts = feed.listen(None if "all" in query.jobs else query.jobs, after)
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(_until_unreachable(parts), media_type="text/event-stream", headers=headers)

    @operation("POST", "/messages", media=MESSAGE, sent=(MESSAGE,))
    async def messages(self, request: Request) -> Response:
        """Pass a message of the bus to the coordinator, for programs of this version behind a firewall."""
        gateway = gateway_of(request)
        body = bytearray()

        def take(chunk: bytes) -> None:
            waiting = self._messages
            if waiting[gateway] + len(chunk) > MAX_OF_USER or waiting.total() + len(chunk) > MAX_OF_ALL:
                raise HTTPException(429, "too many messages are being sent; send this message later", _SOON)
            waiting[gateway] += len(chunk)
            body.extend(chunk)

        try:
            await receive(request, MAX_MESSAGE, take)
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
                raise HTTPException(422, f"this is not a message of protocol {PROTOCOL_VERSION}: {error}") from error
            answer = await gateway.ask(lambda client: client.exchange(question))
        else:
            require_same_version(hello.body)
            welcome = await gateway.ask(lambda client: client.welcome)
            answer = encode(GreetingAnswer(body=welcome))
        if answer is None:
            raise HTTPException(503, "the coordinator did not answer in time")
        return Response(answer, media_type=MESSAGE)

    # ------------------------------------------------------------------------------------------------- jobs

    @operation("GET", "/jobs")
    async def jobs(self, request: Request, query: JobsQuery) -> JobPage:
        """List a page of jobs, newest first."""
        if query.prefix and not is_id(query.prefix):
            return JobPage(jobs=(), next=None)
        page = await gateway_of(request).ask(
            lambda client: client.page_of_jobs(
                query.prefix, state=query.state, limit=query.limit, before=query.cursor
            )
        )  # fmt: skip
        return JobPage(jobs=page.jobs[::-1], next=page.before)

    @operation("POST", "/jobs", 201, sent=_FILES)
    async def submit(self, request: Request, query: SubmitQuery) -> Response:
        """Submit files as a job. The same id with the same contents is the same job."""
        job, config = query.id or uuid.uuid4().hex[:12], read_options(query.options)[1]
        async with self._read(request, query, "table") as answer:
            name = query.name or answer.with_name("name").read_text("utf-8")
            view = await gateway_of(request).ask(
                lambda client: client.hand_in(
                    job, name, config, answer.read_bytes(), query.priority, shared=query.shared
                )
            )  # fmt: skip
        return JSONResponse(to_jsonable_python(view), 201, {"location": f"jobs/{job}"})

    @operation("POST", "/outline", sent=_FILES)
    async def outline(self, request: Request, query: FileQuery) -> Response:
        """Return how the files are read, and the plan of the search."""
        async with self._read(request, query, "outline") as answer:
            return Response(answer.read_bytes(), media_type="application/json")

    @operation("POST", "/preview", sent=_FILES)
    async def preview(self, request: Request, query: FileQuery) -> Response:
        """Return smoothed curves and derivatives of the files, without a search."""
        async with self._read(request, query, "preview") as answer:
            return Response(answer.read_bytes(), media_type="application/json")

    @contextlib.asynccontextmanager
    async def _read(
        self, request: Request, query: FileQuery, wanted: Literal["table", "outline", "preview"]
    ) -> AsyncIterator[Path]:
        """Yield a file with the `wanted` view (outline, preview or table) of the uploaded files: see `Readers.read`."""
        gateway, sizes = gateway_of(request), sizes_by_name(query.filename, query.bytes)
        media_type = request.headers.get("content-type", "").partition(";")[0] if query.of is None else TABLE
        read_options(query.options)  # an error in the options is reported before the file has arrived
        if self._coming[gateway] >= MAX_COMING:
            raise HTTPException(429, f"{MAX_COMING} files are being sent; send this file later", _SOON)
        self._coming[gateway] += 1
        try:
            with tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as folder, locked(Path(folder)):
                body = Path(folder, "body")
                with body.open("wb") as file:
                    await receive(request, MAX_BODY, file.write)
                if query.of is not None:
                    await gateway.ask(lambda client: body.write_bytes(client.table(query.of or "")))
                parts = await run_in_threadpool(split_files, body, sizes)
                yield await self._readers.read(parts, query.options, media_type, wanted)
        finally:
            self._coming[gateway] -= 1

    @operation("GET", "/jobs/{job}")
    async def job(self, request: Request) -> JobView:
        """Return the status of a job."""
        return await self._ask_about_job(request, lambda client, job: client.status(job))

    @operation("DELETE", "/jobs/{job}", 204)
    async def delete(self, request: Request) -> Response:
        """Delete a job that has ended."""
        job = _job(request)
        await gateway_of(request).ask(lambda client: client.delete(job))
        return Response(status_code=204)

    @operation("POST", "/jobs/{job}/cancel")
    async def cancel(self, request: Request) -> JobView:
        """Cancel a job; its best equations are kept."""
        return await self._ask_about_job(request, lambda client, job: client.cancel(job))

    @operation("POST", "/jobs/{job}/pause")
    async def pause(self, request: Request) -> JobView:
        """Pause a job: it stops at a checkpoint until it is resumed."""
        return await self._ask_about_job(request, lambda client, job: client.pause_job(job))

    @operation("POST", "/jobs/{job}/resume")
    async def resume(self, request: Request) -> JobView:
        """Resume a paused job."""
        return await self._ask_about_job(request, lambda client, job: client.pause_job(job, paused=False))

    @operation("POST", "/jobs/{job}/retry", 201)
    async def retry(self, request: Request, query: RetryQuery) -> Response:
        """Submit a failed or cancelled job again with another id."""
        again = query.id or uuid.uuid4().hex[:12]
        view = await self._ask_about_job(request, lambda client, job: client.retry(job, again))
        return JSONResponse(to_jsonable_python(view), 201, {"location": f"../{again}"})

    @operation("PUT", "/jobs/{job}/priority")
    async def set_priority(self, request: Request, body: NewPriority) -> JobView:
        """Change the priority of a job."""
        return await self._ask_about_job(request, lambda client, job: client.set_priority(job, body.priority))

    @operation("PUT", "/jobs/{job}/sharing")
    async def set_sharing(self, request: Request, body: NewSharing) -> JobView:
        """Make a job visible to all users, or only to its submitter and admins."""
        return await self._ask_about_job(request, lambda client, job: client.share(job, shared=body.shared))

    async def _ask_about_job(self, request: Request, question: Callable[[Client, str], JobView]) -> JobView:
        job = _job(request)
        return await gateway_of(request).ask(lambda client: question(client, job))

    @operation("GET", "/jobs/{job}/logs")
    async def logs(self, request: Request, query: LogQuery) -> Events:
        """Return the events of a job after an event number, or the last events."""
        return await self._events(request, _job(request), query)

    @operation("GET", "/logs")
    async def all_logs(self, request: Request, query: LogQuery) -> Events:
        """Return the events of workers and of all visible jobs after an event number, or the last events."""
        return await self._events(request, None, query)

    async def _events(self, request: Request, job: str | None, query: LogQuery) -> Events:
        events = await gateway_of(request).ask(
            lambda client: client.events(job, query.after, query.limit, of_workers=query.of_workers)
        )
        return Events(events=events)

    @operation("GET", "/jobs/{job}/islands")
    async def islands(self, request: Request) -> Islands:
        """Return the worker and epoch of each island."""
        job = _job(request)
        return Islands(islands=await gateway_of(request).ask(lambda client: client.islands(job)))

    # ---------------------------------------------------------------------------------------------- results

    @operation("GET", "/jobs/{job}/result")
    async def result(self, request: Request, query: ResultQuery) -> Response:
        """Return result.json; while the job runs, with the best equations so far."""
        return _file(query, (await self._result(request)).to_json(), "result.json", "application/json")

    @operation("GET", "/jobs/{job}/progress", _304="the charts have not changed")
    async def progress(self, request: Request) -> Response:
        """Return the charts of the best equations so far; 304 if they have not changed."""
        key, result = (gateway_of(request), _job(request)), await self._result(request, may_be_late=True)
        known = self._packed.get(key)
        if known is None or known[0] is not result:
            known = self._packed[key] = (result, asyncio.ensure_future(run_in_threadpool(_Packed.of, result)))
            for old in [*self._packed][:-MAX_RESULTS]:
                del self._packed[old]
        packed = await asyncio.shield(known[1])
        headers = {"etag": packed.tag, "cache-control": "no-cache", "vary": "accept-encoding"}
        if request.headers.get("if-none-match") == packed.tag:
            return Response(status_code=304, headers=headers)
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(gzip.decompress(packed.content), media_type="application/json", headers=headers)
        headers["content-encoding"] = "gzip"
        return Response(packed.content, media_type="application/json", headers=headers)

    @operation("GET", "/jobs/{job}/simulation")
    async def simulation(self, request: Request, query: PickQuery) -> dict[str, Any]:
        """Simulate the model from the first measured state, and along each measured trajectory, for pictures."""
        return await run_in_threadpool(simulation_of, await self._picked(request, query.pick))

    @operation("GET", "/jobs/{job}/report", media="text/html", _202="a worker is writing the report")
    async def report(self, request: Request) -> Response:
        """Return the report as HTML; 202 while a worker is writing it."""
        job = _job(request)
        waits_for, made = await gateway_of(request).ask(lambda client: client.analysis(job, *_REPORT))
        if made is None:
            return JSONResponse({"waits_for": waits_for or "is being written by a worker"}, 202, _SOON)
        page = (await run_in_threadpool(answered, made)).text
        policy = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
        return Response(page, media_type="text/html", headers={"content-security-policy": policy})

    @operation("GET", "/jobs/{job}/exports")
    async def exports(self, request: Request) -> dict[str, Any]:
        """List the export formats."""
        return {"formats": [*LANGUAGES, *RESULT_FORMATS]}

    @operation("GET", "/jobs/{job}/exports/{format}", media="text/plain")
    async def export(self, request: Request, query: ExportQuery) -> Response:
        """Return the model in a format."""
        name, result = request.path_params["format"], await self._picked(request, query.pick)
        if name not in (*LANGUAGES, *RESULT_FORMATS):
            raise HTTPException(404, f"there is no export format {name[:64]!r}")
        text = await run_in_threadpool(
            lambda: RESULT_FORMATS[name](result) if name in RESULT_FORMATS else export_model(Model(result), name)
        )
        return _file(query, text, f"{_job(request)}.{name}.txt", "text/plain")

    async def _picked(self, request: Request, picks: list[str]) -> Result:
        """Return the result of a job, with the picked members of its fronts; raises UsageError."""
        wanted, result = parse_picks(picks), await self._result(request)
        return pick(result, wanted) if wanted else result

    async def _result(self, request: Request, *, may_be_late: bool = False) -> Result:
        """Return the result of a job. It is fetched at most once a second, and less often for pages (`may_be_late`).

        Pages are notified when the state of a job changes, and then fetch the result again. The user's right to see the
        job is checked each time.
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
        except UnknownJobError:  # the job was deleted, or is no longer shared
            self._results.pop(key, None)
            self._packed.pop(key, None)
            raise
        return result

    # ------------------------------------------------------------------------------ workers and coordinator

    @operation("GET", "/workers")
    async def workers(self, request: Request, query: WorkersQuery) -> WorkerViews:
        """List the workers."""
        return WorkerViews(workers=await gateway_of(request).ask(lambda client: client.workers(query.prefix)))

    @operation("PUT", "/workers/{worker}/service")
    async def set_service(self, request: Request, body: NewService) -> WorkerViews:
        """Cordon or drain a worker, or open it again."""
        worker = request.path_params["worker"]
        if not is_id(worker):
            raise HTTPException(404, "there is no such worker")
        return WorkerViews(
            workers=await gateway_of(request).ask(lambda client: client.set_worker(worker, body.service))
        )  # fmt: skip

    @operation("GET", "/coordinator")
    async def coordinator(self, request: Request) -> CoordinatorStatus:
        """Return the status of the coordinator, and of its queue."""
        view, depth = await gateway_of(request).ask(lambda client: (client.coordinator(), client.queue_depth()))
        return CoordinatorStatus(coordinator=view, queue=depth)

    @operation("PUT", "/coordinator/queue")
    async def set_queue(self, request: Request, body: NewQueue) -> CoordinatorStatus:
        """Pause or resume the queue; while it is paused, no further job starts."""
        view = await gateway_of(request).ask(lambda client: client.pause_queue(paused=body.paused))
        return CoordinatorStatus(coordinator=view)


def _job(request: Request) -> str:
    job: str = request.path_params["job"]
    if not is_id(job):
        raise HTTPException(404, "there is no such job: ids have 1 to 64 letters, digits, _ or -")
    return job


def require_same_version(hello: Hello) -> None:
    """Raise HTTPException for a program of another protocol or engine."""
    if (hello.protocol, hello.engine) != (PROTOCOL_VERSION, ENGINE_REVISION):
        raise HTTPException(
            409,
            f"your program is Atoll {hello.version} (protocol {hello.protocol}), but this service is {VERSION} "
            f"(protocol {PROTOCOL_VERSION}); install the same version",
        )


def _file(query: ResultQuery, text: str, name: str, media_type: str) -> Response:
    headers = {"content-disposition": f'attachment; filename="{name}"'} if query.download else {}
    return Response(text, media_type=media_type, headers=headers)


def _resource(name: str) -> str:
    return files("atoll.web").joinpath(name).read_text("utf-8")


async def _until_unreachable(parts: AsyncIterator[str]) -> AsyncIterator[str]:
    """End a stream when the coordinator does not answer; the page then connects again."""
    with contextlib.suppress(AtollError, BusyError):
        async for part in parts:
            yield part
