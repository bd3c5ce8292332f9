"""The program ``island-worker`` on one machine of a cluster, as a child of the cluster's own process there."""

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from atoll.client.local_workers import worker_command

STOP_LIMIT_S: Final = 10.0
"""How long the program may take to end beyond the time for handing over; itself it kills workers after five."""

ENDS: Final = {
    0: "the coordinator ended, or they were told to end",
    2: "bad options, or refused by the coordinator",
    3: "the coordinator could not be reached",
}
"""What exit codes of the program mean; any other is a failure."""


@dataclass(frozen=True)
class ProgramOptions:
    """What the program is told, in plain values.

    `connect` is the coordinator's address, `tls` has the certificates' files by ``ca``, ``cert``, ``key``, as they are
    called on the machines of the cluster. For `wait_s` seconds the coordinator may be away; within `grace_s` seconds
    islands are handed over when the program is told to end.
    """

    connect: str
    wait_s: float
    grace_s: float
    tls: Mapping[str, str] = field(default_factory=dict)


def drain_limit_s(options: ProgramOptions) -> float:
    """Return after how many seconds a program that is told to end has ended, by force if need be."""
    return options.grace_s + STOP_LIMIT_S


class WorkerProgram:
    """So many worker processes: one program, which starts them again when they die, and ends with this process.

    Should this process be killed, they hand over their islands before they end, see ADR 0062.
    """

    def __init__(self, options: ProgramOptions, processes: int) -> None:
        """Start it."""
        self.processes: Final = processes
        self._limit_s = drain_limit_s(options)
        command = worker_command(options.connect, None, processes, wait_s=options.wait_s, grace_s=options.grace_s)
        files = [word for name, file in options.tls.items() for word in (f"--tls-{name}", file)]
        # Its output is this process's, so that it stands in the cluster's logs; certificates may be in the environment.
        self._process = subprocess.Popen(
            [*command, *files, "--supervise"], stdin=subprocess.DEVNULL, start_new_session=True
        )

    def exit_code(self) -> int | None:
        """Return the program's exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def drain(self) -> None:
        """Have the workers hand over their islands and end; within a limit, then by force. Repeatable."""
        self._process.terminate()
        try:
            self._process.wait(self._limit_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def ending(exit_code: int) -> str:
    """Return how a program has ended, for people."""
    if exit_code < 0:
        return f"ended by signal {-exit_code}"
    return f"ended with exit code {exit_code}" + (f" ({ENDS[exit_code]})" if exit_code in ENDS else "")
