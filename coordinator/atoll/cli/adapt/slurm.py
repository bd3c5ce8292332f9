"""Jobs of Slurm, each with the workers of one node: submitted, listed, taken back, drained. By Slurm's own programs.

A job's script becomes the parent of its workers. So what Slurm signals to the batch shell alone (`scancel --batch`, and
`--signal=B:` when the time limit is near) reaches that parent once, which passes it on; a second SIGTERM would end the
workers without handing over.
"""

import shlex
import shutil
import subprocess
from collections.abc import Sequence
from typing import Final

from atoll.cli.adapt.adapt_policy import BatchJob, BatchState
from atoll_core.errors import AtollError, UsageError

ANSWER_LIMIT_S: Final = 60.0
"""How long a program of Slurm may take; a controller that is busy keeps them waiting for ten seconds and more."""

DRAIN_S: Final = 60
"""How long before its time limit a job is told to end, and up to a minute sooner, as Slurm says: handing over takes
half a minute at most (`island-worker --grace`)."""

_PROGRAMS: Final = ("sbatch", "squeue", "scancel")
_ENDING: Final = frozenset({"COMPLETING", "COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "PREEMPTED", "NODE_FAIL"})
_RUNNING: Final = frozenset({"RUNNING", "SUSPENDED", "STOPPED"})


class SlurmError(AtollError):
    """Raised when a program of Slurm fails or does not end; it may be different the next time."""


class Slurm:
    """Those jobs of this user that carry one name."""

    def __init__(self, name: str, worker: Sequence[str], cores: int, options: Sequence[str]) -> None:
        """Set up; raises UsageError where Slurm's programs are not there.

        Args:
            name: of the jobs.
            worker: the command of the workers of a job.
            cores: of a job.
            options: further ones of sbatch, which take precedence.
        """
        missing = [program for program in _PROGRAMS if shutil.which(program) is None]
        if missing:
            raise UsageError(
                f"{missing[0]} was not found; run adapt on a machine from which jobs of Slurm are submitted"
            )
        self._name = name
        self._script = f"#!/bin/sh\nexec {shlex.join(worker)}\n"
        ours = (
            f"--job-name={name}",
            "--nodes=1",
            "--ntasks=1",
            f"--cpus-per-task={cores}",
            f"--signal=B:TERM@{DRAIN_S}",
        )
        self._submission = ("sbatch", "--parsable", *ours, *options)

    def submit(self) -> str:
        """Submit a job; return its id."""
        return _run(self._submission, self._script).strip().partition(";")[0]  # behind it is the cluster's name

    def jobs(self) -> list[BatchJob]:
        """Return our jobs that have not ended."""
        lines = _run(("squeue", "--me", "--noheader", f"--name={self._name}", "--format=%A %T")).splitlines()
        return [BatchJob(words[0], int(words[0]), _state(words[1])) for line in lines if (words := line.split())]

    def take_back(self, job: str) -> None:
        """Cancel a job if it still waits; one that has begun meanwhile goes on."""
        _run(("scancel", "--state=PENDING", job))

    def drain(self, job: str) -> None:
        """Tell a job's workers to hand over and end."""
        _run(("scancel", "--batch", "--signal=TERM", job))

    @property
    def how_to_end(self) -> str:
        """The command that drains all of our jobs."""
        return f"scancel --me --batch --signal=TERM --name={self._name}"


def _state(word: str) -> BatchState:
    if word in _ENDING:
        return "ending"
    return "running" if word in _RUNNING else "pending"


def _run(words: Sequence[str], given: str = "") -> str:
    """Run a program and return what it prints; raises SlurmError."""
    try:
        done = subprocess.run(words, input=given, capture_output=True, text=True, timeout=ANSWER_LIMIT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise SlurmError(f"{words[0]} did not end within {ANSWER_LIMIT_S:.0f} s; see whether Slurm answers") from error
    except OSError as error:
        raise SlurmError(f"{words[0]} cannot be run: {(error.strerror or str(error)).lower()}") from error
    if done.returncode != 0:
        said = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
        raise SlurmError(f"{words[0]} failed ({said}); the command was: {shlex.join(words)}")
    return done.stdout
