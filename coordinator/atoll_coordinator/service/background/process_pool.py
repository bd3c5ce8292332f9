"""A pool of child processes that run the tasks of jobs: started ahead, kept for later tasks, ended with their jobs.

A task whose process dies runs once more in another process. A task that is cancelled ends with its process.
"""

import contextlib
import logging
import os
import threading
from collections.abc import Callable, Iterator
from typing import Final, TypeVar, cast

from atoll_coordinator.service.background.child_process import ChildProcess, ProcessDiedError, TookTooLongError
from atoll_core.errors import AtollError
from atoll_core.logs import fields
from atoll_core.machine.cores import usable_cores

LIMIT_S: Final = 3_600.0
"""Far above what preparing or refining takes: a task that takes longer hangs, and is ended."""

IDLE_S: Final = 120.0
"""A process that has had no task for so long ends, and its memory is given back."""

MAX_AT_ONCE: Final = 4
MAX_TASKS: Final = 100
MAX_MEMORY: Final = 1 << 30
"""A process that has run so many tasks, or occupies so many bytes, runs no further task: its leaks are given back."""

_LOG = logging.getLogger(__name__)

T = TypeVar("T")


class TaskCancelledError(AtollError):
    """Raised when a task was cancelled: nobody waits for its outcome."""


class _Task:
    """A task that runs or waits for its turn."""

    def __init__(self, job: str) -> None:
        self.job = job
        self.process: ChildProcess | None = None
        self.is_cancelled = False


class ProcessPool:
    """Runs functions of modules (or `functools.partial` of these). Its methods may be called from any thread."""

    def __init__(self, *, limit_s: float = LIMIT_S, idle_s: float = IDLE_S, at_once: int | None = None) -> None:
        """`at_once`: how many queued tasks run at the same time; as many as there are cores, but at most 4."""
        self._limit_s = limit_s
        self._idle_s = idle_s
        self._at_once = at_once or min(usable_cores(os.environ)[0], MAX_AT_ONCE)
        self._changed = threading.Condition()
        self._tasks: list[_Task] = []
        self._queue: list[_Task] = []
        self._idle: list[ChildProcess] = []
        self._timer: threading.Timer | None = None
        self._is_closed = False

    # --------------------------------------------------------------------------------------------- tasks

    def submit(
        self, job: str, function: Callable[[], T], on_result: Callable[[T], None], on_failure: Callable[[str], None],
        *, is_queued: bool = False,
    ) -> None:  # fmt: skip
        """Run a task and return at once; see `run`.

        Args:
            job: whose task it is; `cancel` ends it, and then neither function is called.
            function: the task.
            on_result: called with what the task returned, from another thread.
            on_failure: called with a few words on why the task cannot be run, from any thread.
            is_queued: whether it waits while as many queued tasks run as the machine has cores.
        """
        task = self._add(job, is_queued)

        def work() -> None:
            try:
                result = self._run(task, function)
            except TaskCancelledError:
                return
            except ProcessDiedError as error:
                on_failure(str(error))
            except Exception as error:  # the job needs an outcome, whatever this machine has run out of
                _LOG.exception("task failed", extra=fields(job=job))
                on_failure(f"{type(error).__name__}: {error}")
            else:
                on_result(result)

        try:
            threading.Thread(target=work, name=f"task of job {job}", daemon=True).start()
        except RuntimeError as error:  # the system starts no more threads
            self._remove(task)
            on_failure(str(error))

    def run(self, job: str, function: Callable[[], T], *, is_queued: bool = False) -> T:
        """Run a task, wait for it and return what it returns.

        Raises:
            TaskCancelledError: it was cancelled, or the pool is closed.
            ProcessDiedError: its process died, and so did the second one.
        """
        return self._run(self._add(job, is_queued), function)

    def _add(self, job: str, is_queued: bool) -> _Task:
        """Add a task, which `cancel` finds from now on."""
        task = _Task(job)
        with self._changed:
            self._tasks.append(task)
            if is_queued:
                self._queue.append(task)
        return task

    def _remove(self, task: _Task) -> None:
        with self._changed:
            self._tasks.remove(task)
            if task in self._queue:
                self._queue.remove(task)
            self._changed.notify_all()

    def _run(self, task: _Task, function: Callable[[], T]) -> T:
        try:
            self._wait_for_turn(task)
            return self._run_twice_at_most(task, function)
        finally:
            self._remove(task)

    def _wait_for_turn(self, task: _Task) -> None:
        """Wait until few enough tasks are before this one in the queue; each of them has a time limit."""
        with self._changed:
            while task in self._queue[self._at_once :] and not self._is_over(task):
                self._changed.wait()

    def _run_twice_at_most(self, task: _Task, function: Callable[[], T]) -> T:
        """Run a task; when its process dies, run it again in a new one, but not what takes too long."""
        try:
            return self._run_once(task, function, self._take_any if task in self._queue else self._take_ready)
        except TookTooLongError:
            raise
        except ProcessDiedError as error:
            _LOG.warning("task lost, run again", extra=fields(job=task.job, why=str(error)))
        try:
            return self._run_once(task, function, ChildProcess)
        except ProcessDiedError as error:
            raise ProcessDiedError(f"{error}, twice") from error

    def _run_once(self, task: _Task, function: Callable[[], T], take: Callable[[], ChildProcess]) -> T:
        """Run the task in the process that `take` returns, which has no other task meanwhile."""
        with self._changed:
            if self._is_over(task):
                raise TaskCancelledError("it was cancelled")
            process = task.process = take()
        try:
            with _ended_after(self._limit_s, process):
                process.send(function)
            result = cast(T, process.answer(self._limit_s))
        except ProcessDiedError:
            if self._is_over(task):
                raise TaskCancelledError("it was cancelled") from None
            raise
        finally:
            with self._changed:
                task.process = None
        self._give_back(process)
        return result

    def _is_over(self, task: _Task) -> bool:
        return task.is_cancelled or self._is_closed

    def preload(self, function: Callable[[], None]) -> None:
        """Have an idle process, or a new one, run what makes later tasks quicker; nobody waits for it."""
        with self._changed:
            if self._is_closed:
                return
            try:
                process = self._take_any()
            except ProcessDiedError as error:
                _LOG.warning("no process started ahead", extra=fields(why=str(error)))
                return
        process.send(function, is_awaited=False)
        self._give_back(process)

    def cancel(self, job: str) -> None:
        """End the tasks of a job at once."""
        with self._changed:
            for task in self._tasks:
                if task.job == job:
                    self._end(task)
            self._changed.notify_all()

    def close(self) -> None:
        """End all tasks at once and wait, within limits, until all processes are gone; later tasks are cancelled."""
        with self._changed:
            self._is_closed = True
            processes = [*self._idle, *(task.process for task in self._tasks if task.process is not None)]
            self._idle.clear()
            for task in self._tasks:
                self._end(task)
            self._changed.notify_all()
            if self._timer is not None:
                self._timer.cancel()
        for process in processes:
            process.kill("the coordinator ended")
        for process in processes:
            process.wait()

    def _end(self, task: _Task) -> None:
        task.is_cancelled = True
        if task.process is not None:
            task.process.kill("it was cancelled")

    # ----------------------------------------------------------------------------------------- processes

    def _take_ready(self) -> ChildProcess:
        """Return an idle process that is not busy, or a new one; raises ProcessDiedError.

        One that was started ahead is waited for: a new one would not be quicker.
        """
        return self._take(lambda process: not process.is_busy or process.done == 0)

    def _take_any(self) -> ChildProcess:
        """Return an idle process, best one that is not busy, or a new one; raises ProcessDiedError."""
        is_one_ready = any(process.is_alive and not process.is_busy for process in self._idle)
        return self._take(lambda process: not (is_one_ready and process.is_busy))

    def _take(self, is_suitable: Callable[[ChildProcess], bool]) -> ChildProcess:
        """Return the suitable idle process that worked last, or a new one; raises ProcessDiedError."""
        self._idle = [process for process in self._idle if process.is_alive]
        for process in reversed(self._idle):
            if is_suitable(process):
                self._idle.remove(process)
                return process
        return ChildProcess()

    def _give_back(self, process: ChildProcess) -> None:
        """Keep the process for later tasks, for a while and unless it has done enough."""
        is_spent = process.done >= MAX_TASKS or process.memory_bytes >= MAX_MEMORY
        with self._changed:
            if self._is_closed or is_spent or len(self._idle) >= self._at_once:
                process.kill("it is not needed any more")
                return
            self._idle.append(process)
            self._start_timer()

    def _start_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(self._idle_s, self._end_idle)
        self._timer.daemon = True
        with contextlib.suppress(RuntimeError):  # the system starts no more threads; processes stay a while longer
            self._timer.start()

    def _end_idle(self) -> None:
        """End all processes that have nothing to do."""
        with self._changed:
            idle = [process for process in self._idle if not process.is_busy]
            self._idle = [process for process in self._idle if process.is_busy]
            if self._idle and not self._is_closed:
                self._start_timer()
        for process in idle:
            process.kill("it had nothing to do")


@contextlib.contextmanager
def _ended_after(limit_s: float, process: ChildProcess) -> Iterator[None]:
    """End a process that does not take in within `limit_s` seconds what it is sent; raises ProcessDiedError."""
    why = f"its process took in nothing for {limit_s:,.0f} s and was ended"
    timer = threading.Timer(limit_s, process.kill, (why,))
    timer.daemon = True
    try:
        timer.start()
    except RuntimeError as error:
        process.kill("it could not be watched")
        raise ProcessDiedError(f"no thread could be started for it: {error}") from error
    try:
        yield
    finally:
        timer.cancel()
