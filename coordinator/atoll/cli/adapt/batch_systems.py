"""Templates of batch systems: how a job with workers is submitted, listed, taken back and drained.

Words may have ``{name}`` of the jobs, ``{job}`` the id of one, ``{cores}`` of each and ``{user}``; scripts have
``{worker}``, the command of a job's workers. To add a system, add a template here and the variable of its job ids to
`atoll_core.machine`.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from atoll.cli.adapt.adapt_policy import BatchState
from atoll_core.errors import AtollError

DRAIN_S: Final = 60
"""How long before its time limit a job is told to end, and up to a minute sooner, as Slurm says: handing over takes
half a minute at most (`island-worker --grace`)."""

Pairs = list[tuple[str, str]]
"""Ids of jobs, with what the system says of their state."""


class BatchError(AtollError):
    """Raised when a program of a batch system fails or does not end; it may be different the next time."""


@dataclass(frozen=True)
class Listing:
    """A command that lists jobs, and how its output is read; `state` is that of all of them, None: as it says."""

    words: tuple[str, ...]
    state: BatchState | None = None
    read: Callable[[str, str], Pairs] = lambda text, name: [
        (words[0], words[1] if len(words) > 1 else "") for line in text.splitlines() if (words := line.split())
    ]


@dataclass(frozen=True)
class BatchSystem:
    """A batch system: `title` is what sentences call it, `programs` those that have to be there.

    `submit` takes the script on stdin, and `number` finds the job's id in its answer; `parallel` is added for more than
    one core unless the user's options have its first word. `states` are by what listings say, a state that is not there
    is pending. What fails with a text like `nothing` has listed no job.
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
# The system may signal every process of the job, and to a second SIGTERM workers end at once: so a shell beside them
# waits for another signal and tells their parent alone.
workers= told=
trap 'told=yes; [ -z "$workers" ] || kill -TERM "$workers" 2>/dev/null' USR1 USR2
(trap '' USR1 USR2; exec {worker}) &
workers=$!
[ -z "$told" ] || kill -TERM "$workers"
wait "$workers" || wait "$workers"
"""

_NUMBER: Final = re.compile(r"(\d+)")


def _grid_engine(text: str, name: str) -> Pairs:
    """Read ``qstat -xml`` of Grid Engine, whose tables cut names off; its states are letters: qw, r, dr, Eqw."""
    try:
        jobs = ElementTree.fromstring(text).iter("job_list")
    except ElementTree.ParseError as error:
        raise BatchError(f"qstat -xml did not answer with XML ({error}); see whether Grid Engine answers") from None
    pairs = []
    for job in jobs:
        if job.findtext("JB_name") == name:
            letters = set(job.findtext("state") or "")
            state = "d" if "d" in letters else "E" if "E" in letters else "r" if letters & set("rtsST") else "q"
            pairs.append((job.findtext("JB_job_number") or "", state))
    return pairs


def _of_pbs(states: str, state: BatchState) -> Listing:
    return Listing(("qselect", "-u", "{user}", "-N", "{name}", "-s", states), state)


# A job's script becomes the parent of its workers. So what Slurm signals to the batch shell alone (`scancel --batch`,
# and `--signal=B:` when the time limit is near) reaches that parent once, which passes it on.
_SLURM: Final = BatchSystem(
    title="Slurm",
    programs=("sbatch", "squeue", "scancel"),
    submit=(
        "sbatch", "--parsable", "--job-name={name}", "--nodes=1", "--ntasks=1", "--cpus-per-task={cores}",
        f"--signal=B:TERM@{DRAIN_S}",
    ),
    number=_NUMBER,  # behind it is the cluster's name
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
    number=_NUMBER,  # behind it is the server's name
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

# Grid Engine signals no job: with -notify, qdel sends USR2 a minute before it kills.
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
"""By the word of ``adapt --batch``."""
