"""`discover_many`: the equations of many tables, as they are ready.

On an executor each table is one task: a worker prepares, searches and refines it alone, because with many tables all
workers are busy anyway. Only a few tables are read and submitted ahead, so that the tables need not fit into memory
together. If there are fewer tables than workers, they are solved one after another, each by all workers.
"""

import contextlib
import itertools
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from atoll.api.discover import SubmittedJob, config_of, number_of, submit, table_of_options
from atoll.api.model import Model
from atoll.api.tables import in_python
from atoll_core.errors import AtollError, DataError, UsageError
from atoll_core.machine import usable_cores
from atoll_core.quoting import shown

if TYPE_CHECKING:
    from atoll.executors.dispatcher import Computed, Dispatcher
    from atoll.executors.tasks import Solved

AHEAD: Final = 2
"""Tables that are submitted for each worker. With two, a worker has its next table when it has solved one."""

Found = tuple[str, Model | AtollError]
"""The name of a table, and its model or the error why it has none."""

_SERVICE: Final = ("connect", "tls", "priority")


def discover_many(
    tables: Mapping[str, object] | Iterable[object], *, executor: object = None, workers: int | None = None,
    **options: object,
) -> Iterator[Found]:  # fmt: skip
    """Find the equations of many tables; yield each name with its model, or its error, as soon as it is ready.

    Args:
        tables: data by name, or an iterable of files or of pairs (name, data); for `data` see `discover`. The iterable
            is read only as far as tables can be computed.
        executor: see `discover`; None: the service.
        workers: the number of tasks at the same time; without an executor, the number of worker processes.
        options: options of ``coordinator run``, the same for all tables; without an executor also those of `discover`.

    Yields:
        The name and the model, or an AtollError: a table that fails does not end the others.

    Raises:
        UsageError: `tables`, `executor` or options are wrong.
        AtollError: the executor is broken.
        KeyboardInterrupt: after Ctrl-C; if all workers compute one table, its best model so far is yielded before.
    """
    config_of({name: value for name, value in options.items() if executor is not None or name not in _SERVICE})
    number = number_of(workers)
    named = _named(tables)
    return _on_service(named, number, options) if executor is None else _on_executor(named, executor, number, options)


def _named(tables: object) -> Iterator[tuple[str, object]]:
    """Return an iterator over the name and the data of each table; raises UsageError."""
    if isinstance(tables, (str, bytes, Path)) or not isinstance(tables, Iterable):
        raise UsageError(f"tables must be data by name, or files, or pairs (name, data), but {shown(tables)} was given")
    return map(_pair, tables.items() if isinstance(tables, Mapping) else tables)


def _pair(table: object) -> tuple[str, object]:
    if isinstance(table, (str, Path)):
        return str(table), table
    if isinstance(table, tuple) and len(table) == 2 and isinstance(table[0], str):
        return table[0], table[1]
    raise UsageError(f"each table must be a file or a pair (name, data), but {shown(table)} was given")


def _on_service(
    named: Iterator[tuple[str, object]], workers: int | None, options: Mapping[str, Any]
) -> Iterator[Found]:
    """Solve tables by the service, several at a time; jobs that still run when the caller stops are cancelled."""
    running: set[SubmittedJob] = set()

    def solve(name: str, data: object) -> Found:
        try:
            job = submit(data, workers=workers, **options)
            running.add(job)
            try:
                return name, job.wait(progress=False).result()
            finally:
                running.discard(job)
        except AtollError as error:
            return name, error

    most = AHEAD * (workers or usable_cores(os.environ)[0])
    threads = ThreadPoolExecutor(most)
    try:
        open_tables = {threads.submit(solve, *one) for one in itertools.islice(named, most)}
        while open_tables:
            done, open_tables = wait(open_tables, return_when=FIRST_COMPLETED)
            open_tables |= {threads.submit(solve, *one) for one in itertools.islice(named, len(done))}
            yield from (one.result() for one in done)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for job in [*running]:
            with contextlib.suppress(AtollError):
                job.cancel()


def _on_executor(
    named: Iterator[tuple[str, object]], executor: object, workers: int | None, options: Mapping[str, object]
) -> Iterator[Found]:
    """Solve tables on an executor, each as one task, or, if there are few tables, each by all workers."""
    from atoll.executors.dispatcher import Dispatcher

    with Dispatcher(executor, workers) as dispatcher:
        first = [*itertools.islice(named, dispatcher.workers)]
        if len(first) < dispatcher.workers:
            yield from _one_by_one(first, dispatcher, options)
        else:
            yield from _each_as_task(itertools.chain(first, named), dispatcher, options)


def _one_by_one(
    named: Iterable[tuple[str, object]], dispatcher: "Dispatcher", options: Mapping[str, object]
) -> Iterator[Found]:
    from atoll.executors.driver import JobDriver
    from atoll.executors.executors import ExecutorError

    for name, data in named:
        found: Model | AtollError
        is_interrupted = False
        try:
            driver = JobDriver(table_of_options(data, options)[0], dispatcher)
            found = Model(json.loads(driver.solve()))
            is_interrupted = driver.job.state == "cancelled"
        except ExecutorError:
            raise
        except AtollError as error:
            found = _in_python(error)
        yield name, found
        if is_interrupted:  # by Ctrl-C, which ends the campaign, too
            raise KeyboardInterrupt


def _each_as_task(
    named: Iterator[tuple[str, object]], dispatcher: "Dispatcher", options: Mapping[str, object]
) -> Iterator[Found]:
    open_tables, following = 0, next(named, None)
    while open_tables or following is not None:
        if following is not None and open_tables < AHEAD * dispatcher.workers:
            name, data = following
            try:
                table, _ = table_of_options(data, options)
            except AtollError as error:
                yield name, error
            else:
                dispatcher.submit(name, "table", (table,))
                open_tables += 1
            following = next(named, None)
            continue
        computed = dispatcher.wait()
        if computed is not None:
            open_tables -= 1
            yield computed.tag, _found(computed)


def _found(computed: "Computed") -> Model | AtollError:
    """Return the model of a table that a worker has solved, or the error."""
    if computed.sentence:
        return AtollError(f"a worker could not solve the table ({computed.sentence})")
    solved: Solved = computed.value
    if solved.text:
        return Model(json.loads(solved.text))
    return _in_python((DataError if solved.is_of_data else AtollError)(solved.sentence))


def _in_python(error: AtollError) -> AtollError:
    """Return an error of a job with the names of Python arguments instead of options."""
    return type(error)(in_python(str(error)))
