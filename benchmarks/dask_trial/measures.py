"""What is measured of Dask as a carrier of tasks: each function makes a cluster, or uses one, and returns sentences."""

import signal
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmarks.dask_trial import tasks
from benchmarks.dask_trial.cluster import (
    ANSWER_LIMIT_S,
    START_LIMIT_S,
    Cluster,
    check,
    listening,
    megabytes,
    waited,
    worker_pid,
)
from benchmarks.dask_trial.relay import Relay, pickled_calls
from benchmarks.harness.accounts import processor_seconds

TRIPS: Final = 200
TASKS: Final = 1000
ARGUMENTS: Final = (0, 100_000, 1_000_000)
"""Bytes that each task's argument has."""

SEEDS: Final = range(1, 4)
"""Tables of the work: 32 batches each."""

BACK_LIMIT_S: Final = 20.0
"""How long workers are waited for that have no scheduler, or cannot be dialled."""

SILENCE_LIMIT_S: Final = 60.0
"""How long it is looked whether anybody notices a worker that stands; a lease of Atoll's ends within five."""

MOST_DEATHS: Final = 8
"""Twice as many as Dask's default allows a task."""

LONG_S: Final = 10.0
"""A task that is cancelled while it runs."""


@contextmanager
def connected(workers: int) -> Iterator[tuple[Cluster, Any]]:
    """Start a cluster, with a client once all workers are there; end both."""
    with Cluster(workers) as cluster:
        client = cluster.client()
        try:
            yield cluster, client
        finally:
            with suppress(Exception):  # its scheduler may have been killed
                client.close(timeout=5)


def starting() -> list[str]:
    """Time the start of a scheduler and two workers: by one call, and as programs."""
    from distributed import Client, LocalCluster

    began = time.monotonic()
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local, Client(local):
        by_call = time.monotonic() - began
    began = time.monotonic()
    with connected(2) as (cluster, client):
        as_programs = time.monotonic() - began
        assert cluster.scheduler is not None
        names = ["the scheduler", "each worker"]
        idle = [megabytes(process.pid) for process in (cluster.scheduler, cluster.workers[0])]
        ports = [listening(process.pid) for process in (cluster.scheduler, cluster.workers[0])]
        client.run(tasks.prepared, tasks.table_of(1))
        loaded = megabytes(cluster.workers[0].pid)
        memory = ", ".join(f"{name} {size:.0f} MB" for name, size in zip(names, idle, strict=True))
        doors = ", ".join(f"{name} at {count}" for name, count in zip(names, ports, strict=True))
    return [
        f"start of a scheduler and 2 workers: {by_call:.2f} s by LocalCluster, {as_programs:.2f} s as programs",
        f"memory when idle: {memory}; a worker that has prepared a table {loaded:.0f} MB",
        f"TCP ports that are listened at: {doors}",
    ]


def overhead() -> list[str]:
    """Time tasks that do nothing: one after the other, and a thousand at once."""
    said = []
    with connected(2) as (cluster, client):
        client.submit(tasks.nothing, pure=False).result(ANSWER_LIMIT_S)
        for size in ARGUMENTS:
            arguments = [number.to_bytes(4, "big") + bytes(size) for number in range(TASKS)]
            trips = [_timed(client, argument) for argument in arguments[:TRIPS]]
            began, before = time.monotonic(), _processor(cluster)
            client.gather(client.map(tasks.nothing, arguments, pure=False))
            rate = TASKS / (time.monotonic() - began)
            used = 1e3 * (_processor(cluster) - before) / TASKS
            said.append(
                f"empty task with an argument of {size} bytes: {1e3 * statistics.median(trips):.1f} ms there and back "
                f"in the median of {TRIPS}, {rate:.0f} a second when {TASKS} are given out at once; then "
                f"{used:.1f} ms of processor time each, of client, scheduler and workers together"
            )
        assert cluster.scheduler is not None
        said.append(f"memory of the scheduler after these tasks: {megabytes(cluster.scheduler.pid):.0f} MB")
    return said


def _processor(cluster: Cluster) -> float:
    """Return the processor seconds of all processes of a cluster, and of this one."""
    processes = (cluster.scheduler, *cluster.workers)
    return time.process_time() + sum(processor_seconds(process.pid) for process in processes if process is not None)


def _timed(client: Any, argument: bytes) -> float:
    began = time.monotonic()
    client.submit(tasks.nothing, argument, pure=False).result(ANSWER_LIMIT_S)
    return time.monotonic() - began


def begun(client: Any) -> list[Any]:
    """Give out the work: tables prepared, systems fitted in batches; return the futures of the batches, in order."""
    futures = []
    for seed in SEEDS:
        preparation = client.submit(tasks.prepared, tasks.table_of(seed), pure=False)
        futures += [client.submit(tasks.fitted, preparation, batch, pure=False) for batch in tasks.batches(seed)]
    return futures


def alone() -> tuple[str, str]:
    """Do the work here, without a cluster; return its digest, and a sentence."""
    tasks.fitted(tasks.prepared(tasks.table_of(0)), tasks.batches(0)[0])  # loads the kernels
    began, used, digests = time.monotonic(), time.process_time(), []
    for seed in SEEDS:
        preparation = tasks.prepared(tasks.table_of(seed))
        digests += [tasks.fitted(preparation, batch) for batch in tasks.batches(seed)]
    seconds, used = time.monotonic() - began, time.process_time() - used
    batch_s = used / len(digests)
    return tasks.together(digests), (
        f"{len(digests)} batches in one process, without Dask: {seconds:.1f} s, {used:.1f} s of processor time, "
        f"{batch_s:.2f} s a batch"
    )


def work(expected: str) -> list[str]:
    """Do the work on one worker and on two."""
    said = []
    for workers in (1, 2):
        with connected(workers) as (_, client):
            client.run(_load)
            began = time.monotonic()
            futures = begun(client)
            found = tasks.together(client.gather(futures))
            seconds = time.monotonic() - began
            same = "the same bits" if found == expected else "OTHER BITS"
            said.append(f"{len(futures)} batches on {workers} workers: {seconds:.1f} s, {same} as without Dask")
    return said


def _load() -> None:
    tasks.fitted(tasks.prepared(tasks.table_of(0)), tasks.batches(0)[0])


def lost_worker(expected: str) -> list[str]:
    """Kill a worker among its tasks; then, of another cluster, stop one."""
    said = []
    with connected(2) as (cluster, client):
        seconds, found = _strike(cluster, client, signal.SIGKILL)
        same = "the same bits" if found == expected else "OTHER BITS"
        said.append(f"worker killed: its tasks are given to another one after {_seconds(seconds)}; {same}")
    with connected(2) as (cluster, client):
        seconds, _ = _strike(cluster, client, signal.SIGSTOP)
        said.append(f"worker stopped (SIGSTOP): its tasks are given to another one after {_seconds(seconds)}")
    return said


def _strike(cluster: Cluster, client: Any, number: int) -> tuple[float | None, str]:
    """Strike a worker that has tasks; return after how many seconds it has none, and the digest if all end."""
    client.run(_load)
    futures = begun(client)
    victim = next(iter(client.scheduler_info()["workers"]))
    pid = worker_pid(client, victim)
    check(waited(lambda: bool(client.processing()[victim]), START_LIMIT_S) is not None, "no task was given out")
    next(one for one in cluster.workers if one.pid == pid).send_signal(number)
    seconds = waited(lambda: not client.processing().get(victim), SILENCE_LIMIT_S)
    return seconds, tasks.together(client.gather(futures)) if seconds is not None else ""


def deadly_task() -> list[str]:
    """Give out a task that kills its worker; workers are started in the place of those that it has killed."""
    with connected(2) as (cluster, client):
        future = client.submit(_die, pure=False)
        while future.status == "pending" and len(cluster.workers) < MOST_DEATHS:
            dead = _dead(cluster)
            if waited(partial(_is_further, cluster, future, dead), START_LIMIT_S) is not None:
                cluster.start_worker()
        waited(lambda: future.status != "pending", START_LIMIT_S)
        try:
            future.result(timeout=5.0)
        except Exception as error:
            return [f"a task that kills its worker: {type(error).__name__} after {_dead(cluster)} dead workers"]
    return ["a task that kills its worker: no error"]


def _is_further(cluster: Cluster, future: Any, dead: int) -> bool:
    return _dead(cluster) > dead or future.status != "pending"


def _dead(cluster: Cluster) -> int:
    return sum(process.poll() is not None for process in cluster.workers)


def _die() -> None:
    import os

    os.kill(os.getpid(), signal.SIGKILL)


def lost_scheduler() -> list[str]:
    """Kill the scheduler among the tasks and start another at the same address."""
    with connected(2) as (cluster, client):
        client.run(_load)
        futures = begun(client)
        waited(lambda: sum(future.done() for future in futures) >= len(futures) // 4, ANSWER_LIMIT_S)
        done = sum(future.done() for future in futures)
        assert cluster.scheduler is not None
        cluster.scheduler.kill()
        cluster.scheduler.wait(START_LIMIT_S)
        cluster.start_scheduler()
        gone = waited(lambda: _dead(cluster) == cluster.wanted, SILENCE_LIMIT_S)
        back = waited(lambda: client.status == "running" and _workers(client) > 0, BACK_LIMIT_S)
        states = [future.status for future in futures]
        counts = ", ".join(f"{states.count(state)} {state}" for state in sorted({*states}))
        error = ""
        try:
            futures[0].result(10.0)
        except Exception as raised:
            error = f"; result() of one that was done raises {type(raised).__name__}"
    return [
        f"scheduler killed with {done} of {len(futures)} tasks done, and started again at once: all workers "
        f"have ended after {_seconds(gone)}; the client has a scheduler with workers after "
        f"{_seconds(back, BACK_LIMIT_S)}; {counts}{error}"
    ]


def _workers(client: Any) -> int:
    with suppress(Exception):
        return len(client.scheduler_info()["workers"])
    return 0


def cancelled() -> list[str]:
    """Cancel a task that runs."""
    with connected(1) as (cluster, client):
        mark = cluster.folder / "mark"
        future = client.submit(tasks.count_into, str(mark), LONG_S, pure=False)
        check(waited(mark.exists, START_LIMIT_S) is not None, "the task did not begin")
        at = time.monotonic()
        future.cancel()
        following = client.submit(tasks.nothing, pure=False)
        following.result(ANSWER_LIMIT_S)
        free = time.monotonic() - at
        last = _last(mark)
    return [
        f"a running task of {LONG_S:g} s is cancelled: it computes for another {last - at:.1f} s, and its thread takes "
        f"the next task after {free:.1f} s"
    ]


def _last(mark: Path) -> float:
    return float(mark.read_text("utf-8"))


def on_the_wire() -> list[str]:
    """Read along what a client sends for a function that was made in it, and run code in the scheduler."""
    import os

    from distributed import Client

    number = int(time.time())
    with Cluster(1) as cluster, Relay("127.0.0.1", cluster.port) as relay:
        cluster.client(1).close()
        with Client(relay.address, timeout=START_LIMIT_S, set_as_default=False) as client:
            client.submit(lambda: f"atoll-{number}", pure=False).result(ANSWER_LIMIT_S)
            assert cluster.scheduler is not None
            inside = client.run_on_scheduler(os.getpid) == cluster.scheduler.pid
        calls = [name for name in pickled_calls(bytes(relay.sent)) if "cloudpickle" in name or "CodeType" in name]
    return [
        f"on the wire: pickles that call {', '.join(calls) or 'nothing'} where they are read; any client "
        f"{'runs' if inside else 'does not run'} functions in the scheduler's own process"
    ]


def behind_translation() -> list[str]:
    """Have two workers that nobody can dial, as behind address translation: the port that they name is closed."""
    from distributed import Client

    with Cluster(0) as cluster:
        for number in (7, 9):  # ports at which nothing listens
            cluster.start_worker(f"tcp://127.0.0.1:{number}")
        with Client(cluster.address, timeout=START_LIMIT_S, set_as_default=False) as client:
            came = waited(lambda: _workers(client) == len(cluster.workers), BACK_LIMIT_S)
            said = f"come after {_seconds(came)}" if came is not None else f"have not come within {BACK_LIMIT_S:.0f} s"
            if came is None:
                return [f"2 workers that cannot be dialled {said}"]
            try:
                total = client.submit(sum, client.map(_same, range(4), pure=False)).result(BACK_LIMIT_S)
                fetched = "results come back" if total == sum(range(4)) else "OTHER RESULTS"
            except Exception as error:
                fetched = f"fetching results raises {type(error).__name__}"
    return [f"2 workers that cannot be dialled {said}; {fetched}"]


def _same(number: int) -> int:
    return number


def _seconds(seconds: float | None, limit_s: float = SILENCE_LIMIT_S) -> str:
    return f"more than {limit_s:.0f} s" if seconds is None else f"{seconds:.2f} s"


def measured_alone() -> Sequence[Callable[[], list[str]]]:
    """Return the measures that need no digest to compare with."""
    return starting, overhead, deadly_task, lost_scheduler, cancelled, on_the_wire, behind_translation
