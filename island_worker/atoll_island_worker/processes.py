"""The processes of several workers on one machine: started, watched, restarted, ended.

One process loads libraries and kernels once (`cli.load_ahead`) and forks the workers, so that they need not load them.
A bus and threads do not survive a fork. So this process opens no bus and starts no thread before the last worker is
forked, and every worker opens its own bus. On systems where a fork is not safe (macOS, Windows), workers are new
interpreters.

`Supervisor` polls the children, since there are few of them. It uses no further thread, because a restart may fork at
any time. A child that dies is started again after a growing pause (`RestartPolicy`), unless it ended in order, was
refused, or died too often. A child reports the reason of its end through a pipe (`ExitReasons`); the same reason of
several children is printed once.

No child outlives its parent. Each child has its own session, so that Ctrl-C on the terminal reaches only the parent,
which then signals the children. If the parent dies without a signal, the kernel (on Linux) and a watching thread end
the children.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType, TracebackType
from typing import Final, Literal, Protocol, Self

from atoll_core.errors import AtollError
from atoll_core.signals import ENDING, INTERRUPTED, forget_handlers, handling, termination_signals

_STOP_LIMIT_S: Final = 5.0
_POLL_S: Final = 0.1
_ENDING_POLL_S: Final = 0.01
"""Pause between two polls of the children, normally and while they end, when somebody waits for this process."""
_STDIN: Final = 0


class Child(Protocol):
    """A process started by the supervisor."""

    pid: int

    def poll(self) -> int | None:
        """Return the child's exit code, negative for a signal; None while it runs."""

    def terminate(self) -> None:
        """Send SIGTERM."""

    def kill(self) -> None:
        """Send SIGKILL."""


Start = Callable[[], Child]

# ----------------------------------------------------------------------------------------------- forks


def can_fork() -> bool:
    """Tell whether workers may be forked on this system."""
    return sys.platform == "linux"


class Forked:
    """A fork of this process, with the methods of `subprocess.Popen` that end a process."""

    def __init__(self, work: Callable[[], int]) -> None:
        """Fork; the child runs `work` in its own session and ends with the exit code that `work` returns."""
        self._code: int | None = None
        sys.stdout.flush()
        sys.stderr.flush()
        # Signals are blocked between fork and `forget_handlers`: the child has its parent's handlers.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        try:
            self.pid: int = os.fork()
            if self.pid == 0:
                forget_handlers()
        except OSError as error:
            raise AtollError(f"the system starts no more processes ({error.strerror}); ask for fewer") from error
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if self.pid == 0:
            _run_child(work)

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def terminate(self) -> None:
        """Send SIGTERM."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self._send(signal.SIGKILL)

    def _send(self, number: int) -> None:
        if self._code is None:  # later the process id may belong to another process
            os.kill(self.pid, number)


def _run_child(work: Callable[[], int]) -> None:
    code = 1
    try:
        os.setsid()  # Ctrl-C on the terminal is for the parent
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, _STDIN)
        os.close(nothing)
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:  # the child must not continue with the code of its parent
        traceback.print_exc()
    finally:
        os._exit(code)


def start_process(command: Sequence[str], exit_reasons: "ExitReasons") -> Child:
    """Start a command whose process may write to `exit_reasons`; raises AtollError if the system starts no process."""
    try:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True, pass_fds=(exit_reasons.writing_end,)
        )
    except OSError as error:
        raise AtollError(f"the system starts no more processes ({error.strerror}); ask for fewer") from error


def end_with_parent(parent: int) -> None:
    """End this process by a SIGTERM to itself (if necessary, forcibly) as soon as `parent` is no longer its parent."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_STOP_LIMIT_S)
        os._exit(1)

    request_parent_death_signal()
    threading.Thread(target=watch, name="watching the parent", daemon=True).start()


def request_parent_death_signal() -> None:
    """Ask the system to send this process SIGTERM when its parent dies; works on Linux only, and is not guaranteed."""
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None, use_errno=True).prctl(pr_set_pdeathsig, signal.SIGTERM)


# ---------------------------------------------------------------------------------------- exit reasons

REPEAT_S: Final = 60.0
"""After this time a reason may be printed again."""

_MOST_BYTES: Final = 4000
"""Longest reason in bytes; a pipe writes up to 4096 bytes in one piece."""


def print_reason(sentence: str) -> None:
    """Print why a process ends."""
    sys.stderr.write(f"island-worker: {sentence}\n")


class ExitReasons:
    """A pipe from child processes to the process that started them; a context manager. Children use `writing_end`."""

    def __init__(self) -> None:
        self._reading_end, self.writing_end = os.pipe()
        os.set_blocking(self._reading_end, False)
        self._rest = b""
        self._printed_at: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in (self._reading_end, self.writing_end):
            os.close(end)

    def report(self, sentence: str) -> None:
        """Make the first process print a sentence; called in its forks, which do not read from the pipe."""
        os.close(self._reading_end)
        report_to(self.writing_end, sentence)

    def print_new(self, now: float) -> None:
        """Print the reported sentences, except sentences printed within the last `REPEAT_S`."""
        data = self._rest
        with contextlib.suppress(BlockingIOError):
            while True:
                data += os.read(self._reading_end, 1 << 16)
        *lines, self._rest = data.split(b"\n")
        for sentence in (line.decode("utf-8", "replace") for line in lines):
            if now - self._printed_at.get(sentence, -REPEAT_S) >= REPEAT_S:
                self._printed_at[sentence] = now
                print_reason(sentence)


def report_to(writing_end: int, sentence: str) -> None:
    """Make the process at the other end of the pipe print a sentence; if that process is gone, print it here."""
    line = " ".join(sentence.split()).encode()[:_MOST_BYTES] + b"\n"
    try:
        os.write(writing_end, line)
    except OSError:
        print_reason(sentence)


# -------------------------------------------------------------------------------------------- restarts

FIRST_PAUSE_S: Final = 1.0
MOST_PAUSE_S: Final = 30.0
STEADY_S: Final = 60.0
"""After a process has run for this time, its next pause is again the shortest pause."""

MOST_DEATHS: Final = 5
"""After this many deaths within `STEADY_S` a process is not started again."""

ENDS: Final = frozenset({0, 3, 130})
"""Exit codes after which a process is not restarted: it ended in order, or a new process would also end."""

REFUSED: Final = 2
"""Exit code of a refused process. After a first start it may only mean that the name is not free yet."""


class RestartPolicy:
    """Restarts of one worker's process. `code` is the last exit code, `number` counts the starts. Pure."""

    def __init__(self) -> None:
        self.state: Literal["running", "paused", "ended"] = "paused"
        self.due_at = 0.0
        self.code = 0
        self.number = 0
        self.deaths: list[float] = []
        self._began_at = 0.0
        self._in_a_row = 0
        self._is_stopped = False

    @property
    def is_given_up(self) -> bool:
        """Whether the process dies too often to be started again."""
        return self.state == "ended" and len(self.deaths) >= MOST_DEATHS

    def begin(self, now: float) -> None:
        """Record a start."""
        self.state = "running"
        self.number += 1
        self._began_at = now

    def end(self, code: int, now: float) -> float | None:
        """Record an end; return the seconds until the next start.

        None: there is no next start, because the process ended in order or dies too often, or because all processes
        were signalled to end.
        """
        self.code = code
        is_final = self._is_stopped or code in ENDS or (code == REFUSED and self.number == 1)
        if now - self._began_at >= STEADY_S:
            self._in_a_row = 0
        self._in_a_row += 1
        self.deaths = [at for at in self.deaths if now - at < STEADY_S] + ([] if is_final else [now])
        if is_final or len(self.deaths) >= MOST_DEATHS:
            self.state = "ended"
            return None
        self.state = "paused"
        pause_s: float = min(MOST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (self._in_a_row - 1))
        self.due_at = now + pause_s
        return pause_s

    def stop(self) -> None:
        """Allow no further start: all processes were signalled to end."""
        self._is_stopped = True
        if self.state == "paused":
            self.state, self.code = "ended", 0


def worst(codes: Sequence[int]) -> int:
    """Return the worst of several exit codes; death by a signal counts as a failure."""
    return max((1 if code < 0 else code for code in codes), default=0)


@dataclass(slots=True)
class _Process:
    """The process of one worker, including its restarts."""

    name: str
    start: Start
    child: Child | None = None
    policy: RestartPolicy = field(default_factory=RestartPolicy)


class Supervisor:
    """Children of this process by the names of their workers."""

    def __init__(
        self, starts: Mapping[str, Start], exit_reasons: ExitReasons, grace_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep,
    ) -> None:  # fmt: skip
        """Set up; nothing is started yet.

        Args:
            starts: functions by worker name; each call starts the worker's process.
            exit_reasons: the pipe through which children report the reasons of their ends.
            grace_s: seconds that children have to hand over their islands after a SIGTERM.
            clock: returns seconds; `sleep` waits for some seconds.
        """
        self._processes = [_Process(name, start) for name, start in starts.items()]
        self._exit_reasons = exit_reasons
        self._grace_s = grace_s
        self._clock = clock
        self._sleep = sleep
        self._deadline: float | None = None
        self._signals: list[int] = []
        self._handled = 0

    def run(self, parent: int | None = None) -> int:
        """Watch the children until all have finally ended; return the worst exit code, or 130 after a Ctrl-C.

        SIGTERM and Ctrl-C are passed on as SIGTERM. Children that have not ended after `_STOP_LIMIT_S` (plus `grace_s`
        after a SIGTERM) are killed; a second signal kills them at once. The death of the process `parent` counts as a
        signal.
        """

        def on_signal(number: int, frame: FrameType | None) -> None:
            self._signals.append(number)

        with handling(dict.fromkeys((signal.SIGINT, *termination_signals()), on_signal)):
            try:
                while not all(process.policy.state == "ended" for process in self._processes):
                    self._poll(parent)
                    self._sleep(_POLL_S if self._deadline is None else _ENDING_POLL_S)
            finally:
                self._kill()
                self._exit_reasons.print_new(self._clock())
        codes = [process.policy.code for process in self._processes]
        if self._deadline is not None:  # a child that got SIGTERM before its handler was installed has ended in order
            codes = [0 if code == -signal.SIGTERM else code for code in codes]
        return INTERRUPTED if signal.SIGINT in self._signals else worst(codes)

    def _poll(self, parent: int | None) -> None:
        now = self._clock()
        if parent not in (None, os.getppid()) and not self._signals:
            self._signals.append(signal.SIGTERM)
        while self._handled < len(self._signals):
            self._handled += 1
            self._stop(now) if self._deadline is None else self._kill()
        if self._deadline is not None and now > self._deadline:
            self._kill()
        for process in self._processes:
            if process.policy.state == "paused" and now >= process.policy.due_at:
                self._begin(process, now)
        ended = [
            (process, code)
            for process in self._processes
            if process.child is not None and process.policy.state == "running"
            if (code := process.child.poll()) is not None
        ]
        self._exit_reasons.print_new(now)
        for process, code in ended:
            self._handle_end(process, code, now)

    def _begin(self, process: _Process, now: float) -> None:
        """Start a process.

        If the system starts no process, the first start of a worker raises the error; later a failed start counts as a
        death.
        """
        process.policy.begin(now)
        try:
            process.child = process.start()
        except AtollError as error:
            if process.policy.number == 1:
                raise
            print_reason(str(error))
            self._handle_end(process, error.exit_code, now)

    def _handle_end(self, process: _Process, code: int, now: float) -> None:
        subject = f"process {process.child.pid} ({process.name})" if process.child is not None else process.name
        process.child = None
        pause_s = process.policy.end(code, now)
        ending = f"was ended by signal {-code}" if code < 0 else f"has ended with exit code {code}"
        if pause_s is not None:
            print_reason(f"{subject} {ending}; it is started again in {pause_s:g} s")
        elif process.policy.is_given_up:
            others = sum(process.policy.state != "ended" for process in self._processes)
            left = f"{others} {'other process runs' if others == 1 else 'other processes run'} on" if others else ""
            print_reason(
                f"{subject} {ending}, {len(process.policy.deaths)} deaths within a minute, and is not started again "
                f"({left or 'no other process is left'}); read its last messages, and check that this machine has "
                "enough memory"
            )

    def _stop(self, now: float) -> None:
        grace_s = 0.0 if signal.SIGINT in self._signals else self._grace_s
        self._deadline = now + _STOP_LIMIT_S + grace_s
        for process in self._processes:
            process.policy.stop()
            if process.child is not None:
                process.child.terminate()

    def _kill(self) -> None:
        for process in self._processes:
            if process.child is not None:
                process.child.kill()


def supervise(
    starts: Mapping[str, Start], exit_reasons: ExitReasons, parent: int | None = None, grace_s: float = 0.0
) -> int:
    """Start and supervise the processes of workers, by name; see `Supervisor.run`."""
    return Supervisor(starts, exit_reasons, grace_s).run(parent)
