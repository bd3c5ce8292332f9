"""Jobs on executors of other libraries: the whole result is that of the service, also when workers are killed."""

import contextlib
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import atoll
from atoll.api.campaign import AHEAD
from atoll.client.follower import Display
from atoll.executors.driver import JobDriver
from atoll.executors.executors import ExecutorError, InlineExecutor
from atoll_core.errors import AtollError, DataError, UsageError
from atoll_core.wire.messages.views import JobView, Workforce
from benchmarks.harness.systems import trajectories
from benchmarks.operations.differences import differences, masked

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks in processes with threads
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "lotka_volterra.csv"


def logistic() -> list[dict[str, Any]]:
    """Return two short trajectories with noise: several epochs, runners-up, and a choice between candidates."""
    random, times = np.random.default_rng(1), np.linspace(0.0, 6.0, 60)
    curves = [4.0 / (1.0 + (4.0 / begin - 1.0) * np.exp(-1.1 * times)) for begin in (0.3, 0.8)]
    return [{"t": times, "x": curve + 0.05 * random.standard_normal(times.size)} for curve in curves]


def competition() -> list[dict[str, Any]]:
    """Return trajectories of two states with noise, whose refining takes seconds and is given away in batches."""
    sampled = trajectories("lotka_volterra", noise=0.05, duration=4.0)
    return [
        {"t": times, **dict(zip(sampled.names, values.T, strict=True))}
        for times, values in zip(sampled.times, sampled.values, strict=True)
    ]


JOBS: dict[str, tuple[object, dict[str, Any]]] = {
    "example": (EXAMPLE, {"seed": 3}),
    "noisy": (logistic(), {"seed": 5, "max_epochs": 4, "islands": 3}),
    "two noisy states": (competition(), {"seed": 5, "max_epochs": 4, "islands": 3}),
}


@pytest.fixture(autouse=True)
def _help_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give batches to the executor from the beginning, also for jobs that are refined within a second."""
    monkeypatch.setattr("atoll.executors.driver.HELP_AFTER_S", 0.0)


def result_of(model: atoll.Model) -> Any:
    return masked(json.loads(model.result.to_json()))


@functools.cache
def of_service(job: str) -> Any:
    """Return the result of a job by the service."""
    data, options = JOBS[job]
    return result_of(atoll.discover(data, workers=2, **options))


def differing(result: Any, job: str) -> list[str]:
    return [one.shown(200) for one in differences(result, of_service(job))]


def on(executor: object, job: str, **more: Any) -> Any:
    data, options = JOBS[job]
    return result_of(atoll.discover(data, executor=executor, **options, **more))


def loky_pool() -> Executor:
    loky = pytest.importorskip("loky")
    executor: Executor = loky.get_reusable_executor(max_workers=2)
    return executor


def dask_pool() -> Executor:
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    executor: Executor = distributed.Client(cluster, set_as_default=False).get_executor()
    return executor


POOLS: dict[str, Callable[[], Executor]] = {
    "processes": lambda: ProcessPoolExecutor(2),
    "threads": lambda: ThreadPoolExecutor(3),
    "inline": InlineExecutor,
    "loky": loky_pool,
}


@pytest.mark.parametrize("job", ["example", "noisy"])
@pytest.mark.parametrize(
    "pool", ["threads", *(pytest.param(name, marks=pytest.mark.slow) for name in ("inline", "loky"))]
)
def test_the_result_is_the_one_of_the_service(pool: str, job: str) -> None:
    with POOLS[pool]() as executor:
        assert differing(on(executor, job), job) == []


@pytest.mark.slow
@pytest.mark.parametrize("pool", POOLS)
def test_the_result_of_two_noisy_states_is_the_one_of_the_service(pool: str) -> None:
    with POOLS[pool]() as executor:
        assert differing(on(executor, "two noisy states"), "two noisy states") == []


@pytest.mark.slow
def test_dask_gives_the_result_of_the_service_also_when_a_worker_is_killed() -> None:
    executor: Any = dask_pool()
    client = executor._client

    class Killing(Display):
        """Kills a worker process of the cluster when the search has begun."""

        killed = 0

        def show(self, view: JobView, workforce: Workforce, now: float) -> None:
            if not self.killed and view.state == "running":
                self.killed = next(iter(client.run(os.getpid).values()))
                os.kill(self.killed, signal.SIGKILL)

    try:
        assert differing(on(client, "noisy"), "noisy") == []
        killing = Killing()
        data, options = JOBS["two noisy states"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("atoll.api.discover._display", lambda progress: killing)
            model = atoll.discover(data, executor=executor, **options)
        assert killing.killed
        assert differing(result_of(model), "two noisy states") == []
    finally:
        client.shutdown()


MPI_PROGRAM = """
import sys
import atoll
from mpi4py.futures import MPIPoolExecutor

if __name__ == "__main__":
    with MPIPoolExecutor() as executor:
        atoll.discover(sys.argv[1], executor=executor, seed=3).save(sys.argv[2])
"""


@pytest.mark.slow
def test_mpi_gives_the_result_of_the_service(tmp_path: Path) -> None:
    pytest.importorskip("mpi4py")
    launcher = shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("there is no mpiexec")
    script, result = tmp_path / "script.py", tmp_path / "result.json"
    script.write_text(MPI_PROGRAM, "utf-8")
    words = [launcher, "-n", "3", sys.executable, "-m", "mpi4py.futures", str(script), str(EXAMPLE), str(result)]
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    more = {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    subprocess.run(words, env={**os.environ, **allowed, **more}, check=True, timeout=250, stdin=subprocess.DEVNULL)
    assert differing(masked(json.loads(result.read_text("utf-8"))), "example") == []


class Striking(ProcessPoolExecutor):
    """Kills a worker process soon after the calls with these numbers were submitted."""

    def __init__(self, workers: int, *struck: int) -> None:
        super().__init__(workers)
        self._struck = struck
        self._submitted = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = super().submit(fn, *args, **kwargs)
        self._submitted += 1
        if self._submitted in self._struck:
            os.kill(next(iter(self._processes)), signal.SIGKILL)
        return future


def test_a_killed_process_of_a_pool_changes_nothing_if_the_pool_can_be_made_again() -> None:
    made: list[Striking] = []

    def make() -> Striking:
        made.append(Striking(2, *((3,) if len(made) < 2 else ())))
        return made[-1]

    assert differing(on(make, "noisy"), "noisy") == []
    assert len(made) == 3


def task_processes() -> Iterator[int]:
    """Yield the ids of the task processes of this process."""
    for status in Path("/proc").glob("[0-9]*/status"):
        with contextlib.suppress(OSError):
            is_child = f"PPid:\t{os.getpid()}\n" in status.read_text("utf-8")
            if is_child and "atoll.tasks.process" in status.with_name("cmdline").read_text("utf-8"):
                yield int(status.parent.name)


@contextlib.contextmanager
def killing_task_processes() -> Iterator[None]:
    """Kill each task process of this process soon after its start, as the system does when memory runs out."""
    is_over = threading.Event()

    def kill() -> None:
        while not is_over.wait(0.02):
            for process in task_processes():
                with contextlib.suppress(OSError):
                    os.kill(process, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        yield
    finally:
        is_over.set()
        killer.join()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("stage", ["preparing", "running"])
def test_a_lack_of_memory_is_named_and_not_called_a_bug(stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.ExitStack() as stack:

        class Killing(Display):
            has_begun = False

            def show(self, view: JobView, workforce: Workforce, now: float) -> None:
                if view.state == stage and not self.has_begun:
                    self.has_begun = True
                    stack.enter_context(killing_task_processes())

        monkeypatch.setattr("atoll.api.discover._display", lambda progress: Killing())
        executor = stack.enter_context(ThreadPoolExecutor(2))
        with pytest.raises(AtollError) as caught:
            atoll.discover(EXAMPLE, executor=executor, **ENDLESS)
    assert "memory" in str(caught.value)
    assert "workers=" in str(caught.value)
    assert "report" not in str(caught.value)


def test_a_pool_that_is_broken_and_cannot_be_made_again_is_an_error() -> None:
    with Striking(2, 3) as executor, pytest.raises(ExecutorError, match="ProcessPoolExecutor"):
        on(executor, "noisy")


def test_a_killed_process_of_loky_changes_nothing() -> None:
    executor: Any = loky_pool()
    submit, submitted = executor.submit, []

    def striking(fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = submit(fn, *args, **kwargs)
        submitted.append(args)
        if len(submitted) == 3:
            os.kill(next(iter(executor._processes)), signal.SIGKILL)
        return future

    executor.submit = striking
    assert differing(on(executor, "noisy"), "noisy") == []
    assert len(submitted) >= 3


def test_the_progress_is_shown_as_by_the_service(capsys: pytest.CaptureFixture[str]) -> None:
    def lines(**where: Any) -> list[str]:
        atoll.discover(EXAMPLE, seed=3, max_epochs=3, target_error=1e-300, progress=True, **where)
        return capsys.readouterr().err.splitlines()

    with ThreadPoolExecutor(2) as executor:
        here = lines(executor=executor)
    there = lines(workers=2)
    assert here[-2:] == there[-2:], "the equations with their verdicts"
    assert [line for line in here if line.startswith(("note:", "warning:"))] == [
        line for line in there if line.startswith(("note:", "warning:"))
    ]
    before_the_end = [line for line in here[:-3] if line.startswith("  dx/dt")]
    assert any("size -" not in line and "x" in line.partition("size")[2] for line in before_the_end)


def test_a_failure_is_the_last_line_of_the_progress(capsys: pytest.CaptureFixture[str]) -> None:
    with ThreadPoolExecutor(2) as executor, pytest.raises(DataError):
        atoll.discover({"t": [0.0], "x": [1.0]}, executor=executor, progress=True)
    assert "failed" in capsys.readouterr().err.splitlines()[-1]


def test_profiles_of_constants_are_the_same_on_an_executor() -> None:
    data, options = JOBS["noisy"]
    with ThreadPoolExecutor(2) as executor:
        model = atoll.discover(data, executor=executor, **options)
        assert str(model.identifiability(executor=executor)) == str(model.identifiability())


# -------------------------------------------------------------------------------------------------------- many tables


def decays(count: int) -> Iterator[tuple[str, object]]:
    for number in range(count):
        t = np.linspace(0.0, 4.0, 60)
        yield f"decay {number}", {"t": t, "x": (1.0 + number) * np.exp(-0.5 * (number + 1) * t)}


BAD: dict[str, object] = {"no file": "no/such/file.csv", "one row": {"t": [0.0], "x": [1.0]}}


@pytest.mark.parametrize("executor", [lambda: ThreadPoolExecutor(2), None], ids=["threads", "service"])
def test_many_tables_come_as_they_are_ready_and_those_that_fail_as_errors(
    executor: Callable[[], Executor] | None,
) -> None:
    tables = {**dict(decays(4)), **BAD}
    made = None if executor is None else executor()
    found = dict(atoll.discover_many(tables, executor=made, workers=2, max_epochs=2))
    assert found.keys() == tables.keys()
    for name, data in decays(4):
        model = found[name]
        assert isinstance(model, atoll.Model)
        alone = atoll.discover(data, workers=2, max_epochs=2)
        assert [one.shown(200) for one in differences(result_of(model), result_of(alone))] == []
    assert isinstance(found["one row"], DataError)
    assert isinstance(found["no file"], AtollError)


def test_few_tables_are_solved_by_all_workers_and_fail_alone() -> None:
    tables = {**dict(decays(1)), **BAD}
    with ThreadPoolExecutor(8) as executor:
        found = dict(atoll.discover_many(tables, executor=executor, max_epochs=2))
    assert found.keys() == tables.keys()
    assert isinstance(found["decay 0"], atoll.Model)
    assert isinstance(found["one row"], DataError)


def test_an_interrupt_ends_the_campaign_after_the_present_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(driver: JobDriver) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(JobDriver, "_refine", interrupt)
    with ThreadPoolExecutor(8) as executor:
        campaign = atoll.discover_many(decays(2), executor=executor, max_epochs=1)
        name, model = next(campaign)
        assert name == "decay 0"
        assert isinstance(model, atoll.Model)
        with pytest.raises(KeyboardInterrupt):
            next(campaign)


def test_threads_give_up_their_tables_when_the_campaign_ends() -> None:
    (endless,) = decays(1)
    with ThreadPoolExecutor(1) as executor:  # waits at its end for all of its tasks
        campaign = atoll.discover_many([endless, *BAD.items()], executor=executor, **ENDLESS)
        assert next(campaign)[0] in BAD, "the table is being computed"
        campaign.close()  # type: ignore[attr-defined]


@pytest.mark.slow
def test_tables_are_read_only_as_far_as_they_are_needed() -> None:
    read: list[str] = []

    def tables() -> Iterator[tuple[str, object]]:
        for name, data in decays(1000):
            read.append(name)
            yield name, data

    with ThreadPoolExecutor(1) as executor:
        campaign = atoll.discover_many(tables(), executor=executor, max_epochs=1)
        for number in range(1, 4):
            next(campaign)
            assert len(read) <= number + AHEAD + 1
        campaign.close()  # type: ignore[attr-defined]


def test_wrong_options_and_tables_are_refused() -> None:
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(UsageError, match="max_sise"):
            atoll.discover_many({}, executor=executor, max_sise=3)
        with pytest.raises(UsageError, match="connect"):
            atoll.discover(EXAMPLE, executor=executor, connect="tcp/host:1")
        with pytest.raises(UsageError, match="connect"):
            atoll.discover_many({}, executor=executor, connect="tcp/host:1")
        assert [*atoll.discover_many({}, executor=executor, connect=None, tls=None, priority=0)] == []
    with pytest.raises(UsageError, match=r"concurrent\.futures"):
        atoll.discover_many({}, executor=3)
    with pytest.raises(UsageError, match="priority"):
        atoll.discover_many({}, priority=11)
    with pytest.raises(UsageError, match="connect"):
        atoll.discover_many({}, connect=3)
    for one_table in (pandas.DataFrame({"t": [0.0], "x": [1.0]}), np.zeros((3, 2)), "file.csv", 3, None):
        with pytest.raises(UsageError, match="tables"):
            atoll.discover_many(one_table)  # type: ignore[arg-type]


WHERE = pytest.mark.parametrize(
    ("executor", "workers"),
    [(lambda: ThreadPoolExecutor(2), 2), (lambda: ThreadPoolExecutor(8), 8), (None, 2)],
    ids=["a task each", "all workers", "service"],
)


@WHERE
def test_any_key_is_a_name_and_a_name_may_occur_twice(executor: Callable[[], Executor] | None, workers: int) -> None:
    data = dict(decays(1))["decay 0"]
    keys = [1, ("rate", 3), "text", "text"]
    made = None if executor is None else executor()
    found = [*atoll.discover_many(((key, data) for key in keys), executor=made, workers=workers, max_epochs=1)]
    assert sorted(map(repr, keys)) == sorted(repr(key) for key, _ in found)
    assert all(isinstance(model, atoll.Model) for _, model in found)


class Rude:
    """Data that raise an error of their own when they are read, hashed or shown."""

    def __hash__(self) -> int:
        raise ValueError("planted")

    def __repr__(self) -> str:
        raise ValueError("planted")

    @property
    def columns(self) -> list[str]:
        raise ZeroDivisionError("planted")


@WHERE
def test_a_wrong_item_is_the_error_of_this_table(executor: Callable[[], Executor] | None, workers: int) -> None:
    good = [*decays(2)]
    made = None if executor is None else executor()
    tables = [good[0], 3, ({}, {}), ("rude", Rude()), ("nothing", None), good[1], Rude(), (Rude(), 1)]
    found = dict(atoll.discover_many(tables, executor=made, workers=workers, max_epochs=1))
    assert isinstance(found.pop("decay 0"), atoll.Model)
    assert isinstance(found.pop("decay 1"), atoll.Model)
    assert isinstance(found.pop("nothing"), DataError)
    assert "planted" in str(found.pop("rude"))
    assert found.keys() == {"table 2", "table 3", "table 7", "table 8"}
    assert all(isinstance(error, UsageError) and "pair" in str(error) for error in found.values())


@WHERE
def test_an_error_of_the_iterable_comes_after_the_tables_that_were_read(
    executor: Callable[[], Executor] | None, workers: int
) -> None:
    def tables() -> Iterator[tuple[str, object]]:
        yield from decays(3)
        raise ZeroDivisionError("planted")

    names: list[object] = []
    made = None if executor is None else executor()
    with pytest.raises(ZeroDivisionError, match="planted"):
        names += (name for name, _ in atoll.discover_many(tables(), executor=made, workers=workers, max_epochs=1))
    assert sorted(map(str, names)) == [name for name, _ in decays(3)]


@WHERE
def test_no_tables_have_no_outcomes(executor: Callable[[], Executor] | None, workers: int) -> None:
    assert [*atoll.discover_many({}, executor=None if executor is None else executor(), workers=workers)] == []


# ---------------------------------------------------------------------------------------------------- ends by the clock


ENDLESS: dict[str, Any] = {"max_epochs": 10**6, "target_error": 1e-300}
"""Options of a search that goes on for more than 60 epochs."""


@pytest.mark.slow
def test_a_time_limit_keeps_the_equations_found_until_then() -> None:
    with ThreadPoolExecutor(2) as executor:
        model = atoll.discover(EXAMPLE, executor=executor, max_time=5.0, **ENDLESS)
    assert {equation.why for equation in model.equations} == {"max-time"}


def test_ctrl_c_keeps_the_equations_found_until_then() -> None:
    class Interrupting(ThreadPoolExecutor):
        """Interrupts the caller at its tenth call, after several epochs."""

        submitted = 0

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
            self.submitted += 1
            if self.submitted == 10:
                raise KeyboardInterrupt
            return super().submit(fn, *args, **kwargs)

    with Interrupting(2) as executor:
        model = atoll.discover(EXAMPLE, executor=executor, **ENDLESS)
    assert {equation.why for equation in model.equations} == {"cancelled"}
    assert max(equation.epoch for equation in model.equations) > 0


def test_ctrl_c_before_there_is_an_equation_is_raised() -> None:
    class Interrupting(ThreadPoolExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
            raise KeyboardInterrupt

    with Interrupting(2) as executor, pytest.raises(KeyboardInterrupt):
        next(atoll.discover_many(decays(3), executor=executor))


KILLED_CALLER = """
import sys
from concurrent.futures import ProcessPoolExecutor
sys.path[:0] = {path!r}
import atoll
from tests.integration.test_executors import decays
if __name__ == "__main__":
    for name, found in atoll.discover_many(decays(1000), executor=lambda: ProcessPoolExecutor(2), max_epochs=1):
        print(name, flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="pools fork their processes")
def test_the_processes_of_a_pool_end_when_their_caller_is_killed() -> None:
    text = KILLED_CALLER.format(path=sys.path)
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE) as caller:
        assert caller.stdout is not None
        for _ in range(4):  # both processes have computed
            assert caller.stdout.readline()
        caller.kill()
        caller.stdout.read()  # until the last process that can write to the pipe has ended


INTERRUPTED_CALLER = """
import sys
from concurrent.futures import ProcessPoolExecutor
sys.path[:0] = {path!r}
import atoll
from tests.integration.test_executors import ENDLESS, decays

def campaign(executor):
    try:
        for name, found in atoll.discover_many(decays(5), executor=executor, **ENDLESS):
            print("unexpected", name, flush=True)
    except KeyboardInterrupt:
        print("interrupted", flush=True)

if __name__ == "__main__":
    if sys.argv[1] == "made":
        campaign(lambda: ProcessPoolExecutor(2))
    else:
        with ProcessPoolExecutor(2) as pool:
            pool.submit(int).result()
            campaign(pool)
            print(pool.submit(int, 3).result(), flush=True)
"""


def children(process: int) -> set[int]:
    """Return the ids of the processes that a process and its children have started."""
    found: set[int] = set()
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(OSError):  # the thread has ended meanwhile
            found.update(map(int, file.read_text().split()))
    return found.union(*map(children, found))


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("pool", ["made", "given"])
def test_an_interrupt_of_the_caller_alone_ends_tables_in_other_processes(pool: str, tmp_path: Path) -> None:
    text = INTERRUPTED_CALLER.format(path=sys.path)
    command = [sys.executable, "-c", text, pool]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as caller:
        tasks: set[int] = set()
        while len(tasks) < 2:  # both processes of the pool compute a table
            assert caller.poll() is None
            tasks = {child for child in children(caller.pid) if _is_task_process(child)}
        os.kill(caller.pid, signal.SIGINT)
        out, err = caller.communicate(timeout=100)
    assert out.split() == ["interrupted", *(["3"] if pool == "given" else [])]
    assert err == ""
    assert caller.returncode == 0
    assert [*tmp_path.iterdir()] == []


def _is_task_process(process: int) -> bool:
    with contextlib.suppress(OSError):
        return "atoll.tasks.process" in Path(f"/proc/{process}/cmdline").read_text("utf-8")
    return False
