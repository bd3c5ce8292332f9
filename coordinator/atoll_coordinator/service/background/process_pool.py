"""The child processes of a coordinator: started ahead, kept for what comes next, ended with what they are at.

An errand whose process dies is done once more in another. One that is stopped takes its process with it.
"""

import contextlib
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

from atoll.logs import fields
from atoll.machine.cores import usable_cores
from atoll_coordinator.service.background.child_process import ChildProcess
from atoll_coordinator.service.background.interface import LostError, StoppedError, T

LIMIT_S: Final = 3_600.0
"""Far above what preparing or refining takes: what takes longer hangs, and is ended."""

IDLE_S: Final = 120.0
"""A child that has had nothing to do for so long ends, and its memory is given back."""

MAX_AT_ONCE: Final = 4
MAX_ERRANDS: Final = 100
MAX_MEMORY: Final = 1 << 30
"""A child that has done so much, or occupies so much, does no further errand: what it leaked is given back."""

_REMEMBERED: Final = 256
_LOG = logging.getLogger(__name__)


class _Call:
    """An errand under way."""

    def __init__(self, job: str) -> None:
        self.job = job
        self.child: ChildProcess | None = None
        self.is_stopped = False


class Children:
    """See `atoll_coordinator.service.background.interface.Errands`: places are child processes."""

    def __init__(self, *, limit_s: float = LIMIT_S, idle_s: float = IDLE_S, at_once: int | None = None) -> None:
        """`at_once`: how many errands of those that wait for their turn; as many as there are cores, but at most 4."""
        self._limit_s = limit_s
        self._idle_s = idle_s
        self._at_once = at_once or min(usable_cores(os.environ)[0], MAX_AT_ONCE)
        self._changed = threading.Condition()
        self._calls: list[_Call] = []
        self._line: list[_Call] = []
        self._stopped: deque[str] = deque(maxlen=_REMEMBERED)  # an errand may come just after its job was stopped
        self._idle: list[ChildProcess] = []
        self._timer: threading.Timer | None = None
        self._is_closed = False

    # ------------------------------------------------------------------------------------------- errands

    def do(self, job: str, errand: Callable[[], T]) -> T:
        """See `Errands.do`."""
        return self._do(_Call(job), errand)

    def do_in_turn(self, job: str, errand: Callable[[], T]) -> T:
        """See `Errands.do_in_turn`."""
        call = _Call(job)
        with self._changed:
            self._line.append(call)
        return self._do(call, errand)

    def _do(self, call: _Call, errand: Callable[[], T]) -> T:
        with self._changed:
            self._calls.append(call)
            call.is_stopped = call.job in self._stopped
        try:
            self._wait_for_turn(call)
            return self._do_perhaps_again(call, errand)
        finally:
            with self._changed:
                self._calls.remove(call)
                if call in self._line:
                    self._line.remove(call)
                self._changed.notify_all()

    def _do_perhaps_again(self, call: _Call, errand: Callable[[], T]) -> T:
        try:
            return self._attempt(call, errand, self._taken if call in self._line else self._free)
        except LostError as error:
            _LOG.warning("errand lost, done again", extra=fields(job=call.job, why=str(error)))
        try:
            return self._attempt(call, errand, ChildProcess)
        except LostError as error:
            raise LostError(f"{error}, twice") from error

    def _wait_for_turn(self, call: _Call) -> None:
        """Wait until few enough are before this one in the line; each of them has a limit."""
        with self._changed:
            while call in self._line[self._at_once :] and not self._is_over(call):
                self._changed.wait()

    def _attempt(self, call: _Call, errand: Callable[[], T], choose: Callable[[], ChildProcess]) -> T:
        """Have the errand done by the child that `choose` returns, and that does nothing else meanwhile."""
        with self._changed:
            if self._is_over(call):
                raise StoppedError("it was stopped")
            child = call.child = choose()
        try:
            with _ended_after(self._limit_s, child):
                child.send(errand)
            outcome: T = child.answer(self._limit_s)
        except LostError:
            if self._is_over(call):
                raise StoppedError("it was stopped") from None
            raise
        finally:
            with self._changed:
                call.child = None
        self._give_back(child)
        return outcome

    def _is_over(self, call: _Call) -> bool:
        return call.is_stopped or self._is_closed

    # ----------------------------------------------------------------------------------------------- life

    def expect(self, errand: Callable[[], None]) -> None:
        """See `Errands.expect`: an idle child, or a new one if none is idle, does it as the first thing."""
        with self._changed:
            if self._is_closed:
                return
            try:
                child = self._taken()
            except LostError as error:
                _LOG.warning("no child process ahead", extra=fields(why=str(error)))
                return
        child.send(errand, is_awaited=False)
        self._give_back(child)

    def stop(self, job: str) -> None:
        """See `Errands.stop`."""
        with self._changed:
            self._stopped.append(job)
            for call in self._calls:
                if call.job == job:
                    self._end(call)
            self._changed.notify_all()

    def close(self) -> None:
        """See `Errands.close`; waits, within limits, until all processes are gone."""
        with self._changed:
            self._is_closed = True
            children = [*self._idle, *(call.child for call in self._calls if call.child is not None)]
            self._idle.clear()
            for call in self._calls:
                self._end(call)
            self._changed.notify_all()
            if self._timer is not None:
                self._timer.cancel()
        for child in children:
            child.kill("the coordinator ended")
        for child in children:
            child.wait()

    def _end(self, call: _Call) -> None:
        call.is_stopped = True
        if call.child is not None:
            call.child.kill("it was stopped")

    def _free(self) -> ChildProcess:
        """Return an idle child that need not be waited for, or a new one; raises LostError.

        One that was started ahead is waited for: a new one would not be quicker.
        """
        return self._chosen(lambda child: not child.is_busy or child.done == 0)

    def _taken(self) -> ChildProcess:
        """Return an idle child, best one that need not be waited for, or a new one; raises LostError."""
        is_there_a_free_one = any(child.is_alive and not child.is_busy for child in self._idle)
        return self._chosen(lambda child: not (is_there_a_free_one and child.is_busy))

    def _chosen(self, suits: Callable[[ChildProcess], bool]) -> ChildProcess:
        """Return the idle child that worked last of those that suit, or a new one; raises LostError."""
        self._idle = [child for child in self._idle if child.is_alive]
        for child in reversed(self._idle):
            if suits(child):
                self._idle.remove(child)
                return child
        return ChildProcess()

    def _give_back(self, child: ChildProcess) -> None:
        """Keep the child for what comes next, for a while and unless it has done enough."""
        is_spent = child.done >= MAX_ERRANDS or child.memory_bytes >= MAX_MEMORY
        with self._changed:
            if self._is_closed or is_spent or len(self._idle) >= self._at_once:
                child.kill("it is not needed any more")
                return
            self._idle.append(child)
            self._begin_to_wait()

    def _begin_to_wait(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(self._idle_s, self._let_go)
        self._timer.daemon = True
        with contextlib.suppress(RuntimeError):  # the system starts no more threads; children stay a while longer
            self._timer.start()

    def _let_go(self) -> None:
        """End all children that have nothing to do."""
        with self._changed:
            idle = [child for child in self._idle if not child.is_busy]
            self._idle = [child for child in self._idle if child.is_busy]
            if self._idle and not self._is_closed:
                self._begin_to_wait()
        for child in idle:
            child.kill("it had nothing to do")


@contextlib.contextmanager
def _ended_after(limit_s: float, child: ChildProcess) -> Iterator[None]:
    """End a child that does not take in within `limit_s` seconds what it is sent; raises LostError without a thread."""
    timer = threading.Timer(limit_s, child.kill, (f"its process took in nothing for {limit_s:,.0f} s and was ended",))
    timer.daemon = True
    try:
        timer.start()
    except RuntimeError as error:
        child.kill("it could not be watched")
        raise LostError(f"no thread could be started for it: {error}") from error
    try:
        yield
    finally:
        timer.cancel()
