"""``coordinator adapt``, and templates of batch systems: the commands that submit, list, cancel and drain batch jobs.

Commands may contain ``{name}`` (the common name of the jobs), ``{job}`` (the id of a job), ``{cores}`` (the number of
cores of a job) and ``{user}``; scripts contain ``{worker}`` (the command that starts the workers of a job). To add a
batch system, add a template here, and add the environment variable with its job id to `atoll_core.machine`.
"""

import argparse
import getpass
import logging
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from atoll.cli.adapt_policy import AdaptDecision, AdaptLimits, AdaptPolicy, BatchJob, BatchState, Need
from atoll.cli.exit_codes import DONE
from atoll.cli.request import CONNECT_LIMIT_S, bus_address_of
from atoll.client.client import Client, connected
from atoll.terminal.output import note, say
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.logs import configure, fields
from atoll_core.machine import job_of
from atoll_core.signals import stopping
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import WorkerView

DRAIN_S: Final = 60
"""Seconds between the signal that a job should end and its time limit. Slurm may send the signal a minute sooner.
Workers need at most half a minute to hand over their islands (`island-worker --grace`).
"""

Pairs = list[tuple[str, str]]
"""Ids of jobs, with their states as the batch system prints them."""


class BatchError(AtollError):
    """Raised when a program of a batch system fails or does not end; the next call may succeed."""


@dataclass(frozen=True)
class Listing:
    """A command that lists jobs, and how to read its output. If `state` is None, the output has the state of each
    job."""

    words: tuple[str, ...]
    state: BatchState | None = None
    read: Callable[[str, str], Pairs] = lambda text, name: [
        (words[0], words[1] if len(words) > 1 else "") for line in text.splitlines() if (words := line.split())
    ]


@dataclass(frozen=True)
class BatchSystem:
    """A batch system: `title` is its name in messages, `programs` are required.

    `submit` takes the script on stdin, and `number` finds the job's id in its output. The options `parallel` are added
    for more than one core, unless the user's options contain the first word of `parallel`. `states` maps words of
    listings to states; other words mean pending. If a listing fails with a message that matches `nothing`, there are no
    jobs.
    """

    title: str
    programs: tuple[str, ...]
    submit: tuple[str, ...]
    number: re.Pattern[str]
    listings: tuple[Listing, ...]
    take_back: tuple[str, ...]
    drain: tuple[str, ...]
    how_to_end: str
    states: Mapping[str, BatchState] = field(default_factory=dict)
    parallel: tuple[str, ...] = ()
    nothing: re.Pattern[str] = re.compile(r"(?!)")
    script: str = "#!/bin/sh\nexec {worker}\n"


_SIGNALLED: Final = """\
#!/bin/sh
# The batch system may signal every process of the job, but workers end at once on a second SIGTERM. Therefore this
# shell waits for another signal, and then sends one SIGTERM to the parent of the workers.
workers= signalled=
trap 'signalled=yes; [ -z "$workers" ] || kill -TERM "$workers" 2>/dev/null' USR1 USR2
(trap '' USR1 USR2; exec {worker}) &
workers=$!
[ -z "$signalled" ] || kill -TERM "$workers"
wait "$workers" || wait "$workers"
"""

_NUMBER: Final = re.compile(r"(\d+)")


def _grid_engine(text: str, name: str) -> Pairs:
    """Read ``qstat -xml`` of Grid Engine; its tables truncate names. States are letters such as qw, r, dr, Eqw."""
    try:
        jobs = ElementTree.fromstring(text).iter("job_list")
    except ElementTree.ParseError as error:
        raise BatchError(f"qstat -xml did not answer with XML ({error}); check that Grid Engine answers") from None
    pairs = []
    for job in jobs:
        if job.findtext("JB_name") == name:
            letters = set(job.findtext("state") or "")
            state = "d" if "d" in letters else "E" if "E" in letters else "r" if letters & set("rtsST") else "q"
            pairs.append((job.findtext("JB_job_number") or "", state))
    return pairs


def _of_pbs(states: str, state: BatchState) -> Listing:
    return Listing(("qselect", "-u", "{user}", "-N", "{name}", "-s", states), state)


# `exec` makes the job's script the parent of its workers. So a signal that Slurm sends to the batch shell only
# (`scancel --batch`, and `--signal=B:` near the time limit) reaches the parent once; the parent passes it on.
_SLURM: Final = BatchSystem(
    title="Slurm",
    programs=("sbatch", "squeue", "scancel"),
    submit=(
        "sbatch", "--parsable", "--job-name={name}", "--nodes=1", "--ntasks=1", "--cpus-per-task={cores}",
        f"--signal=B:TERM@{DRAIN_S}",
    ),
    number=_NUMBER,  # the cluster's name follows the number
    listings=(Listing(("squeue", "--me", "--noheader", "--name={name}", "--format=%A %T")),),
    take_back=("scancel", "--state=PENDING", "{job}"),
    drain=("scancel", "--batch", "--signal=TERM", "{job}"),
    how_to_end="scancel --me --batch --signal=TERM --name={name}",
    states={
        "COMPLETING": "ending", "COMPLETED": "ending", "CANCELLED": "ending", "FAILED": "ending", "TIMEOUT": "ending",
        "PREEMPTED": "ending", "NODE_FAIL": "ending", "RUNNING": "running", "SUSPENDED": "running",
        "STOPPED": "running",
    },
)  # fmt: skip

_PBS: Final = BatchSystem(
    title="PBS",
    programs=("qsub", "qselect", "qdel", "qsig"),
    submit=("qsub", "-N", "{name}", "-j", "oe", "-l", "select=1:ncpus={cores}"),
    number=_NUMBER,  # the server's name follows the number
    listings=(_of_pbs("HQTW", "pending"), _of_pbs("RSU", "running"), _of_pbs("E", "ending")),
    take_back=("qdel", "{job}"),
    drain=("qsig", "-s", "SIGUSR1", "{job}"),
    how_to_end="qselect -u {user} -N {name} | xargs qsig -s SIGUSR1",
    script=_SIGNALLED,
)

_LSF: Final = BatchSystem(
    title="LSF",
    programs=("bsub", "bjobs", "bkill"),
    submit=("bsub", "-J", "{name}", "-n", "{cores}", "-R", "span[hosts=1]", "-wa", "USR1", "-wt", "2"),
    number=re.compile(r"Job <(\d+)>"),
    listings=(Listing(("bjobs", "-noheader", "-J", "{name}", "-o", "jobid stat")),),
    take_back=("bkill", "{job}"),
    drain=("bkill", "-s", "USR1", "{job}"),
    how_to_end="bkill -s USR1 -J {name} 0",
    states={
        "RUN": "running", "USUSP": "running", "SSUSP": "running", "DONE": "ending", "EXIT": "ending", "ZOMBI": "ending",
    },
    nothing=re.compile(r"is not found|No (unfinished|matching) job"),
    script=_SIGNALLED,
)  # fmt: skip

# Grid Engine has no command that signals a job; with -notify, qdel sends USR2 a minute before it kills the job.
_SGE: Final = BatchSystem(
    title="Grid Engine",
    programs=("qsub", "qstat", "qdel"),
    submit=("qsub", "-terse", "-notify", "-N", "{name}", "-S", "/bin/sh", "-j", "y"),
    number=_NUMBER,
    listings=(Listing(("qstat", "-xml", "-u", "{user}"), None, _grid_engine),),
    take_back=("qdel", "{job}"),
    drain=("qdel", "{job}"),
    how_to_end="qdel {name}",
    states={"r": "running", "d": "ending", "E": "failed"},
    parallel=("-pe", "smp", "{cores}"),
    script=_SIGNALLED,
)

SYSTEMS: Final[Mapping[str, BatchSystem]] = {"slurm": _SLURM, "pbs": _PBS, "lsf": _LSF, "sge": _SGE}
"""Batch systems by the value of ``adapt --batch``."""


ANSWER_LIMIT_S: Final = 60.0
"""Time limit of a program of a batch system, in seconds; a busy system may need more than ten seconds."""


class BatchJobs:
    """All batch jobs of this user that have a common name."""

    def __init__(
        self, system: BatchSystem, name: str, worker: Sequence[str], cores: int, options: Sequence[str]
    ) -> None:
        """Raises UsageError if the programs of the batch system are not installed.

        Args:
            system: template of the batch system.
            name: common name of the jobs.
            worker: the command that starts the workers of a job.
            cores: number of cores of a job.
            options: further options for the program that submits; they take precedence.
        """
        missing = [program for program in system.programs if shutil.which(program) is None]
        if missing:
            raise UsageError(
                f"{missing[0]} was not found; run adapt on a machine where users submit jobs of {system.title}"
            )
        self._system = system
        self._places = {"name": name, "cores": str(cores), "user": getpass.getuser()}
        self._script = system.script.replace("{worker}", shlex.join(worker))
        is_parallel = cores > 1 and bool(system.parallel) and system.parallel[0] not in options
        self._submission = (*self._words((*system.submit, *(system.parallel if is_parallel else ()))), *options)

    @property
    def title(self) -> str:
        """The name of the system in messages."""
        return self._system.title

    def submit(self) -> str:
        """Submit a job; return its id."""
        output = self._run(self._submission, self._script)
        found = self._system.number.search(output)
        if found is None:
            raise BatchError(
                f"{self._submission[0]} printed {output.strip()!r} without the id of a job; try it by hand"
            )
        return found[1]

    def jobs(self) -> list[BatchJob]:
        """Return our jobs that have not ended; if a state changes between listings, the later state is used."""
        jobs: dict[str, BatchJob] = {}
        for listing in self._system.listings:
            for text, word in listing.read(self._run(self._words(listing.words)), self._places["name"]):
                if found := self._system.number.search(f"Job <{text}>"):
                    state = listing.state or self._system.states.get(word, "pending")
                    jobs[found[1]] = BatchJob(found[1], int(found[1]), state)
        return [*jobs.values()]

    def take_back(self, job: str) -> None:
        """Cancel a pending job. With Slurm, a job that has already started continues."""
        self._run(self._words(self._system.take_back, job))

    def drain(self, job: str) -> None:
        """Tell a job's workers to hand over their islands and end."""
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
            hint = f"check that {self.title} answers"
            raise BatchError(f"{words[0]} did not end within {limit:.0f} s; {hint}") from error
        except OSError as error:
            raise BatchError(f"{words[0]} cannot be run: {(error.strerror or str(error)).lower()}") from error
        if done.returncode != 0:
            if self._system.nothing.search(done.stderr):
                return ""
            lines = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
            output = (
                lines[-2] if lines[-1] == "Exiting." and len(lines) > 1 else lines[-1]
            )  # Grid Engine ends with this line
            raise BatchError(f"{words[0]} failed ({output}); the command was: {shlex.join(words)}")
        return done.stdout


_LOG = logging.getLogger(__name__)


def adapt(options: argparse.Namespace) -> int:
    """Keep as many batch jobs as there is work for, until SIGTERM or Ctrl-C; return 0. The batch jobs then continue."""
    if options.minimum > options.maximum:
        raise UsageError(f"--minimum {options.minimum} is more than --maximum {options.maximum}")
    configure(options.log_format, options.log_level)
    address, stop = bus_address_of(options), threading.Event()
    with stopping(stop):
        with connected(address, CONNECT_LIMIT_S) as client:
            name = f"atoll-{client.welcome.realm}"
        given = [*_words(options.sbatch, "--sbatch"), *_words(options.batch_options, "--batch-options")]
        batch = BatchJobs(SYSTEMS[options.batch], name, worker_command(options, address), options.cores, given)
        limits = AdaptLimits(options.minimum, options.maximum, options.cores, options.idle)
        batch.jobs()
        say(
            f"adapt keeps {limits.minimum} to {limits.maximum} jobs of {batch.title} called {name}, {limits.workers} "
            f"workers each, for the coordinator at {address}"
        )
        Adapting(address, batch, AdaptPolicy(limits), options.wait).run(stop, options.interval)
    note(f"coordinator adapt: stopped; its jobs of {batch.title} continue; end them with: {batch.how_to_end}")
    return DONE


def worker_command(options: argparse.Namespace, address: Destination) -> list[str]:
    """Return the command that starts a job's workers; the default program is in the same folder as this program."""
    program = _words(options.worker, "--worker") or [str(Path(sys.executable).with_name("island-worker"))]
    return [*program, "--connect", str(address), "--processes", str(options.cores), "--wait", f"{options.wait:g}"]


def _words(text: str | None, option: str) -> list[str]:
    try:
        return shlex.split(text or "")
    except ValueError as error:
        raise UsageError(f"{option} {text!r} cannot be split into words ({error}); check its quotes") from error


class Adapting:
    """Polls the coordinator and the batch system, and carries out the decisions of the policy.

    Either may be unreachable for `patience_s` seconds; during this time no job is submitted or ended.
    """

    def __init__(self, address: Destination, batch: BatchJobs, policy: AdaptPolicy, patience_s: float) -> None:
        self._address = address
        self._batch = batch
        self._policy = policy
        self._patience_s = patience_s
        self._has_submitted = False
        self._failed_since: float | None = None

    def run(self, stop: threading.Event, interval_s: float) -> None:
        """Poll every `interval_s` seconds until `stop` is set.

        Raises:
            UnreachableError, BatchError: the coordinator or the batch system was unreachable for too long.
            AtollError: several consecutive jobs ended before one of their workers had joined.
        """
        while not stop.is_set():
            try:
                self._poll(time.monotonic())
                self._failed_since = None
            except (UnreachableError, BatchError) as error:
                now = time.monotonic()
                # raised if the error lasts, or if the batch system has never accepted a job with these options
                if isinstance(error, BatchError) and not self._has_submitted:
                    raise error
                if self._failed_since is None:
                    self._failed_since = now
                    _LOG.warning("no job is submitted or ended for now", extra=fields(reason=str(error)))
                elif now - self._failed_since > self._patience_s:
                    raise error
            stop.wait(interval_s)

    def _poll(self, now: float) -> None:
        with connected(self._address, CONNECT_LIMIT_S) as client:
            jobs = self._batch.jobs()
            need = need_of(client, {job.id for job in jobs})
        self._carry_out(self._policy.decide(now, need, jobs), need)

    def _carry_out(self, decision: AdaptDecision, need: Need) -> None:
        for _ in range(decision.submit):
            job = self._batch.submit()
            self._has_submitted = True
            _LOG.info("submitted", extra=fields(batch_job=job, workers_wanted=need.workers))
        self._end(decision.take_back, self._batch.take_back, "cancelled", need)
        self._end(decision.drain, self._batch.drain, "asked to drain", need)

    def _end(self, jobs: Sequence[str], end: Callable[[str], None], done: str, need: Need) -> None:
        """End each of these jobs. A failure usually means that a job has just ended; if not, the next poll tries
        again."""
        for job in jobs:
            try:
                end(job)
                _LOG.info(done, extra=fields(batch_job=job, workers_wanted=need.workers))
            except BatchError as error:
                self._policy.forget(job)
                _LOG.warning("not ended", extra=fields(batch_job=job, reason=str(error)))


def need_of(client: Client, jobs: set[str]) -> Need:
    """Return the coordinator's need for workers; `jobs` are the ids of our batch jobs."""
    depth, workers = client.queue_depth(), [view for view in client.workers() if view.state not in ("lost", "leaving")]
    ours = {job: _islands(workers, job) for job in {job_of(view.worker) for view in workers} & jobs if job is not None}
    others = sum(job_of(view.worker) not in jobs for view in workers)
    return Need(depth.workers_wanted, others, ours)


def _islands(workers: Sequence[WorkerView], job: str) -> int:
    return sum(view.islands for view in workers if job_of(view.worker) == job)
