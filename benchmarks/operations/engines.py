"""The same job by the service and by other engines: digests, equations, and times beside each other, a worker killed.

``python -m benchmarks.operations.engines`` solves one job by the service, Dask, MPI, loky, Ray, a pool of processes and
threads, each with two workers and in a program of its own, first undisturbed, then with a worker killed on the way. An
engine that is not installed is left out. Processor seconds are those of all processes of the program, until the last
one has ended. MPI ends the whole program when one of its processes dies; so the task process of one of them is killed,
as the system does when memory runs out. Threads have no other processes than these.

``--tables 16`` solves many small tables by `atoll.discover_many` instead of one job.

``--overhead`` measures instead what it costs that islands are written after each epoch, pass the driver, and are read
again: processor seconds of the same epochs so and with islands that stay in memory, as on a worker of the service.

``--analyses`` measures instead the analyses of a noisy Lorenz model without an executor, and on one and two threads.

Returns 1 when a digest or an equation differs, else 0.
"""

import contextlib
import ctypes
import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

import atoll
from atoll.executors.epochs import EPOCHS, JOB, ComputedEpoch, SearchedJob, load_kernels
from atoll.terminal.output import note, say, table
from atoll_coordinator.service.jobs.job import commit_order_of
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from atoll_core.machine import use_common_instructions
from atoll_core.wire.values import encode_value
from atoll_island_worker.evolution.island import Island
from atoll_island_worker.session.interface import EpochTask, TaskKey
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.solving import solve
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.operations.differences import differences, masked

WORKERS: Final = 2
_SUBREAPER: Final = 36
"""PR_SET_CHILD_SUBREAPER of Linux: processes whose parent has ended become children of this process."""

Pids = Callable[[], Sequence[int]]
"""Returns the processes of which one is killed."""


@dataclass(frozen=True)
class Took:
    """One run: seconds from the call to its result, and processor seconds of all its processes from start to end."""

    engine: str
    is_struck: bool
    seconds: float
    processor: float
    digest: str
    equations: tuple[str, ...]
    differing: int = 0


# --------------------------------------------------------------------------------------------- one program, one engine


@contextmanager
def processes() -> Iterator[tuple[object, Pids]]:
    """A pool of processes, made again when it is broken."""
    made: list[ProcessPoolExecutor] = []

    def make() -> ProcessPoolExecutor:
        made.append(ProcessPoolExecutor(WORKERS))
        return made[-1]

    yield make, lambda: [*made[-1]._processes]


@contextmanager
def threads() -> Iterator[tuple[object, Pids]]:
    """A pool of threads."""
    with ThreadPoolExecutor(WORKERS) as executor:
        yield executor, lambda: task_processes(os.getpid())


@contextmanager
def loky() -> Iterator[tuple[object, Pids]]:
    """The reusable pool of loky."""
    import loky as library

    executor: Any = library.get_reusable_executor(max_workers=WORKERS)
    yield executor, lambda: [*executor._processes]
    library.get_reusable_executor(max_workers=WORKERS).shutdown(wait=True)


@contextmanager
def dask() -> Iterator[tuple[object, Pids]]:
    """A Dask cluster on this machine."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        yield client, lambda: [*client.run(os.getpid).values()]


@contextmanager
def mpi() -> Iterator[tuple[object, Pids]]:
    """The other processes of this MPI program; one of their task processes is killed."""
    from mpi4py.futures import MPIPoolExecutor

    with MPIPoolExecutor() as executor:
        yield executor, lambda: task_processes(*(pid for pid in siblings() if pid != os.getpid()))


@contextmanager
def ray() -> Iterator[tuple[object, Pids]]:
    """A Ray cluster on this machine."""
    import ray as library

    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}  # nothing is sent, no token is written
    library.init(num_cpus=WORKERS, include_dashboard=False, log_to_driver=False)
    yield library, lambda: [pid for pid in below(os.getpid()) if words_of(pid).startswith(b"ray::perform")]
    library.shutdown()


@contextmanager
def service() -> Iterator[tuple[object, Pids]]:
    """The local service."""
    yield None, lambda: [pid for pid in below(os.getpid()) if is_worker(pid)]


ENGINES: Final = {
    "service": service, "processes": processes, "threads": threads, "loky": loky, "dask": dask, "mpi": mpi, "ray": ray,
}  # fmt: skip
PACKAGES: Final = {"loky": "loky", "dask": "distributed", "mpi": "mpi4py", "ray": "ray"}


def parents() -> dict[int, int]:
    """Return the parent of each process of this machine."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            found[int(folder.name)] = int((folder / "stat").read_text("utf-8").rpartition(")")[2].split()[1])
    return found


def below(root: int) -> list[int]:
    """Return the processes below a process."""
    known, found = parents(), {root}
    while more := {pid for pid, parent in known.items() if parent in found and pid not in found}:
        found |= more
    return sorted(found - {root})


def siblings() -> list[int]:
    """Return the processes with the same parent as this one, itself included."""
    known = parents()
    return sorted(pid for pid, parent in known.items() if parent == known[os.getpid()])


def words_of(pid: int) -> bytes:
    """Return the command line of a process, b"" if it has ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def task_processes(*roots: int) -> list[int]:
    """Return the task processes below some processes."""
    return [pid for root in roots for pid in below(root) if b"atoll.tasks.process" in words_of(pid)]


def is_worker(pid: int) -> bool:
    """Tell whether a process is an island worker: forked by another process of this program."""
    parent = parents().get(pid, 0)
    return b"atoll_island_worker" in words_of(pid) and b"atoll_island_worker" in words_of(parent)


def strike(pids: Pids, after: float, struck: list[int]) -> None:
    """Kill one of the processes after some seconds, as soon as there is one."""
    time.sleep(after)
    while not struck:
        for pid in pids()[:1]:
            os.kill(pid, signal.SIGKILL)
            struck.append(pid)
        time.sleep(0.02)


def small_tables(count: int) -> Iterator[tuple[str, object]]:
    """Yield tables of logistic growth with noise, 60 rows each."""
    times = np.linspace(0.0, 6.0, 60)
    for number in range(count):
        curve = 4.0 / (1.0 + (4.0 / (0.3 + 0.02 * number) - 1.0) * np.exp(-1.1 * times))
        yield f"{number}", {"t": times, "x": curve + 0.05 * np.random.default_rng(number).standard_normal(60)}


def solve_many(engine: str, count: int, epochs: int) -> dict[str, Any]:
    """Solve many small tables in this process; the digest of the whole is the one of all digests by name."""
    digests = {}
    with ENGINES[engine]() as (executor, _):
        began = time.monotonic()
        for name, found in atoll.discover_many(
            small_tables(count), executor=executor, workers=WORKERS, max_epochs=epochs
        ):
            if isinstance(found, AtollError):
                raise found
            digests[name] = str(found.result.digest)
        seconds = time.monotonic() - began
    whole_digest = hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()
    return {"seconds": seconds, "result": {"equations": [], "digests": digests}, "digest": whole_digest}


def solve_once(engine: str, after: float | None, seed: int, epochs: int) -> dict[str, Any]:
    """Solve the job in this process; `after` seconds a worker is killed (None: none is)."""
    sampled = trajectories("lotka_volterra", noise=0.05, duration=4.0)
    data = [
        {"t": times, **dict(zip(sampled.names, values.T, strict=True))}
        for times, values in zip(sampled.times, sampled.values, strict=True)
    ]
    struck: list[int] = []
    with ENGINES[engine]() as (executor, pids):
        workers = WORKERS if executor is None else None
        options: dict[str, Any] = {"seed": seed, "max_epochs": epochs, "workers": workers, "executor": executor}
        if after is not None:
            threading.Thread(target=strike, args=(pids, after, struck), daemon=True).start()
        began = time.monotonic()
        model = atoll.discover(data, progress=False, **options)
        seconds = time.monotonic() - began
    if after is not None and not struck:
        raise AtollError(f"{engine} was done before a worker was killed; lower --after")
    return {"seconds": seconds, "result": masked(json.loads(model.result.to_json())), "digest": model.result.digest}


# ------------------------------------------------------------------------------------------------------ the analyses

ANALYSES: Final[dict[str, Callable[[atoll.Model, Any], str]]] = {
    "analyse": lambda model, executor: str(model.analyse(executor=executor).as_dict()),
    "analyse(vary)": lambda model, executor: str(
        model.analyse(vary=("y:x", (10.0, 40.0)), executor=executor).as_dict()
    ),
    "suggest": lambda model, executor: str(model.suggest(executor=executor).as_dict()),
    "report": lambda model, executor: model.to_html(executor=executor),
}


def _lorenz_rates(state: FloatArray) -> Sequence[float]:
    x, y, z = state.tolist()
    return 10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z


def lorenz() -> atoll.Model:
    """Return the model of two trajectories of the Lorenz system with 2 % of noise."""
    times, random = np.linspace(0.0, 3.0, 150), np.random.default_rng(1)
    data = []
    for start in ((1.0, 1.0, 1.0), (-5.0, 3.0, 20.0)):
        curves = solve(_lorenz_rates, start, times, limit=1e6, most_evaluations=100_000).T
        noisy = curves + 0.02 * curves.std(axis=1)[:, None] * random.standard_normal(curves.shape)
        data.append({"t": times, **dict(zip("xyz", noisy, strict=True))})
    return atoll.discover(data, seed=5, max_epochs=8, workers=WORKERS)


def analyse_once(name: str, workers: int, file: str) -> dict[str, Any]:
    """Do one analysis in this process, or on a number of threads."""
    model = atoll.Model.load(file)
    with ThreadPoolExecutor(workers) if workers else contextlib.nullcontext() as executor:
        began = time.monotonic()
        made = ANALYSES[name](model, executor)
        seconds = time.monotonic() - began
    return {"seconds": seconds, "result": {"equations": []}, "digest": hashlib.sha256(made.encode()).hexdigest()}


def analyses(options: Namespace) -> list[Took]:
    """Return what each analysis took, by number of workers (0: no executor), each in a program of its own."""
    use_common_instructions(os.environ)  # as task processes do, so that the last bits can be compared
    took = []
    with TemporaryDirectory() as folder:
        file = str(Path(folder) / "result.json")
        # in a program of its own, because the local service of this process would be waited for
        run("the model", [sys.executable, "-m", __spec__.name, "--result", file], False)
        for _ in range(options.repeats):
            for name in ANALYSES:
                digests = []
                for workers in (0, 1, 2):
                    words = ["--analysis", name, "--threads", str(workers), "--result", file]
                    one, _ = run(f"{name}, {workers}", [sys.executable, "-m", __spec__.name, *words], False)
                    digests.append(one.digest)
                    took.append(Took(**{**vars(one), "differing": int(one.digest != digests[0])}))
    return took


# ------------------------------------------------------------------------------------------------------ the overhead


def tasks_of(config: JobConfig, variable: str, epoch: int, before: ComputedEpoch | None) -> tuple[EpochTask, ...]:
    """Return the tasks of one epoch of all islands of a variable, which continue from the epoch before."""
    emigrants = {} if before is None else {one.key.island: one.emigrants for one in before.islands}
    return tuple(
        EpochTask(
            TaskKey(JOB, variable, 1, island, epoch),
            {source: blocks[island] for source, blocks in emigrants.items() if island in blocks} or None,
            False, commit_order_of(config), None if before is None else before.states[island],
        )
        for island in range(config.evolution.islands)
    )  # fmt: skip


def overhead(epochs: int, repeats: int) -> str:
    """Return a table of processor seconds of epochs of one variable: by batches, and by islands that stay in memory."""
    config = configured(seed=5, budget=UNENDING)
    prepared, data = prepare_job(table_of(trajectories("lotka_volterra", noise=0.05)).to_bytes(), config)
    context, problem = encode_value(SearchedJob(prepared.config, data)), prepared.dataset.problem("x")
    load_kernels()
    rows = []
    for _ in range(repeats):
        began, done, size = time.process_time(), None, 0
        for epoch in range(epochs):
            item = EPOCHS.encode([tasks_of(prepared.config, "x", epoch, done)])
            made = EPOCHS(context, item)
            done, size = EPOCHS.decode(made)[0], size + len(item) + len(made)
        by_batches = time.process_time() - began
        began = time.process_time()
        islands = [Island(problem, prepared.config, number) for number in range(config.evolution.islands)]
        for _ in range(epochs):
            for island in islands:
                while not island.advance():
                    pass
            blocks = [island.emigrants() for island in islands]
            for number, island in enumerate(islands):
                island.immigrate({source: sent[number] for source, sent in enumerate(blocks) if number in sent})
        kept = time.process_time() - began
        each = epochs * config.evolution.islands
        cells = (1e3 * by_batches / each, 1e3 * kept / each, 100.0 * (by_batches / kept - 1.0), size / each / 1024.0)
        rows.append(tuple(f"{cell:.1f}" for cell in cells))
    return table(("ms an island's epoch by batches", "kept", "%", "kB"), rows)


# ------------------------------------------------------------------------------------------------------- all of them


def command_of(engine: str, options: Namespace, is_struck: bool) -> list[str]:
    """Return the command that solves the job once."""
    words = [__spec__.name, "--once", engine, "--seed", str(options.seed), "--epochs", str(options.epochs)]
    words += ["--after", str(options.after or 3.0)] if is_struck else []
    words += ["--tables", str(options.tables)] if options.tables else []
    if engine != "mpi":
        return [sys.executable, "-m", *words]
    launcher = ["mpiexec", "--allow-run-as-root", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1"]
    return [*launcher, "-n", str(WORKERS + 1), sys.executable, "-m", "mpi4py.futures", "-m", *words]


def run(engine: str, command: Sequence[str], is_struck: bool) -> tuple[Took, Any]:
    """Run a command that solves the job by an engine; return what it took, and the result."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    with contextlib.suppress(ChildProcessError):  # processes that end after their parents
        while True:
            os.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        raise AtollError(f"{engine} failed with exit code {done.returncode}")
    made = json.loads(done.stdout.splitlines()[-1])
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    equations = tuple(equation["expression"] for equation in made["result"]["equations"])
    return Took(engine, is_struck, made["seconds"], processor, made["digest"], equations), made["result"]


def available(engine: str) -> bool:
    """Tell whether an engine is installed here."""
    return find_spec(PACKAGES.get(engine, "atoll")) is not None and (engine != "mpi" or which("mpiexec") is not None)


def shown(took: Sequence[Took]) -> str:
    """Return one line for each engine."""
    rows = [
        (
            one.engine, "a worker killed" if one.is_struck else "", f"{one.seconds:.1f}", f"{one.processor:.1f}",
            one.digest[:12], "equal" if not one.differing else f"{one.differing} places differ",
        )
        for one in took
    ]  # fmt: skip
    return table(("engine", "", "s", "processor s", "digest", "result beside the first"), rows)


@program(
    "benchmarks.operations.engines",
    __doc__,
    option("--engines", metavar="NAME,NAME", default=",".join(ENGINES), help="engines (all that are installed)"),
    option("--seed", type=int, default=5),
    option("--epochs", type=whole, default=8, help="longest search (%(default)s)"),
    option("--after", type=positive, help="seconds until a worker is killed (3)"),
    option("--repeats", type=whole, default=1),
    option("--tables", type=whole, help="solve this number of small tables by discover_many instead of one job"),
    option("--overhead", action="store_true", help="measure the cost of islands that pass the driver"),
    option("--analyses", action="store_true", help="measure the analyses of a model, on 1 and 2 threads"),
    option("--analysis", choices=ANALYSES, help="do one of them in this process and print its digest"),
    option("--threads", type=int, default=0, help="threads of --analysis (0: no executor)"),
    option("--result", metavar="FILE", help="result of --analysis; without that, find the model and write it"),
    option("--once", choices=ENGINES, help="solve the job in this process and print the result"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 when a result differs, else 0."""
    if options.once and options.tables:
        say(json.dumps(solve_many(options.once, options.tables, options.epochs)))
        return 0
    if options.once:
        say(json.dumps(solve_once(options.once, options.after, options.seed, options.epochs)))
        return 0
    if options.result and not options.analysis:
        model = lorenz()
        model.save(options.result)
        say(json.dumps({"seconds": 0.0, "result": {"equations": []}, "digest": model.result.digest}))
        return 0
    if options.analysis:
        say(json.dumps(analyse_once(options.analysis, options.threads, options.result)))
        return 0
    if options.overhead:
        say(overhead(options.epochs, options.repeats))
        return 0
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    if options.analyses:
        measured = analyses(options)
        say(shown(measured))
        say(f"load {load():.1f}")
        return int(any(one.differing for one in measured))
    names = [name for name in options.engines.split(",") if available(name)]
    record, took, reference = Record("engines", options.words, options.out), [], None
    for _ in range(options.repeats):
        for name in names:
            for is_struck in (False,) if options.tables else (False, True):
                one, result = run(name, command_of(name, options, is_struck), is_struck)
                reference = result if reference is None else reference
                places = len([*differences(result, reference)])
                took.append(Took(**{**vars(one), "differing": places}))
                record.add(took[-1])
                note(f"  {name}{' struck' if is_struck else ''}: {one.seconds:.1f} s, {one.processor:.1f} processor s")
    say(shown(took))
    differing = sum(one.differing > 0 for one in took)
    record.write(differing=differing)
    say(f"\n{differing} of {len(took)} results differ from the first; load {load():.1f}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
