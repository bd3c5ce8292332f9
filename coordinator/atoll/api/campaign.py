"""`discover_many`: the equations of many tables, as they are ready.

On an executor each table is one task: a worker prepares, searches and refines it alone, because with many tables all
workers are busy anyway. Only a few tables are read and submitted ahead, so that the tables need not fit into memory
together. If there are fewer tables than workers, they are solved one after another, each by all workers.

An error that concerns one table is the outcome of this table, and the others go on. An error of the iterable of tables
ends the reading: it is raised after the outcomes of the tables that were read.
"""

import contextlib
import itertools
import json
import os
from collections.abc import Hashable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from atoll.api.discover import (
    SubmittedJob,
    check_service_options,
    config_of,
    number_of,
    submit,
    table_of_options,
    without_service_options,
)
from atoll.api.model import Model
from atoll.api.tables import in_python
from atoll_core.errors import AtollError, DataError, UsageError
from atoll_core.machine import usable_cores
from atoll_core.quoting import shown

if TYPE_CHECKING:
    from atoll.executors.dispatcher import Computed, Dispatcher
    from atoll.executors.driver import SubmittedTable
    from atoll.executors.tasks import Solved

AHEAD: Final = 2
"""Tables that are submitted for each worker. With two, a worker has its next table when it has solved one."""

Found = tuple[Hashable, Model | AtollError]
"""The name of a table, and its model or the error why it has none."""


def discover_many(
    tables: Mapping[Any, object] | Iterable[object], *, executor: object = None, workers: int | None = None,
    **options: object,
) -> Iterator[Found]:  # fmt: skip
    """Find the equations of many tables; yield each name with its model, or its error, as soon as it is ready.

    Args:
        tables: data by name, or an iterable of files or of pairs (name, data); for `data` see `discover`. A name is any
            key of a dict, such as a text or a number. The iterable is read only as far as tables can be computed.
        executor: see `discover`; None: the service.
        workers: the number of tasks at the same time; without an executor, the number of worker processes.
        options: options of ``coordinator run``, the same for all tables; without an executor also those of `discover`.

    Yields:
        The name and the model, or an AtollError: a table that fails does not end the others. An item that is neither a
        file nor a pair has the name "table 3", by its place, and an error.

    Raises:
        UsageError: `tables`, `executor` or options are wrong; raised by the call itself.
        AtollError: the executor is broken.
        KeyboardInterrupt: after Ctrl-C; if all workers compute one table, its best model so far is yielded before.
        Exception: an error of the iterable, after the outcomes of the tables that were read before.
    """
    number = number_of(workers)
    if executor is None:
        check_service_options(options)
        return _on_service(_GivenTables(tables), number, options)
    from atoll.executors.executors import check_executor

    own = without_service_options(options)
    config_of(own)
    check_executor(executor)
    return _on_executor(_GivenTables(tables), executor, number, own)


@dataclass(frozen=True, slots=True)
class _GivenTable:
    """One table; `error`: the item of the user was none."""

    name: Hashable
    data: object = None
    error: AtollError | None = None


class _GivenTables(Iterator[_GivenTable]):
    """The tables, read from the iterable of the user. An error of the iterable ends them; `end` raises it."""

    def __init__(self, tables: object) -> None:
        """Raise UsageError if `tables` are not many tables."""
        is_one = isinstance(tables, (str, bytes, Path, np.ndarray)) or hasattr(tables, "columns")
        if is_one or not isinstance(tables, Iterable):
            raise UsageError(
                f"tables must be data by name, or files, or pairs (name, data), but {shown(tables)} was given"
            )
        self._items = enumerate(tables.items() if isinstance(tables, Mapping) else tables, start=1)
        self._error: Exception | None = None

    def __next__(self) -> _GivenTable:
        if self._error is not None:
            raise StopIteration
        try:
            place, item = next(self._items)
        except StopIteration:
            raise
        except Exception as error:
            self._error = error
            raise StopIteration from None
        return _table_of(place, item)

    def end(self) -> None:
        """Raise the error that has ended the iterable, if there is one."""
        if self._error is not None:
            raise self._error


def _table_of(place: int, item: object) -> _GivenTable:
    if isinstance(item, (str, Path)):
        return _GivenTable(str(item), item)
    if isinstance(item, tuple) and len(item) == 2 and _is_name(item[0]):
        return _GivenTable(item[0], item[1])
    expected = "each table must be a file or a pair (name, data), with a key of a dict as the name, such as a text"
    return _GivenTable(f"table {place}", error=UsageError(f"{expected}, but {shown(item)} was given"))


def _is_name(value: object) -> bool:
    """Return whether a value can be a key of a dict; tables of data cannot."""
    try:
        hash(value)
    except Exception:  # a TypeError of most values; a class of the caller may raise anything
        return False
    return True


def _unexpected(error: Exception) -> AtollError:
    """Return an error for any exception in the work on one table, which must not end the others."""
    found = AtollError(f"the table could not be used ({type(error).__name__}: {error})")
    found.__cause__ = error
    return found


def _on_service(tables: _GivenTables, workers: int | None, options: Mapping[str, Any]) -> Iterator[Found]:
    """Solve tables by the service, several at a time; jobs that still run when the caller stops are cancelled."""
    running: set[SubmittedJob] = set()

    def solve(table: _GivenTable) -> Found:
        if table.error is not None:
            return table.name, table.error
        try:
            job = submit(table.data, workers=workers, **options)
            running.add(job)
            try:
                return table.name, job.wait(progress=False).result()
            finally:
                running.discard(job)
        except AtollError as error:
            return table.name, error
        except Exception as error:
            return table.name, _unexpected(error)

    most = AHEAD * (workers or usable_cores(os.environ)[0])
    threads = ThreadPoolExecutor(most)
    try:
        open_tables = {threads.submit(solve, one) for one in itertools.islice(tables, most)}
        while open_tables:
            done, open_tables = wait(open_tables, return_when=FIRST_COMPLETED)
            open_tables |= {threads.submit(solve, one) for one in itertools.islice(tables, len(done))}
            yield from (one.result() for one in done)
        tables.end()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for job in [*running]:
            with contextlib.suppress(AtollError):
                job.cancel()


def _on_executor(
    tables: _GivenTables, executor: object, workers: int | None, options: Mapping[str, object]
) -> Iterator[Found]:
    """Solve tables on an executor, each as one task, or, if there are few tables, each by all workers."""
    from atoll.executors.dispatcher import Dispatcher

    with Dispatcher(executor, workers) as dispatcher:
        first = [*itertools.islice(tables, dispatcher.workers)]
        if len(first) < dispatcher.workers:
            yield from _one_by_one(first, dispatcher, options)
        else:
            yield from _each_as_task(itertools.chain(first, tables), dispatcher, options)
        tables.end()


def _one_by_one(
    tables: Iterable[_GivenTable], dispatcher: "Dispatcher", options: Mapping[str, object]
) -> Iterator[Found]:
    from atoll.executors.driver import JobDriver, SubmittedTable
    from atoll.executors.executors import ExecutorError

    for table in tables:
        found: Model | AtollError
        is_interrupted = False
        try:
            submitted = _submitted(table, options)
            if isinstance(submitted, SubmittedTable):
                driver = JobDriver(submitted, dispatcher)
                found = Model(json.loads(driver.solve()))
                is_interrupted = driver.job.state == "cancelled"
            else:
                found = submitted
        except ExecutorError:
            raise
        except AtollError as error:
            found = _in_python(error)
        yield table.name, found
        if is_interrupted:  # by Ctrl-C, which ends the campaign, too
            raise KeyboardInterrupt


def _each_as_task(
    tables: Iterator[_GivenTable], dispatcher: "Dispatcher", options: Mapping[str, object]
) -> Iterator[Found]:
    from atoll.executors.driver import SubmittedTable

    open_tables, following = 0, next(tables, None)
    while open_tables or following is not None:
        if following is not None and open_tables < AHEAD * dispatcher.workers:
            submitted = _submitted(following, options)
            if isinstance(submitted, SubmittedTable):
                dispatcher.submit(following.name, "table", (submitted, dispatcher.stop))
                open_tables += 1
            else:
                yield following.name, submitted
            following = next(tables, None)
            continue
        computed = dispatcher.wait()
        if computed is not None:
            open_tables -= 1
            yield computed.tag, _found(computed)


def _submitted(table: _GivenTable, options: Mapping[str, object]) -> "SubmittedTable | AtollError":
    """Return a table as a job for an executor, or the error why it is none."""
    if table.error is not None:
        return table.error
    try:
        return table_of_options(table.data, options)[0]
    except AtollError as error:
        return error
    except Exception as error:
        return _unexpected(error)


def _found(computed: "Computed") -> Model | AtollError:
    """Return the model of a table that a worker has solved, or the error."""
    from atoll.executors.tasks import what_to_do

    if computed.sentence:
        advice = what_to_do(computed.failure)
        return AtollError(f"a worker could not solve the table ({computed.sentence}){advice}")
    solved: Solved = computed.value
    if solved.text:
        return Model(json.loads(solved.text))
    return _in_python((DataError if solved.is_of_data else AtollError)(solved.sentence))


def _in_python(error: AtollError) -> AtollError:
    """Return an error of a job with the names of Python arguments instead of options."""
    return type(error)(in_python(str(error)))
