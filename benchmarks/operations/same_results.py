"""Whether two revisions find and say the same: sixty small jobs by both, compared in all that is written and printed.

``python -m benchmarks.operations.same_results REVISION`` (``make compare REVISION=… RESULTS=1``) runs the jobs of
``small_jobs`` by this working tree and by another revision, each in an environment of its own with the same versions of
packages, and says for each job that both are equal, or where they differ. ``--record FILE`` keeps what this tree found
and goes on with a file that exists; ``--against FILE`` compares with such a file instead of a revision. Ends with 1
where anything differs.
"""

import hashlib
import json
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, Final

from atoll.terminal.output import note, say
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.signals import raising_interrupts
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.journal import Journal, read
from benchmarks.harness.service import Machines
from benchmarks.operations.differences import Difference, differences, masked, masked_line, report, without_progress
from benchmarks.operations.side_by_side import FOLDER, TREE, program_of
from benchmarks.operations.small_jobs import JOBS, files_of, write_files

NAME: Final = "same_results"
PACKAGES: Final = ("atoll", "atoll_coordinator", "atoll_island_worker")


@dataclass(frozen=True)
class Found:
    """What one job found, as it was written and printed.

    `given` is a hash of its words and files, `sources` one of the code that ran it. `printed` went to stdout,
    `messages` to stderr.
    """

    job: str
    given: str
    sources: str
    exit_code: int
    printed: list[str]
    messages: list[str]
    result: dict[str, Any]

    @property
    def key(self) -> str:
        """The job."""
        return self.job

    def compared(self) -> dict[str, Any]:
        """Return what is to be the same by another revision."""
        printed = [masked_line(line) for line in self.printed]
        messages = without_progress(self.messages)
        compared = {"given": self.given, "exit_code": self.exit_code, "printed": printed, "messages": messages}
        return {"digest": self.result.get("digest"), **compared, "result": masked(self.result)}


@dataclass(frozen=True)
class Side:
    """A tree's program, the hash of its code, and the folder of the jobs' files."""

    program: Path
    sources: str
    files: Path

    def given(self, job: str) -> str:
        """Return the hash of a job's words and files."""
        words = JOBS[job]
        return _hash([json.dumps(words).encode(), *((self.files / file).read_bytes() for file in files_of(words))])

    def run(self, job: str, address: str) -> Found:
        """Have a job done by the service at `address`, from a folder of its own, so that all trees see the same paths.

        Raises AtollError where the service is not there any more.
        """
        with TemporaryDirectory(prefix="atoll-same-") as name:
            folder = Path(name)
            for file in files_of(JOBS[job]):
                shutil.copyfile(self.files / file, folder / file)
            number = f"same-{list(JOBS).index(job)}"
            command = [str(self.program), "submit", *JOBS[job], "--id", number, "--out", "out", "--connect", address]
            ended = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
            if ended.returncode == UnreachableError.exit_code:
                raise AtollError(f"{job}: {ended.stderr.strip()[-300:]}")
            path = folder / "out/result.json"
            written = path.read_text("utf-8") if path.exists() else "{}"
        printed, messages, result = (text.replace(address, "ADDRESS") for text in (ended.stdout, ended.stderr, written))
        code, lines = ended.returncode, (printed.splitlines(), messages.splitlines())
        return Found(job, self.given(job), self.sources, code, *lines, json.loads(result))


@contextmanager
def serving(program: Path) -> Iterator[str]:
    """Start a coordinator and one worker of a tree, and yield the address; both end with the block.

    A service of its own for each job would spend most of its time on loading kernels.
    """
    with TemporaryDirectory(prefix="atoll-same-") as folder:
        machines = Machines(Path(folder), 1, programs=program.parent)
        try:
            machines.open()
            yield machines.address
        finally:
            machines.close()


def side_of(program: Path, files: Path) -> Side:
    """Return the side of a program; raises AtollError where its packages are not found."""
    code = f"import {', '.join(PACKAGES)}\nfor package in ({', '.join(PACKAGES)}): print(package.__path__[0])"
    asked = subprocess.run(
        [str(program.parent / "python"), "-c", code], cwd=files, capture_output=True, text=True
    )  # elsewhere: folders of this tree are not the packages of another revision
    if asked.returncode:
        raise AtollError(f"the packages of {program} cannot be imported: {asked.stderr.strip()[-300:]}")
    folders = [Path(line) for line in asked.stdout.splitlines()]
    return Side(program, _hash(_sources(folders)), files)


def _sources(folders: Iterable[Path]) -> Iterator[bytes]:
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            yield str(path.relative_to(folder)).encode()
            yield path.read_bytes()


def _hash(parts: Iterable[bytes]) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:16]


def journal_of(side: Side, path: Path | None, words: Sequence[str]) -> Journal[Found]:
    """Begin a file of what a side finds, or go on with it; raises UsageError where other code has written it."""
    journal = Journal(NAME, Found, path, words, resume=path is not None and path.exists())
    if any(outcome.sources != side.sources for outcome in journal.outcomes.values()):
        raise UsageError(f"{path} holds what another state of the code found; name another file with --record")
    return journal


def run_all(side: Side, names: Sequence[str], journal: Journal[Found], processes: int) -> None:
    """Run the jobs that the journal does not have, or has with other words or files."""
    known, free = journal.outcomes, SimpleQueue[str]()
    missing = [name for name in names if name not in known or known[name].given != side.given(name)]
    note(f"{len(names)} jobs, {len(names) - len(missing)} of them done before")

    def run_job(job: str) -> Found:
        address = free.get()
        try:
            return side.run(job, address)
        finally:
            free.put(address)

    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(processes))
        for _ in range(min(processes, len(missing))):
            free.put(stack.enter_context(serving(side.program)))
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)  # before services end, and what runs with them
        for number, ended in enumerate(as_completed([pool.submit(run_job, name) for name in missing]), start=1):
            journal.add(ended.result())
            note(f"{number} of {len(missing)}: {told(ended.result())}")


def told(outcome: Found) -> str:
    """Return how a job ended."""
    seconds, search = (outcome.result.get(key, 0.0) for key in ("seconds", "search_seconds"))
    return f"{outcome.job}: {seconds:.1f} s, of search {search:.1f} s, exit code {outcome.exit_code}"


def compare(ours: Mapping[str, Found], theirs: Mapping[str, Found]) -> dict[str, list[Difference]]:
    """Return where the two differ, by job of ours; a job that theirs do not have differs as a whole."""
    return {
        name: list(differences(outcome.compared(), theirs[name].compared() if name in theirs else None))
        for name, outcome in ours.items()
    }


def other_versions(ours: Mapping[str, Found], theirs: Mapping[str, Found]) -> list[str]:
    """Return which versions of packages differ; where some do, results may."""
    pairs = [
        (outcome.result.get("versions"), theirs[name].result.get("versions"))
        for name, outcome in ours.items()
        if name in theirs
    ]
    return list(dict.fromkeys(difference.shown(40) for pair in pairs for difference in differences(*pair)))


def summed(by_job: Mapping[str, Sequence[Difference]], places: int) -> str:
    """Return a report of each job, and how many differ."""
    differing = [job_differences for job_differences in by_job.values() if job_differences]
    digests = sum(difference.place in ("", "digest") for job_differences in differing for difference in job_differences)
    lines = [report(name, job_differences, places) for name, job_differences in by_job.items()]
    return "\n".join([*lines, f"\n{len(differing)} of {len(by_job)} jobs differ, {digests} of them in their digests"])


@program(
    f"benchmarks.operations.{NAME}",
    __doc__,
    option("revision", nargs="?", help="commit, tag or branch to compare with"),
    option("--other", default=TREE, help="what is compared with it, a revision too (%(default)s)"),
    option("--record", type=Path, metavar="FILE", help="keep what OTHER found; gone on with if it exists"),
    option("--against", type=Path, metavar="FILE", help="compare with what --record has written"),
    option("--strogatz", type=Path, help="folder of the Strogatz label files; else such are made"),
    option("--only", help="jobs whose name contains this"),
    option("--processes", type=whole, default=2, help="jobs at a time (%(default)s)"),
    option("--places", type=whole, default=5, help="differences shown of a job (%(default)s)"),
)
def main(options: Namespace) -> int:
    """Run, record and compare; return 1 when anything differs, else 0."""
    if not (options.revision or options.record or options.against):
        raise UsageError("nothing to compare with; name a revision, --against FILE or --record FILE")
    with raising_interrupts(), TemporaryDirectory(prefix="atoll-same-") as name:
        FOLDER.mkdir(parents=True, exist_ok=True)
        names, files = _chosen(options.only), Path(name)
        write_files(files, {file for job in names for file in files_of(JOBS[job])}, options.strogatz)
        ours = _found(options.other, options.record, names, files, options)
        if options.against:
            theirs = read(options.against, Found)
        elif options.revision:
            theirs = _found(options.revision, None, names, files, options)
        else:
            return 0
    by_job = compare(ours, theirs)
    for version in other_versions(ours, theirs):
        note(f"versions differ: {version}")
    say(summed(by_job, options.places))
    return int(any(by_job.values()))


def _chosen(word: str | None) -> list[str]:
    names = [name for name in JOBS if word is None or word in name]
    if not names:
        raise UsageError(f"no job has {word!r} in its name; the first of {len(JOBS)} is {next(iter(JOBS))!r}")
    return names


def _found(
    revision: str, record: Path | None, names: Sequence[str], files: Path, options: Namespace
) -> dict[str, Found]:
    side = side_of(program_of(revision), files)
    journal = journal_of(side, record, options.words)
    note(f"{revision}, code {side.sources}")
    run_all(side, names, journal, options.processes)
    return {name: journal.outcomes[name] for name in names}


if __name__ == "__main__":
    sys.exit(main())
