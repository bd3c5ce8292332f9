"""Watches over the processes of several workers: starts again those that die, and ends them all when it is told to.

One thread does all of it, since a child may be a fork of this process at any time. What happens is looked for, not
waited for: children are few, and a look is short.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType, TracebackType
from typing import Final, Literal, Protocol, Self

from atoll_core.errors import AtollError, LocalProtocolError
from atoll_core.signals import INTERRUPTED, handling, termination_signals

REPEAT_S: Final = 60.0
"""After this time a sentence may be printed again."""

_MOST_BYTES: Final = 4000
"""Of one sentence; what is written to a pipe at once stays in one piece up to 4096 bytes."""


def complain(sentence: str) -> None:
    """Print why a process ends."""
    sys.stderr.write(f"island-worker: {sentence}\n")


class ExitReasons:
    """A pipe from processes to the one that started them; a context manager. `writing_end` is theirs."""

    def __init__(self, complain: Callable[[str], None] = complain) -> None:
        self._reading_end, self.writing_end = os.pipe()
        os.set_blocking(self._reading_end, False)
        self._complain = complain
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
        """Have the first process print a sentence; in a fork of it, which has nothing to read here."""
        os.close(self._reading_end)
        report_to(self.writing_end, sentence)

    def print_new(self, now: float) -> None:
        """Print the sentences that were reported, but for those printed within the last `REPEAT_S`."""
        for sentence in self._read():
            if now - self._printed_at.get(sentence, -REPEAT_S) >= REPEAT_S:
                self._printed_at[sentence] = now
                self._complain(sentence)

    def _read(self) -> list[str]:
        """Return the sentences that were reported since the last call."""
        data = self._rest
        while True:
            try:
                more = os.read(self._reading_end, 1 << 16)
            except BlockingIOError:
                break
            data += more
        *lines, self._rest = data.split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]


def report_to(writing_end: int, sentence: str) -> None:
    """Have the process at the other end print a sentence; when that one is gone, print it here."""
    line = " ".join(sentence.split()).encode()[:_MOST_BYTES] + b"\n"
    try:
        os.write(writing_end, line)
    except OSError:
        complain(sentence)


FIRST_PAUSE_S: Final = 1.0
MOST_PAUSE_S: Final = 30.0
STEADY_S: Final = 60.0
"""A process that runs so long has its next pause begin at the first one again."""

MOST_DEATHS: Final = 5
"""After so many deaths within `STEADY_S` it is not started again."""

ENDS: Final = frozenset({0, 3, 130})
"""Exit codes of processes that end in order, or for a reason that another one would meet as well."""

REFUSED: Final = 2
"""Exit code of a process that is refused; after a first one that only means that its name is not free yet."""

ProcessState = Literal["running", "paused", "ended"]
ProcessStep = Literal["died", "due", "finished", "stop"]

PROCESS_TRANSITIONS: Final[Mapping[ProcessState, Mapping[ProcessStep, ProcessState]]] = {
    "running": {"died": "paused", "finished": "ended", "stop": "running"},
    "paused": {"due": "running", "stop": "ended"},
    "ended": {"stop": "ended"},
}
"""State of a process -> what happens -> its next state. `died`: it is to be started again; `finished`: it is not;
`stop`: all are to end."""


class RestartPolicy:
    """Restarts of one worker's process. `code` is the last exit code, `number` counts the starts."""

    def __init__(self) -> None:
        self.state: ProcessState = "paused"
        self.due_at = 0.0
        self.code = 0
        self.number = 0
        self._began_at = 0.0
        self._in_a_row = 0
        self._deaths: list[float] = []
        self._is_stopped = False

    @property
    def deaths(self) -> int:
        """How many deaths there were lately."""
        return len(self._deaths)

    @property
    def is_given_up(self) -> bool:
        """Whether it dies too often to be started again."""
        return self.state == "ended" and self.deaths >= MOST_DEATHS

    def begin(self, now: float) -> None:
        """Record a start."""
        self._step("due")
        self.number += 1
        self._began_at = now

    def end(self, code: int, now: float) -> float | None:
        """Record an end; return for how many seconds to wait before the process is started again.

        None: it is not, since it ended in order, since all are to end, or since it dies too often.
        """
        self.code = code
        is_final = self._is_stopped or code in ENDS or (code == REFUSED and self.number == 1)
        if now - self._began_at >= STEADY_S:
            self._in_a_row = 0
        self._in_a_row += 1
        self._deaths = [at for at in self._deaths if now - at < STEADY_S] + ([] if is_final else [now])
        if is_final or len(self._deaths) >= MOST_DEATHS:
            self._step("finished")
            return None
        self._step("died")
        pause_s: float = min(MOST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (self._in_a_row - 1))
        self.due_at = now + pause_s
        return pause_s

    def stop(self) -> None:
        """Have no further start: all are to end."""
        self._is_stopped = True
        if self.state == "paused":
            self.code = 0
        self._step("stop")

    def _step(self, step: ProcessStep) -> None:
        following = PROCESS_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a process that is {self.state} has no {step}")
        self.state = following


_STOP_LIMIT_S: Final = 5.0
_POLL_S: Final = 0.1

Command = Sequence[str]


class Child(Protocol):
    """A process that was started here."""

    pid: int

    def poll(self) -> int | None:
        """Return its exit code, negative for a signal; None while it lives."""

    def terminate(self) -> None:
        """Tell it to end."""

    def kill(self) -> None:
        """End it."""


Start = Callable[[], Child]


def start_process(command: Command, exit_reasons: ExitReasons) -> Child:
    """Start a command whose process may write to `exit_reasons`; raises AtollError when the system does not."""
    try:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True, pass_fds=(exit_reasons.writing_end,)
        )
    except OSError as error:
        raise AtollError(f"the system starts no more processes ({error.strerror}); ask for fewer") from error


def worst(codes: Sequence[int]) -> int:
    """Return the worst of some exit codes; death by a signal is failure."""
    return max((1 if code < 0 else code for code in codes), default=0)


@dataclass(slots=True)
class _Process:
    """One worker's process, as often as it is started."""

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
            starts: starts each worker's process, as often as it is called.
            exit_reasons: what they report of their ends.
            grace_s: seconds for children to hand over what they compute, after a SIGTERM.
            clock: seconds; `sleep` lets some pass.
        """
        self._processes = [_Process(name, start) for name, start in starts.items()]
        self._exit_reasons = exit_reasons
        self._grace_s = grace_s
        self._clock = clock
        self._sleep = sleep
        self._deadline: float | None = None
        self._signals: list[int] = []
        self._served = 0

    def run(self, parent: int | None = None) -> int:
        """Watch over them until all have ended for good; return the worst exit code, or 130 after a Ctrl-C.

        SIGTERM and Ctrl-C are passed on as SIGTERM; who has not ended `_STOP_LIMIT_S` later (after a SIGTERM `grace_s`
        more), or at a second signal, is killed. The death of the process `parent` counts as such a signal.
        """
        with handling(dict.fromkeys((signal.SIGINT, *termination_signals()), self._on_signal)):
            try:
                while not all(process.policy.state == "ended" for process in self._processes):
                    self._poll(parent)
                    self._sleep(_POLL_S)
            finally:
                self._kill()
                self._exit_reasons.print_new(self._clock())
        codes = [process.policy.code for process in self._processes]
        if self._deadline is not None:  # who was told before it could listen has ended as it was told
            codes = [0 if code == -signal.SIGTERM else code for code in codes]
        return INTERRUPTED if signal.SIGINT in self._signals else worst(codes)

    def _poll(self, parent: int | None) -> None:
        """See what has happened since the last look, and do what is due."""
        now = self._clock()
        if parent not in (None, os.getppid()) and not self._signals:
            self._signals.append(signal.SIGTERM)
        while self._served < len(self._signals):
            self._served += 1
            self._stop(now) if self._deadline is None else self._kill()
        if self._deadline is not None and now > self._deadline:
            self._kill()
        for process in self._processes:
            if process.policy.state == "paused" and now >= process.policy.due_at:
                self._begin(process, now)
        ended = [(process, code) for process in self._processes if (code := _ended(process)) is not None]
        self._exit_reasons.print_new(now)
        for process, code in ended:
            self._handle_end(process, code, now)

    def _begin(self, process: _Process, now: float) -> None:
        """Start a process; that there is room for no more of them fails all at first, and is a death later."""
        process.policy.begin(now)
        try:
            process.child = process.start()
        except AtollError as error:
            if process.policy.number == 1:
                raise
            complain(str(error))
            self._handle_end(process, error.exit_code, now)

    def _handle_end(self, process: _Process, code: int, now: float) -> None:
        subject = f"process {process.child.pid} ({process.name})" if process.child is not None else process.name
        process.child = None
        pause_s = process.policy.end(code, now)
        ending = f"was ended by signal {-code}" if code < 0 else f"has ended with exit code {code}"
        if pause_s is not None:
            complain(f"{subject} {ending}; it is started again in {pause_s:g} s")
        elif process.policy.is_given_up:
            others = sum(process.policy.state != "ended" for process in self._processes)
            left = f"{others} {'other goes' if others == 1 else 'others go'} on" if others else "no other is left"
            complain(
                f"{subject} {ending}, as it did {process.policy.deaths} times within a minute, and is "
                f"not started again ({left}); see what was said before, and whether this machine has enough memory"
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

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._signals.append(number)


def supervise(
    starts: Mapping[str, Start], exit_reasons: ExitReasons, parent: int | None = None, grace_s: float = 0.0
) -> int:
    """Start workers' processes, by name, and watch over them; see `Supervisor.run`."""
    return Supervisor(starts, exit_reasons, grace_s).run(parent)


def _ended(process: _Process) -> int | None:
    return process.child.poll() if process.child is not None and process.policy.state == "running" else None
