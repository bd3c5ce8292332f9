"""Two revisions side by side: the same jobs in turn, how long each takes, and whether both find the same.

``python -m benchmarks.operations.side_by_side REVISION`` (``make compare REVISION=…``) compares this working tree with
another revision, or with --other two revisions. Each revision has a git worktree and an environment of its own in
``build/compare``, with the versions of packages of this environment, so that the code alone differs; both stay for
the next time. Jobs take turns, so that both see the same load; where other programs want the cores, processor seconds
say more than the clock. Ends with 1 where a digest differs.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, Final

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_core.errors import AtollError, UsageError
from benchmarks.first_hour.tables import csv_of
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.systems import SYSTEMS, TABLE_III, trajectories
from benchmarks.peers.strogatz_files import LABEL, NAMES

FOLDER: Final = Path("build/compare")
TREE: Final = "this tree"
EXAMPLES: Final[dict[str, tuple[str, ...]]] = {
    "example lotka_volterra": ("examples/lotka_volterra.csv",),
    "example pendulum": ("examples/pendulum.csv", "--order", "2"),
}
"""Whole jobs, beside the label jobs: they are prepared, searched and refined."""

TIMES: Final = ("search", "command", "processor")
"""Those of `Took`."""

_LEAST_S: Final = 1e-3
"""Times below this count as this: clocks say no more."""


@dataclass(frozen=True)
class Took:
    """What one job took and found: seconds of search, from command to prompt, and of all its processes' computing."""

    search: float
    command: float
    processor: float
    digest: str
    equations: tuple[str, ...]
    point_evaluations: int


@dataclass(frozen=True)
class Beside:
    """One job by both revisions: medians, and whether digests and equations are equal."""

    job: str
    ours: Took
    theirs: Took

    @property
    def is_same(self) -> bool:
        """Whether both searches found the same bits."""
        return self.ours.digest == self.theirs.digest

    def ratio(self, what: str) -> float:
        """Return ours over theirs of one of the times of `Took`."""
        ours, theirs = (max(float(getattr(side, what)), _LEAST_S) for side in (self.ours, self.theirs))
        return ours / theirs


def program_of(revision: str) -> Path:
    """Return the ``coordinator`` of a revision, in an environment of its own, which is made when there is none.

    Raises UsageError where there is no such revision, AtollError where its environment cannot be made.
    """
    if revision == TREE:
        return Path(sys.executable).parent / "coordinator"
    named = subprocess.run(
        ["git", "rev-parse", "--short=12", "--verify", f"{revision}^{{commit}}"], capture_output=True, text=True
    )
    if named.returncode:
        raise UsageError(f"there is no revision {revision!r} here; name a commit, a tag or a branch")
    folder = FOLDER.absolute() / named.stdout.strip()
    program = folder / ".venv/bin/coordinator"
    if not program.exists():
        _make(folder, named.stdout.strip())
    return program


def _make(folder: Path, revision: str) -> None:
    note(f"making the environment of {revision} in {folder} (once, about a minute)")
    if not folder.exists():
        _done(["git", "worktree", "prune"])
        _done(["git", "worktree", "add", "--detach", str(folder), revision])
    pinned = FOLDER.absolute() / "constraints.txt"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    pinned.write_text(_done([*pip, "freeze", "--exclude-editable"]), encoding="utf-8")
    _done([sys.executable, "-m", "venv", str(folder / ".venv")])
    _done([str(folder / ".venv/bin/python"), *pip[1:], "install", "-q", "-c", str(pinned), "-e", str(folder)])


def _done(command: Sequence[str]) -> str:
    """Run a command and return what it printed; raises AtollError."""
    ended = subprocess.run(command, capture_output=True, text=True)
    if ended.returncode:
        raise AtollError(f"{' '.join(command)} ended with {ended.returncode}: {ended.stderr.strip()[-500:]}")
    return ended.stdout


def write_labels(folder: Path) -> Iterator[tuple[str, Path]]:
    """Write the 14 equations of the paper's systems as label files: both states, and an exact derivative."""
    for system in TABLE_III:
        sampled = trajectories(system)
        states = np.concatenate(sampled.values).T
        columns = dict(zip(sampled.names, states, strict=True))
        for name, slopes in zip(sampled.names, SYSTEMS[system].field(states[0], states[1]), strict=True):
            path = folder / f"{system}-{name}.csv"
            path.write_text(csv_of({LABEL: np.asarray(slopes), **columns}, {}), encoding="utf-8")
            yield path.stem, path


def jobs(folder: Path, strogatz: Path | None, seeds: Sequence[int]) -> dict[str, tuple[str, ...]]:
    """Return the options of all jobs by name: labels with each of `seeds`, then examples.

    Labels are those of the folder `strogatz` where it is given, else they are written into `folder`.
    """
    files = [(name, strogatz / f"{name}.csv") for name in NAMES] if strogatz else list(write_labels(folder))
    labels = {
        f"{name} seed {seed}": (str(path.absolute()), "--target", LABEL, "--seed", str(seed))
        for seed in seeds
        for name, path in files
    }
    return labels | {name: (str(Path(words[0]).absolute()), *words[1:]) for name, words in EXAMPLES.items()}


def run(program: Path, options: Sequence[str], folder: Path) -> Took:
    """Run one job by the ``coordinator`` of a revision; raises AtollError where it fails."""
    command = [str(program), "run", *options, "--workers", "2", "--json", "--out", str(folder)]
    with TemporaryFile("w+") as printed, TemporaryFile("w+") as messages:
        begun = time.monotonic()
        process = subprocess.Popen(  # elsewhere: folders of this tree are not the packages of another revision
            command, cwd=folder.parent, stdin=subprocess.DEVNULL, stdout=printed, stderr=messages
        )
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.monotonic() - begun
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        messages.seek(0)
        if process.returncode not in (0, 4):
            raise AtollError(f"{' '.join(command)} ended with {process.returncode}: {messages.read().strip()[-500:]}")
        result: Mapping[str, Any] = json.load(printed)
    return Took(
        search=result["search_seconds"],
        command=seconds,
        processor=used.ru_utime + used.ru_stime,
        digest=str(result["digest"]),
        equations=tuple(str(equation["expression"]) for equation in result["equations"]),
        point_evaluations=result["point_evaluations"],
    )


def in_turn(
    names: Sequence[str],
    ours: Callable[[str], Took],
    theirs: Callable[[str], Took],
    rounds: int,
    has_time: Callable[[], bool],
) -> list[Beside]:
    """Run all jobs by both, so many rounds, as long as it `has_time`; who begins changes from job to job.

    A job that both have not run is left out.
    """
    runs: dict[str, tuple[list[Took], list[Took]]] = {}
    turn = count()
    for name in [name for _ in range(rounds) for name in names]:
        if not has_time():
            break
        pair = (ours, theirs) if next(turn) % 2 == 0 else (theirs, ours)
        took = [side(name) for side in pair]
        mine, others = took if pair[0] is ours else reversed(took)
        note(f"{name}: search {mine.search:.3f} s, theirs {others.search:.3f} s")
        runs.setdefault(name, ([], []))[0].append(mine)
        runs[name][1].append(others)
    return [Beside(name, median(mine), median(others)) for name, (mine, others) in runs.items()]


def median(runs: Sequence[Took]) -> Took:
    """Return the medians of the times; all else is the first's, and the digest says so where it was not the same."""
    times = {what: statistics.median(getattr(run, what) for run in runs) for what in TIMES}
    return replace(runs[0], **times, digest=" ".join(dict.fromkeys(run.digest for run in runs)))


def shown(jobs_run: Sequence[Beside]) -> str:
    """Return a row for each job, and the geometric means."""
    rows = [
        (
            job.job,
            *(cell for what in TIMES for cell in _cells(job, what)),
            "same" if job.is_same else "DIFFERS",
            "same" if job.ours.equations == job.theirs.equations else "DIFFER",
        )
        for job in jobs_run
    ]
    means = ("geometric mean", *(cell for what in TIMES for cell in _means(jobs_run, what)))
    heads = ("job", "search s", "theirs", "ratio", "command s", "theirs", "ratio", "cpu s", "theirs", "ratio")
    return table((*heads, "digest", "equations"), [*rows, (*means, "", "")])


def _cells(job: Beside, what: str) -> tuple[str, str, str]:
    return f"{getattr(job.ours, what):.3f}", f"{getattr(job.theirs, what):.3f}", f"{job.ratio(what):.2f}"


def _means(jobs_run: Sequence[Beside], what: str) -> tuple[str, str, str]:
    mine, others = (
        statistics.geometric_mean(max(getattr(side, what), _LEAST_S) for side in sides)
        for sides in ([job.ours for job in jobs_run], [job.theirs for job in jobs_run])
    )
    return f"{mine:.3f}", f"{others:.3f}", f"{mine / others:.3f}"


@program(
    "benchmarks.operations.side_by_side",
    __doc__,
    option("revision", help="commit, tag or branch to compare with"),
    option("--other", default=TREE, help="what is compared with it, a revision too (%(default)s)"),
    option("--strogatz", type=Path, help="folder with the Strogatz label files; else files like them are made"),
    option("--seeds", type=whole, default=2, help="searches of each label file (%(default)s)"),
    option("--rounds", type=whole, default=3, help="how often each job is run by both (%(default)s)"),
    option("--minutes", type=positive, default=10.0, help="no job begins after so many (%(default)g)"),
    option("--only", help="jobs whose name contains this"),
    OUT,
)
def main(options: Namespace) -> int:
    """Compare, print the table; return 1 when a digest differs, else 0."""
    with TemporaryDirectory(prefix="atoll-compare-") as name:
        FOLDER.mkdir(parents=True, exist_ok=True)
        programs = [program_of(revision) for revision in (options.other, options.revision)]
        chosen = jobs(Path(name), options.strogatz, range(options.seeds))
        kept = [job for job in chosen if options.only is None or options.only in job]
        if not kept:
            raise UsageError(
                f"no job has {options.only!r} in its name; the first of {len(chosen)} is {next(iter(chosen))!r}"
            )
        folders = count()
        record = Record("side_by_side", options.words, options.out)

        def runner(program: Path) -> Callable[[str], Took]:
            return lambda job: run(program, chosen[job], Path(name) / f"run-{next(folders)}")

        ours, theirs = map(runner, programs)
        note("kernels are compiled, and files read, before times are taken")
        for side in (ours, theirs):
            side(kept[0])
        end = time.monotonic() + 60.0 * options.minutes
        jobs_run = in_turn(kept, ours, theirs, options.rounds, lambda: time.monotonic() < end)
        if not jobs_run:
            raise UsageError(f"no job ended within {options.minutes:g} minutes; give --minutes more")
        record.write(jobs=[asdict(job) for job in jobs_run])
    say(shown(jobs_run))
    differing = sum(not job.is_same for job in jobs_run)
    say(
        f"\n{options.other} beside {options.revision}: {differing} of {len(jobs_run)} digests differ; load {load():.1f}"
    )
    if len(jobs_run) < len(kept):
        say(f"left out for lack of time: {len(kept) - len(jobs_run)} of {len(kept)} jobs")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
