"""Analyses on executors: equal to the bit to analyses without one, also when a worker is killed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll.api.model import Model
from atoll.executors.batches import spread_over
from atoll.executors.executors import ExecutorError
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from tests.programs import until
from tests.unit.library.experiments.made import measured

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks in processes with threads
RIVAL = {"y": "-0.8*x"}
BOX = {"x": (-4.0, 4.0), "y": (-5.0, 5.0)}


def oscillator() -> Model:
    """Return a model with a limit cycle, whose data have noise."""
    times = np.linspace(0.0, 8.0, 60)
    solved = solve_ivp(lambda t, x: [x[1], (1.0 - x[0] ** 2) * x[1] - x[0]], (0.0, 8.0), [0.5, 1.0], t_eval=times)
    noisy = solved.y + 0.05 * np.random.default_rng(1).standard_normal(solved.y.shape)
    equations = {"x": "y", "y": "1.02*y - x - 0.98*x**2*y"}
    return Model(Result.of(measured(equations, [(times, dict(zip("xy", noisy, strict=True)))], 0.05)))


def answers(model: Model, executor: object) -> dict[str, Any]:
    """Return the results of all analyses that take an executor."""
    return {
        "dynamics": str(model.analyse(BOX, vary=("c1", (0.5, 1.5)), executor=executor).as_dict()),
        "suggestions": str(model.suggest(rivals=[RIVAL], executor=executor).as_dict()),
        "few samples": str(model.suggest(cost="samples", samples=12, executor=executor).as_dict()),
        "identifiability": str(model.identifiability(executor=executor).as_dict()),
        "profile": {name: str(one.values.tolist()) for name, one in model.profile(executor=executor).items()},
        "report": model.to_html(executor=executor),
    }


def pool() -> ProcessPoolExecutor:
    """Return a pool of processes."""
    return ProcessPoolExecutor(2)


def compare() -> None:
    """Compare all answers without an executor, by threads, and by processes."""
    model = oscillator()
    alone = answers(model, None)
    with ThreadPoolExecutor(2) as threads:
        by_threads = answers(model, threads)
    with pool() as processes:
        by_processes = answers(model, processes)
    by_maker = {"report": model.to_html(executor=pool)}
    for name, answer in alone.items():
        assert by_threads[name] == answer, name
        assert by_processes[name] == answer, name
    assert by_maker["report"] == alone["report"]


def test_analyses_have_the_same_bits_with_and_without_an_executor() -> None:
    # a fresh interpreter, with the linear algebra that the command line and the task processes use
    script = (
        "import os; from atoll_core.machine import use_common_instructions; use_common_instructions(os.environ); "
        f"from {__name__} import compare; compare()"
    )
    plain = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    done = subprocess.run([sys.executable, "-c", script], env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Striking(ProcessPoolExecutor):
    """Kills a worker process soon after a number of calls were submitted."""

    def __init__(self, struck: int) -> None:
        super().__init__(2)
        self.struck, self.submitted = struck, 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = super().submit(fn, *args, **kwargs)
        self.submitted += 1
        if self.submitted == self.struck:
            os.kill(next(iter(self._processes)), signal.SIGKILL)
        return future


def test_a_worker_killed_during_an_analysis_changes_nothing() -> None:
    made: list[Striking] = []

    def make() -> Striking:
        made.append(Striking(3 if len(made) < 2 else -1))
        return made[-1]

    model = oscillator()
    with ThreadPoolExecutor(2) as threads:
        expected = model.suggest(rivals=[RIVAL], executor=threads).as_dict()
    assert str(model.suggest(rivals=[RIVAL], executor=make).as_dict()) == str(expected)
    assert len(made) == 3, "all further batches of the analysis use the pool that replaced the broken one"
    with pytest.raises(RuntimeError):
        made[-1].submit(int)  # the pool is shut down, because the analysis has made it


def test_a_broken_pool_that_cannot_be_made_again_is_an_error() -> None:
    with Striking(3) as executor, pytest.raises(ExecutorError, match="ProcessPoolExecutor"):
        oscillator().suggest(rivals=[RIVAL], executor=executor)


def test_an_analysis_that_is_interrupted_ends_the_processes_of_its_own_pool() -> None:
    made = pool()

    def interrupt() -> None:
        with spread_over(lambda: made):
            made.submit(time.sleep, 60.0)
            processes.extend(made._processes.values())
            raise KeyboardInterrupt

    processes: list[Any] = []
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert processes
    # a thread of the pool may have waited for a process first, and notes its end a moment later
    assert until(lambda: not any(process.is_alive() for process in processes))


@pytest.mark.parametrize("method", ["analyse", "suggest", "identifiability", "profile", "report", "to_html"])
def test_what_is_no_executor_is_refused_as_by_discover(method: str) -> None:
    with pytest.raises(UsageError, match=r"executor must be an executor .*; 3 was given"):
        getattr(oscillator(), method)(executor=3)
