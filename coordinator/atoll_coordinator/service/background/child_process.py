"""One child process of the coordinator: a new interpreter that runs tasks, sent and answered through two pipes.

Not a fork, since the coordinator's bus has threads, which a fork does not keep. Pickles are written and read here and
in `child_main` alone, by a process and the one that it started itself.
"""

import contextlib
import logging
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Final

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError

END_LIMIT_S: Final = 5.0
"""How long a process that was killed, or has closed its pipe, may take to be gone."""

OTHER_VERSION: Final = 71
"""Exit code of a child that was loaded from another version than ours: the program was replaced under us."""

_PROGRAM: Final = """
import sys
level, version, *sys.path = sys.argv[1:]
from atoll_coordinator.service.background.child_main import main
main(int(level), version)
"""
_TOLD: Final = frozenset({signal.SIGKILL})


class ProcessDiedError(AtollError):
    """Raised when a task cannot be run because its process died; a few words that name the cause."""


class TookTooLongError(ProcessDiedError):
    """Raised when a task took longer than it may; in another process it would do so again."""


class ChildProcess:
    """A process that runs tasks in the order in which they are sent; several may be sent, one be waited for."""

    def __init__(self) -> None:
        """Start it; raises ProcessDiedError when the system starts no more processes."""
        level = logging.getLogger().getEffectiveLevel()
        command = [sys.executable, "-P", "-c", _PROGRAM, str(level), version(), *sys.path]  # it finds what we found
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # a Ctrl-C on the terminal is the coordinator's to handle
                env={"OPENBLAS_NUM_THREADS": "1", **os.environ},  # matrices are small: threads of numpy's library wait
            )
        except OSError as error:
            raise ProcessDiedError(f"no process could be started for it: {error.strerror}") from error
        self._answers: queue.SimpleQueue[tuple[object, int] | None] = queue.SimpleQueue()
        self._why: str | None = None
        self._expected = 0  # counted by who sends
        self._expected_done = 0  # counted by who reads
        self._reader = threading.Thread(target=self._read, name="reading answers", daemon=True)
        try:
            self._reader.start()
        except RuntimeError as error:
            self._process.kill()
            self._process.wait(END_LIMIT_S)
            raise ProcessDiedError(f"no thread could be started for it: {error}") from error
        self.done = 0
        self.memory_bytes = 0

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether tasks can be sent; it may end at any time."""
        return self._reader.is_alive() and self._why is None

    @property
    def is_busy(self) -> bool:
        """Whether it is still running something that nobody waits for."""
        return self._expected > self._expected_done

    def send(self, function: Callable[[], object], is_awaited: bool = True) -> None:
        """Send a task, its function by name; if the process has ended, `answer` raises.

        Raises:
            pickle.PicklingError, AttributeError, TypeError: its function has no name, or what it is called with cannot
                be sent; the process is ended.
        """
        pipe = self._process.stdin
        assert pipe is not None
        self._expected += not is_awaited
        try:
            with contextlib.suppress(OSError, ValueError):  # it has ended, and the pipe may be closed already
                pickle.dump((is_awaited, function), pipe, pickle.HIGHEST_PROTOCOL)
                pipe.flush()
        except BaseException:  # half of it may have been sent
            self.kill("what it was sent could not be sent whole")
            raise

    def answer(self, limit_s: float) -> object:
        """Wait for the outcome of the task that was sent.

        Raises:
            TookTooLongError: there was none in time; the process is gone.
            ProcessDiedError: the process is gone.
        """
        try:
            said = self._answers.get(timeout=limit_s)
        except queue.Empty:
            why = f"it took longer than {limit_s:,.0f} s and was ended"
            self.kill(why)
            self.wait()
            raise TookTooLongError(why) from None
        if said is None:
            self.wait()
            raise ProcessDiedError(self._why or cause_of(self._process.returncode))
        outcome, self.memory_bytes = said
        self.done += 1
        return outcome

    def kill(self, why: str) -> None:
        """End it; whoever waits for an answer is told why."""
        self._why = self._why or why
        self._process.kill()

    def wait(self) -> None:
        """Wait, within a limit, until a process that was killed or has ended is gone without a trace."""
        self._reader.join(END_LIMIT_S)

    def _read(self) -> None:
        """Take in what the process sends until it ends; then wait for its end."""
        pipe = self._process.stdout
        assert pipe is not None
        try:
            while True:
                kind, content = pickle.load(pipe)
                if kind == "log":
                    _log(content)
                elif kind == "done":
                    self._expected_done += 1
                else:
                    self._answers.put(content)
        except Exception as error:  # also words that the end of the process cut short, or memory that ran out here
            if not isinstance(error, EOFError | pickle.UnpicklingError):
                self._why = self._why or f"its answer could not be read: {type(error).__name__}: {error}"
        self._reap()
        for end in (self._process.stdin, pipe):
            with contextlib.suppress(OSError):  # what was not sent yet cannot be
                if end is not None:
                    end.close()
        self._answers.put(None)

    def _reap(self) -> None:
        """Wait for the end of a process that sends no more."""
        try:
            self._process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _log(values: Mapping[str, object]) -> None:
    """Log a record of the child as one of this process."""
    record = logging.makeLogRecord(values)
    logging.getLogger(record.name).handle(record)


def version() -> str:
    """Return what must be the same in a coordinator and its children."""
    return f"{VERSION} {ENGINE_REVISION} {PROTOCOL_VERSION}"


def cause_of(code: int | None) -> str:
    """Return in words how a process ended by itself."""
    if code is None:
        return "its process did not end when it was told to"
    if code == OTHER_VERSION:
        return "its program is of another version than the coordinator, which must be started again"
    if code >= 0:
        return f"its process ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
    likely = ", as happens when memory runs out" if -code in _TOLD else ""
    return f"its process was ended by signal {-code} ({name}){likely}"
