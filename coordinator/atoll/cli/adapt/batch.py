"""Jobs of a batch system, each with the workers of one node: submitted, listed, taken back, drained by its programs."""

import getpass
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from typing import Final

from atoll.cli.adapt.adapt_policy import BatchJob
from atoll.cli.adapt.batch_systems import BatchError, BatchSystem
from atoll_core.errors import UsageError

ANSWER_LIMIT_S: Final = 60.0
"""How long a program of a batch system may take; one that is busy keeps them waiting for ten seconds and more."""


class Batch:
    """Those jobs of this user that carry one name."""

    def __init__(
        self, system: BatchSystem, name: str, worker: Sequence[str], cores: int, options: Sequence[str]
    ) -> None:
        """Set up; raises UsageError where the system's programs are not there.

        Args:
            system: which one, by its template.
            name: of the jobs.
            worker: the command of the workers of a job.
            cores: of a job.
            options: further ones of the program that submits, which take precedence.
        """
        missing = [program for program in system.programs if shutil.which(program) is None]
        if missing:
            raise UsageError(
                f"{missing[0]} was not found; run adapt on a machine from which jobs of {system.title} are submitted"
            )
        self._system = system
        self._places = {"name": name, "cores": str(cores), "user": getpass.getuser()}
        self._script = system.script.replace("{worker}", shlex.join(worker))
        is_parallel = cores > 1 and bool(system.parallel) and system.parallel[0] not in options
        self._submission = (*self._words((*system.submit, *(system.parallel if is_parallel else ()))), *options)

    @property
    def title(self) -> str:
        """What sentences call the system."""
        return self._system.title

    def submit(self) -> str:
        """Submit a job; return its id."""
        said = self._run(self._submission, self._script)
        found = self._system.number.search(said)
        if found is None:
            raise BatchError(f"{self._submission[0]} named no job, but said {said.strip()!r}; try it by hand")
        return found[1]

    def jobs(self) -> list[BatchJob]:
        """Return our jobs that have not ended; of one that changes between listings, the later state."""
        jobs: dict[str, BatchJob] = {}
        for listing in self._system.listings:
            for text, word in listing.read(self._run(self._words(listing.words)), self._places["name"]):
                if found := self._system.number.search(f"Job <{text}>"):
                    state = listing.state or self._system.states.get(word, "pending")
                    jobs[found[1]] = BatchJob(found[1], int(found[1]), state)
        return [*jobs.values()]

    def take_back(self, job: str) -> None:
        """Cancel a job that waits; under Slurm one that has begun meanwhile goes on."""
        self._run(self._words(self._system.take_back, job))

    def drain(self, job: str) -> None:
        """Tell a job's workers to hand over and end."""
        self._run(self._words(self._system.drain, job))

    @property
    def how_to_end(self) -> str:
        """The command that drains all of our jobs."""
        return self._system.how_to_end.format(**self._places)

    def _words(self, words: Sequence[str], job: str = "") -> tuple[str, ...]:
        return tuple(word.format(**self._places, job=job) for word in words)

    def _run(self, words: Sequence[str], given: str = "") -> str:
        """Run a program and return what it prints; raises BatchError."""
        limit = ANSWER_LIMIT_S
        try:
            done = subprocess.run(words, input=given, capture_output=True, text=True, timeout=limit, check=False)
        except subprocess.TimeoutExpired as error:
            hint = f"see whether {self.title} answers"
            raise BatchError(f"{words[0]} did not end within {limit:.0f} s; {hint}") from error
        except OSError as error:
            raise BatchError(f"{words[0]} cannot be run: {(error.strerror or str(error)).lower()}") from error
        if done.returncode != 0:
            if self._system.nothing.search(done.stderr):
                return ""
            lines = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()
            said = lines[-2] if lines[-1] == "Exiting." and len(lines) > 1 else lines[-1]  # so ends Grid Engine
            raise BatchError(f"{words[0]} failed ({said}); the command was: {shlex.join(words)}")
        return done.stdout
