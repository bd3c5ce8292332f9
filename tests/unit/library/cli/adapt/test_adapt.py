"""Slurm's programs are called as they want to be, and a failure of either side is borne for a while."""

import argparse
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from atoll.cli import adapt as verb
from atoll.cli.adapt import SYSTEMS, Adapting, BatchError, BatchJobs, need_of
from atoll.cli.adapt_policy import AdaptLimits, AdaptPolicy, BatchJob, Need
from atoll.cli.main import main
from atoll_core.errors import UnreachableError, UsageError
from atoll_core.wire.addresses import destination
from atoll_core.wire.messages.clients import QueueDepth
from atoll_core.wire.messages.views import WorkerState, WorkerView

PROGRAM = """#!/bin/sh
for word in "$(basename "$0")" "$@"; do printf '%s\\n' "$word"; done >>"{folder}/called"
case "$(basename "$0")" in *sub|sbatch) cat >"{folder}/script";; esac
cat "{folder}/answer-$(basename "$0")"
exit "$(cat "{folder}/code")"
"""


class FakeBatch:
    """Programs of the systems' names that note how they are called, and answer what they are told to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in sorted({program for system in SYSTEMS.values() for program in system.programs}):
            (folder / name).write_text(PROGRAM.format(folder=folder))
            (folder / name).chmod(0o755)
            self.answer(name, "")
        self.code(0)

    def answer(self, program: str, text: str) -> None:
        (self.folder / f"answer-{program}").write_text(text)

    def code(self, code: int) -> None:
        (self.folder / "code").write_text(str(code))

    def called(self) -> list[str]:
        words = (self.folder / "called").read_text().splitlines()
        (self.folder / "called").unlink()
        return words


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeBatch:
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    return FakeBatch(tmp_path)


@pytest.fixture
def slurm(programs: FakeBatch) -> BatchJobs:
    return BatchJobs(SYSTEMS["slurm"], "atoll-abc", ["island-worker", "--name", "a b"], 8, ["--partition=idle"])


def view(worker: str, islands: int = 0, state: WorkerState = "computing") -> WorkerView:
    return WorkerView(worker=worker, host="h", pid=1, state=state, islands=islands, silent=0.0, version="0")


class FakeClient:
    """A coordinator's answers."""

    welcome = argparse.Namespace(realm="abc")

    def __init__(self, wanted: int, *workers: WorkerView) -> None:
        self._wanted = wanted
        self._workers = workers

    def queue_depth(self) -> QueueDepth:
        return QueueDepth(
            queued=0, preparing=0, running=1, refining=0, tasks_ready=self._wanted, workers_wanted=self._wanted
        )

    def workers(self) -> tuple[WorkerView, ...]:
        return self._workers


def test_what_waits_is_cancelled_and_what_runs_is_told_once(slurm: BatchJobs, programs: FakeBatch) -> None:
    slurm.take_back("7")
    assert programs.called() == ["scancel", "--state=PENDING", "7"]
    slurm.drain("8")
    assert programs.called() == ["scancel", "--batch", "--signal=TERM", "8"]


SUBMISSIONS = {
    "pbs": ("qsub", "123.server\n", ["-N", "atoll-abc", "-j", "oe", "-l", "select=1:ncpus=8", "-q", "idle"]),
    "lsf": (
        "bsub", "Job <123> is submitted to queue <normal>.\n",
        ["-J", "atoll-abc", "-n", "8", "-R", "span[hosts=1]", "-wa", "USR1", "-wt", "2", "-q", "idle"],
    ),
    "sge": (
        "qsub", "123\n",
        ["-terse", "-notify", "-N", "atoll-abc", "-S", "/bin/sh", "-j", "y", "-pe", "smp", "8", "-q", "idle"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("system", SUBMISSIONS)
def test_other_systems_are_submitted_to_by_their_own_words(system: str, programs: FakeBatch) -> None:
    program, answer, words = SUBMISSIONS[system]
    programs.answer(program, answer)
    batch = BatchJobs(SYSTEMS[system], "atoll-abc", ["island-worker", "--name", "a b"], 8, ["-q", "idle"])
    assert batch.submit() == "123"
    assert programs.called() == [program, *words]
    assert "exec island-worker --name 'a b') &\n" in (programs.folder / "script").read_text()


GRID = """<?xml version='1.0'?>
<job_info><queue_info>
  <job_list state="running"><JB_job_number>7</JB_job_number><JB_name>atoll-abc</JB_name><state>r</state></job_list>
  <job_list state="running"><JB_job_number>8</JB_job_number><JB_name>atoll-abc</JB_name><state>dr</state></job_list>
  <job_list state="running"><JB_job_number>5</JB_job_number><JB_name>other</JB_name><state>r</state></job_list>
</queue_info><job_info>
  <job_list state="pending"><JB_job_number>9</JB_job_number><JB_name>atoll-abc</JB_name><state>qw</state></job_list>
  <job_list state="pending"><JB_job_number>10</JB_job_number><JB_name>atoll-abc</JB_name><state>Eqw</state></job_list>
</job_info></job_info>
"""


def test_other_systems_list_their_jobs(programs: FakeBatch) -> None:
    programs.answer("bjobs", "7 RUN\n8 EXIT\n9 PEND\n")
    programs.answer("qstat", GRID)
    expected = {"7": "running", "8": "ending", "9": "pending"}
    for system, more in (("lsf", {}), ("sge", {"10": "failed"})):
        batch = BatchJobs(SYSTEMS[system], "atoll-abc", ["island-worker"], 1, [])
        assert {job.id: job.state for job in batch.jobs()} == expected | more
    programs.called()
    programs.answer("qselect", "7.server\n")
    jobs = BatchJobs(SYSTEMS["pbs"], "atoll-abc", ["island-worker"], 1, []).jobs()
    assert [(job.id, job.state) for job in jobs] == [("7", "ending")]
    asked = programs.called()
    assert [asked[place + 1] for place, word in enumerate(asked) if word == "-s"] == ["HQTW", "RSU", "E"]
    programs.answer("qstat", "error: commlib")
    with pytest.raises(BatchError, match="qstat -xml did not answer with XML"):
        BatchJobs(SYSTEMS["sge"], "atoll-abc", ["island-worker"], 1, []).jobs()


@pytest.mark.parametrize(
    ("system", "drained", "ends"),
    [
        ("pbs", ["qsig", "-s", "SIGUSR1", "8"], "| xargs qsig -s SIGUSR1"),
        ("lsf", ["bkill", "-s", "USR1", "8"], "bkill -s USR1 -J atoll-abc 0"),
        ("sge", ["qdel", "8"], "qdel atoll-abc"),
    ],
)
def test_jobs_of_other_systems_are_drained(system: str, drained: list[str], ends: str, programs: FakeBatch) -> None:
    batch = BatchJobs(SYSTEMS[system], "atoll-abc", ["island-worker"], 1, [])
    batch.drain("8")
    assert programs.called() == drained
    assert batch.how_to_end.endswith(ends)


@pytest.mark.parametrize("signal_number", [signal.SIGUSR1, signal.SIGUSR2])
def test_a_signal_to_every_process_of_a_job_tells_the_workers_once(signal_number: int, tmp_path: Path) -> None:
    """The worker is a stand-in: it notes SIGTERM, and a signal that was meant for the shell would end it."""
    worker = tmp_path / "worker"
    worker.write_text("#!/bin/sh\ntrap 'echo told; exit 0' TERM\necho ready\nwhile :; do sleep 0.05; done\n")
    worker.chmod(0o755)
    script = SYSTEMS["pbs"].script.replace("{worker}", str(worker))
    job = subprocess.Popen(["sh", "-c", script], stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert job.stdout is not None
    assert job.stdout.readline() == "ready\n"
    os.killpg(job.pid, signal_number)
    assert job.communicate(timeout=20)[0] == "told\n"
    assert job.returncode == 0


def test_a_program_that_fails_is_quoted(slurm: BatchJobs, programs: FakeBatch) -> None:
    programs.answer("sbatch", "sbatch: error: invalid partition\n")
    programs.code(1)
    with pytest.raises(
        BatchError, match=r"sbatch failed \(sbatch: error: invalid partition\); the command was: sbatch"
    ):
        slurm.submit()


def test_without_slurm_the_missing_program_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="sbatch was not found; run adapt on a machine where"):
        BatchJobs(SYSTEMS["slurm"], "atoll-abc", ["island-worker"], 1, [])


@pytest.mark.parametrize(
    "words", [["--maximum", "2", "--minimum", "3"], ["--maximum", "2", "--sbatch", "'a"], ["--maximum", "-1"], []]
)
def test_bad_options_are_one_sentence(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def connected(*_: object) -> Iterator[FakeClient]:
        yield FakeClient(0)

    monkeypatch.setattr(verb, "connected", connected)
    assert main(["adapt", "--connect", "tcp/h:1", *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_workers_of_other_origin_are_told_apart_and_those_that_go_do_not_count() -> None:
    client = FakeClient(
        9, view("n-slurm7-1-0", 2), view("n-slurm7-1-1", 3), view("n-slurm8-1", 1), view("lab", 2),
        view("n-slurm7-9", 0, "lost"), view("n-slurm5-9", 1, "leaving"),
    )  # fmt: skip
    assert need_of(client, {"7"}) == Need(workers=9, others=2, islands={"7": 5})  # type: ignore[arg-type]


class Breaking:
    """A Slurm that fails as long as it is told to."""

    def __init__(self) -> None:
        self.fails = False
        self.submitted = 0
        self.gone: set[str] = set()
        self.drained: list[str] = []

    def jobs(self) -> list[BatchJob]:
        return [BatchJob(str(number), number, "running") for number in range(self.submitted)]

    def take_back(self, job: str) -> None:
        raise AssertionError(f"job {job} runs")

    def drain(self, job: str) -> None:
        if self.fails or job in self.gone:
            raise BatchError("denied: the job does not exist")
        self.drained.append(job)

    def submit(self) -> str:
        if self.fails:
            raise BatchError("sbatch failed")
        self.submitted += 1
        return str(self.submitted)


class Looks:
    """So many looks, a second apart, with a coordinator that may be away."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, slurm: Breaking, patience_s: float) -> None:
        self.wanted = 1
        self.is_away = False
        self.now = 0.0
        monkeypatch.setattr(verb.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(verb, "connected", self._connected)
        self._adapting = Adapting(destination("tcp/h:1"), slurm, AdaptPolicy(AdaptLimits(0, 9, 1, 50.0)), patience_s)  # type: ignore[arg-type]

    @contextmanager
    def _connected(self, *_: object) -> Iterator[FakeClient]:
        if self.is_away:
            raise UnreachableError("no coordinator answers")
        yield FakeClient(self.wanted)

    def look(self, times: int) -> None:
        stop, left = threading.Event(), [times]

        def wait(_: float) -> bool:
            self.now += 1.0
            left[0] -= 1
            if not left[0]:
                stop.set()
            return True

        stop.wait = wait  # type: ignore[method-assign,assignment]
        self._adapting.run(stop, 1.0)


def test_a_slurm_that_never_accepted_a_job_ends_it_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    slurm = Breaking()
    slurm.fails = True
    with pytest.raises(BatchError):
        Looks(monkeypatch, slurm, 100.0).look(1)


def test_slurm_or_the_coordinator_may_be_away_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    slurm = Breaking()
    looks = Looks(monkeypatch, slurm, 10.0)
    looks.look(3)
    assert slurm.submitted == 1
    looks.is_away = True
    looks.look(9)
    looks.is_away, looks.wanted, slurm.fails = False, 3, True
    looks.look(2)
    slurm.fails = False
    looks.look(1)
    assert slurm.submitted == 3
    looks.is_away = True
    with pytest.raises(UnreachableError):
        looks.look(20)


def test_a_job_that_cannot_be_drained_keeps_no_other_from_it_and_does_not_end_adapt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slurm = Breaking()
    slurm.submitted = 3  # by an adapt before this one
    looks = Looks(monkeypatch, slurm, 100.0)
    looks.wanted = 3
    looks.look(1)
    slurm.gone, looks.wanted, looks.now = {"0"}, 0, 60.0
    looks.look(1)
    assert slurm.drained == ["1", "2"]
    slurm.gone = set()
    looks.look(1)
    assert slurm.drained == ["1", "2", "0"]
