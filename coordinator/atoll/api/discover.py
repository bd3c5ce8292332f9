"""`discover` and `submit` find a model for data, by a coordinator at a given address or by a local service.

A local service is a process (`atoll.api.host`) with a coordinator and workers on this machine. The first call starts
it, later calls with the same number of workers use it again, and it ends with this interpreter. A fork of this
interpreter starts its own service, because the parent's service ends with the parent.
"""

import atexit
import contextlib
import html
import json
import os
import selectors
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Mapping
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from atoll.api.model import Model
from atoll.api.tables import NAME, files_of, in_python, python_words, table_of
from atoll.api.template import Template
from atoll.client.client import connected
from atoll.client.configure import configure
from atoll.client.follower import KEEPING, Display, DisplayWithWarnings, Follower
from atoll.client.job_options import MOST_WORKERS, OPTIONS
from atoll.client.local_processes import start_in_new_session
from atoll.client.over_http import Whereabouts, coordinator_at
from atoll.terminal.output import note
from atoll.terminal.progress import is_screen, open_display, plain_lines
from atoll_coordinator.data.reading.typed_formats import check_sheet
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError, DataError, RefusedError, UnreachableError, UsageError
from atoll_core.machine import usable_cores
from atoll_core.quoting import did_you_mean, shown
from atoll_core.wire.messages.views import JobView, Workforce

if TYPE_CHECKING:
    from atoll.executors.driver import SubmittedTable


def is_notebook() -> bool:
    """Return whether this interpreter runs a notebook."""
    return "ipykernel" in sys.modules


class NotebookDisplay(Display):
    """The lines of the plain display, updated in place."""

    def __init__(self) -> None:
        import IPython.display

        ipython: Any = IPython.display
        self._html = ipython.HTML
        self._handle = ipython.display(ipython.HTML(""), display_id=True)
        self._shown: list[str] = []

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Update the lines if they have changed."""
        del now
        lines = plain_lines(view, workforce, "")
        if lines != self._shown and self._handle is not None:
            self._shown = lines
            self._handle.update(self._html(f"<pre>{html.escape(chr(10).join(lines))}</pre>"))

    def print_note(self, sentence: str) -> None:
        """Print the sentence on stderr, which a notebook shows."""
        note(sentence)


_START_LIMIT_S: Final = 60.0
_END_LIMIT_S: Final = 15.0
_LOCK: Final = threading.Lock()


class LocalService:
    """The process of `atoll.api.host`, with its workers."""

    def __init__(self, workers: int) -> None:
        """Start the process; raises AtollError with the reason if it does not listen in time."""
        self.workers = workers
        self.owner = os.getpid()
        command = [sys.executable, "-P", "-m", "atoll.api.host", str(workers), str(self.owner)]
        self._process = start_in_new_session(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            self.endpoint = self._read_address()
        except BaseException:
            self.close()
            raise

    @property
    def is_alive(self) -> bool:
        """Whether the process runs and was started by this process, not by the parent of a fork."""
        return self.owner == os.getpid() and self._process.poll() is None

    @property
    def reason(self) -> str:
        """Why the process has ended; "" if unknown, for example if it was killed."""
        pipe = self._process.stdout
        if pipe is None or pipe.closed:
            return ""
        os.set_blocking(pipe.fileno(), False)  # workers may still have the pipe open: do not wait
        lines = (pipe.read() or b"").splitlines()
        return str(json.loads(lines[-1]).get("error", "")) if lines else ""

    def close(self) -> None:
        """End the process and wait, within a limit, until it and its workers have ended."""
        if self.owner != os.getpid():
            return
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read_address(self) -> str:
        """Return the address of the service, which it prints when it listens."""
        pipe = self._process.stdout
        assert pipe is not None
        line, end = b"", time.monotonic() + _START_LIMIT_S
        with selectors.DefaultSelector() as selector:
            selector.register(pipe, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                if not selector.select(max(0.0, end - time.monotonic())):
                    self._process.kill()
                    raise UnreachableError(f"the local service did not start within {_START_LIMIT_S:g} s")
                part = os.read(pipe.fileno(), 65536)
                if not part:
                    break
                line += part
        message = json.loads(line) if line.strip() else {"error": "the local service ended at once; see stderr"}
        if "endpoint" not in message:
            raise AtollError(message["error"])
        return str(message["endpoint"])


_services: Final[dict[int, LocalService]] = {}
"""Services by number of workers; another thread may use a service with another number."""


def number_of(workers: int | None) -> int | None:
    """Return a number of workers (None: not given); raises UsageError."""
    if workers is not None and not (isinstance(workers, Integral) and 1 <= workers <= MOST_WORKERS):
        raise UsageError(f"workers must be a whole number from 1 to {MOST_WORKERS}, but {workers!r} was given")
    return workers


def local_address(workers: int | None = None) -> str:
    """Return the address of a local service with this number of workers; start the service if needed.

    `workers` None: any running service, else a new one with a worker for each usable core.
    """
    workers = number_of(workers)
    with _LOCK:
        for number, service in [*_services.items()]:
            if not service.is_alive:
                del _services[number]
                service.close()
        number = workers or next(iter(_services), None) or usable_cores(os.environ)[0]
        if number not in _services:
            _services[number] = LocalService(number)
        return _services[number].endpoint


def check_service(address: str) -> None:
    """Raise AtollError if the local service at `address` has ended."""
    ended = [service for service in [*_services.values()] if service.endpoint == address and not service.is_alive]
    if ended:
        why = ended[0].reason or "it was killed"
        raise AtollError(f"the local service has ended: {why}; the next call starts a new one")


def close() -> None:
    """End all local services; the next call starts a new one."""
    with _LOCK:
        while _services:
            _services.popitem()[1].close()


def _forget_lock() -> None:
    """Replace the lock in a fork, because another thread of the parent may have held it."""
    global _LOCK
    _LOCK = threading.Lock()  # type: ignore[misc]
    _services.clear()


atexit.register(close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_lock)


CONNECT_LIMIT_S: Final = 20.0
_TLS: Final = ("ca", "cert", "key")
_INSTEAD: Final = {"report": "call model.report(path) of the returned model"}


class SubmittedJob:
    """A submitted job. Each call opens and closes its own connection, so a `SubmittedJob` has no close method."""

    def __init__(self, id: str, address: str | Whereabouts, read_as: str = "") -> None:
        """`id` is the id of a job of the coordinator at `address`.

        `read_as` is a sentence on how its data were read, "" if unknown.
        """
        self.id = id
        self.read_as = read_as
        self.is_interrupted = False
        self._address = address

    def progress(self) -> JobView:
        """Return the progress of the job: its state, and the epoch and best equation of each variable."""
        with connected(self._address, CONNECT_LIMIT_S) as client:
            return client.status(self.id)

    def wait(self, timeout: float | None = None, *, progress: bool | None = None) -> Self:
        """Wait until the job has ended, and show its progress; Ctrl-C cancels the job and keeps its best equations.

        `timeout`: seconds after which TimeoutError is raised; the job continues. `progress`: see `discover`.
        """
        with connected(self._address, CONNECT_LIMIT_S) as client, _display(progress) as display:
            end = None if timeout is None else client.now() + timeout

            def check() -> tuple[str, ...]:
                if end is not None and client.now() > end:
                    raise TimeoutError(f"job {self.id} has not ended within {timeout:g} s; it continues")
                check_service(str(self._address))
                return ()

            if self.read_as:
                display.print_note(f"read as {self.read_as}")
            try:
                Follower(client, self.id, display, check, in_python).follow()
            except KeyboardInterrupt:
                display.print_note(KEEPING)
                self.is_interrupted = True
                client.cancel_and_wait(self.id)
        return self

    def cancel(self) -> None:
        """Cancel the job and keep its best equations."""
        with connected(self._address, CONNECT_LIMIT_S) as client:
            client.cancel_and_wait(self.id)

    def result(self) -> Model:
        """Return the model; while the job runs, the best model so far.

        Raises RefusedError if the job has not found an equation yet, AtollError with the reason if the job failed.
        """
        with connected(self._address, CONNECT_LIMIT_S) as client:
            view = client.status(self.id)
            if view.state == "failed":
                kind = DataError if view.fault == "data" else AtollError
                raise kind(in_python(f"job {self.id} failed: {view.reason}"))
            try:
                return Model(client.result(self.id))
            except UsageError as error:
                raise RefusedError(f"job {self.id} is {view.state}; {error}") from None


def discover(  # noqa: PLR0913  # where a job runs, and its options
    data: object,
    *,
    connect: str | None = None,
    tls: Mapping[str, str | Path] | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    priority: int = 0,
    executor: object = None,
    **options: object,
) -> Model:
    """Find the equations of `data` and return them as a model.

    Args:
        data: a file, a frame of pandas or polars, arrays by column name, a list of these with one item per trajectory,
            or a list of records. All are read with the rules for files: decimal commas, dates, long tables.
        connect: address of the coordinator, such as ``tcp/host:7447``; None: a local service, started at the first
            call.
        tls: paths of the files ``ca``, ``cert`` and ``key`` by these names, for an address ``tls/…``.
        workers: number of worker processes on this machine; None: one for each core.
        progress: whether to show the progress on stderr; None: on a terminal and in a notebook.
        priority: -10 to 10; each step doubles the job's share of the workers, and the job starts sooner.
        executor: compute on an executor instead of the service: an executor of `concurrent.futures`, loky or mpi4py, a
            function that returns one, a ``distributed.Client``, or the module ``ray``. `workers` is then the number of
            tasks at the same time; None: as many as the executor has workers. The result is the same to the bit.
        options: options of ``coordinator run``, such as ``time="year"``, ``seed=3``, ``known={"dy": "-x"}``; a value
            may be a text, a number, a list, a mapping, or True for a switch. ``template=atoll.Template(…)`` gives
            equations of which a part is known.

    Returns:
        The model; after Ctrl-C, the best model so far.

    Raises:
        UsageError: an option is wrong.
        DataError: the data cannot be used.
        AtollError: the job failed.
    """
    if executor is not None:
        without_service_options({"connect": connect, "tls": tls, "priority": priority})
        return _discover_on(executor, data, number_of(workers), progress, options)
    job = submit(data, connect=connect, tls=tls, workers=workers, priority=priority, **options)
    job.wait(progress=progress)
    try:
        return job.result()
    except RefusedError:
        if job.is_interrupted:  # before any equation was found
            raise KeyboardInterrupt from None
        raise


_SERVICE: Final[Mapping[str, object]] = {"connect": None, "tls": None, "priority": 0}
"""The options that are for the service only, and their default values."""


def without_service_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that an executor can use; raises UsageError if others differ from their default values."""
    if any(options.get(name, default) != default for name, default in _SERVICE.items()):
        raise UsageError("connect, tls and priority are for the service; leave them out, or leave out executor")
    return {name: value for name, value in options.items() if name not in _SERVICE}


def check_service_options(options: Mapping[str, Any]) -> JobConfig:
    """Return the configuration for the options of `submit`, other than `workers`; raises UsageError."""
    values = dict(options)
    connect, tls, priority = values.pop("connect", None), values.pop("tls", None), values.pop("priority", 0)
    if isinstance(priority, bool) or not isinstance(priority, int) or priority not in range(-10, 11):
        raise UsageError(f"priority must be a whole number from -10 to 10, but {shown(priority)} was given")
    if connect is not None and not isinstance(connect, str):
        raise UsageError(f"connect must be an address such as 'tcp/HOST:7447', but {shown(connect)} was given")
    if tls is not None and not (isinstance(tls, Mapping) and set(tls) <= set(_TLS)):
        raise UsageError(f"tls must have the files {', '.join(_TLS)} by these names, but {shown(tls)} was given")
    return config_of(values)


def _discover_on(
    executor: object, data: object, workers: int | None, progress: bool | None, options: Mapping[str, object]
) -> Model:
    """Return the model of `data`, computed on an executor."""
    from atoll.executors.driver import solve

    table, read_as = table_of_options(data, options)
    with _display(progress) as display, python_words():
        if read_as:
            display.print_note(f"read as {read_as}")
        shows_nothing = type(display) is Display
        shown = None if shows_nothing else DisplayWithWarnings(display, in_python)
        return Model(json.loads(solve(table, executor, workers, shown)))


def table_of_options(data: object, options: Mapping[str, object]) -> "tuple[SubmittedTable, str]":
    """Return `data` and options as a job for an executor, and a sentence on how the data were read."""
    from atoll.executors.driver import SubmittedTable

    config = config_of(options)
    with python_words():
        check_sheet(files_of(data), config.data.sheet)
        table = table_of(data, config.data)
    name = table.files[0] if table.files else NAME
    return SubmittedTable(f"py-{uuid.uuid4().hex[:12]}", name, config, table.to_bytes()), table.read_as


def submit(
    data: object,
    *,
    connect: str | None = None,
    tls: Mapping[str, str | Path] | None = None,
    workers: int | None = None,
    priority: int = 0,
    **options: object,
) -> SubmittedJob:
    """Submit `data` as a job and return it at once; for the arguments see `discover`."""
    config = check_service_options({**options, "connect": connect, "tls": tls, "priority": priority})
    with python_words():
        check_sheet(files_of(data), config.data.sheet)
        table = table_of(data, config.data)
        address = _address(connect, tls, workers)
    job = SubmittedJob(f"py-{uuid.uuid4().hex[:12]}", address, table.read_as)
    with python_words(), connected(address, CONNECT_LIMIT_S) as client:
        try:
            client.hand_in(job.id, table.files[0] if table.files else NAME, config, table.to_bytes(), priority)
        except KeyboardInterrupt as error:
            if connect is not None:  # a local service ends with this interpreter
                error.add_note(f"job {job.id} may have been submitted: coordinator status {job.id} --connect {address}")
            raise
    return job


def config_of(options: Mapping[str, object]) -> JobConfig:
    """Return the configuration for keyword arguments (the options of ``run``); raises UsageError."""
    values = dict(options)
    job_file = values.pop("config", None)
    values |= _template_options(values.pop("template", None), values)
    unknown = next((name for name in values if name not in OPTIONS), None)
    if unknown is not None:
        advice = _INSTEAD.get(unknown, f"see help(atoll.discover){did_you_mean(unknown, OPTIONS)}")
        raise UsageError(f"{unknown} is not an option; {advice}")
    return configure(values, job_file)


def _template_options(template: object, others: Mapping[str, object]) -> dict[str, object]:
    """Return the options of a template (None: not given); raises UsageError if other options also give equations."""
    if template is None:
        return {}
    if not isinstance(template, Template):
        raise UsageError(f"template must be an atoll.Template, but {shown(template)} was given")
    if not template.equations:
        raise UsageError("template has no equations; give at least one, such as {'dx/dt': '-k*x + ?'}")
    both = next((name for name in ("equation", "parameter") if others.get(name) is not None), None)
    if both is not None:
        raise UsageError(f"template and {both} both describe given equations; leave one of them out")
    return template.options


def _address(connect: str | None, tls: Mapping[str, str | Path] | None, workers: int | None) -> str | Whereabouts:
    if connect is None:
        return local_address(workers)
    files = {f"tls_{name}": str(file) for name, file in (tls or {}).items()}
    return coordinator_at(connect, files, os.environ)


def _display(progress: bool | None) -> Display:
    if progress is False or (progress is None and not is_screen() and not is_notebook()):
        return Display()
    return NotebookDisplay() if is_notebook() else open_display("")
