"""What the coordinator compiles or loads ahead: all its kernels, and when it does so."""

import fcntl
import importlib
import logging
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from atoll.tasks.functions import FUNCTIONS, load_kernels_of_batches, load_refinement
from atoll_coordinator import warmup
from atoll_core.compilation import cache
from tests.unit.documents import ROOT

CALLED = {
    "atoll_coordinator.data.differentiation.kernels.loess": {"loess_into", "spread_into", "thin_into", "validate_into"},
    "atoll_coordinator.data.differentiation.kernels.stencils": {
        "best_stencil_into",
        "differences_into",
        "left_out_into",
        "moments",
    },
    "atoll_coordinator.model.shooting.kernels.integrate": {"integrate_segments", "largest_sizes"},
    "atoll_coordinator.model.shooting.kernels.normal_equations": {"normal_equations", "solve_step"},
}
"""Kernels that are called from Python; the others are compiled with them."""

READY = """
import importlib, sys
from atoll_coordinator.warmup import warm_up
warm_up(lambda sentence: None)
for name in sys.argv[1:]:
    members = vars(importlib.import_module(name)).items()
    kernels = {member: kernel for member, kernel in members if hasattr(kernel, "signatures")}
    print(*(f"{name}.{member}" for member, kernel in kernels.items() if kernel.signatures))
"""


@pytest.mark.slow
def test_every_kernel_is_ready_after_the_warm_up() -> None:
    ready = python(READY, *CALLED)
    assert {f"{module}.{kernel}" for module, kernels in CALLED.items() for kernel in kernels} <= ready


COUNTED = """
import sys, importlib
from atoll_core.compilation.cache import on_ready
ready = []
on_ready.append(lambda: ready.append(1))
module = importlib.import_module(sys.argv[1])
module.warm_up(lambda sentence: None)
print(f"{len(ready)}={len(module.COSTS)}")
"""


@pytest.mark.slow
@pytest.mark.parametrize("module", ["atoll_coordinator.warmup", "atoll_island_worker.compute.warmup"])
def test_the_count_of_kernels_that_progress_is_told_against_is_true(module: str) -> None:
    (counts,) = python(COUNTED, module)
    ready, expected = counts.split("=")
    assert ready == expected


NOISY = """
from atoll_core.compilation.cache import on_ready
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig, PredictorConfig, SpaceConfig
from atoll_island_worker.compute import warmup
from atoll_island_worker.evolution.island import Island
warmup.warm_up(lambda sentence: None)
ready = []
on_ready.append(lambda: ready.append(1))
evolution = EvolutionConfig(islands=2, runners_up=8)
budget, migration = BudgetConfig(target_error=1e-9), MigrationConfig(generations=20)
space, predictors = SpaceConfig(terminals=7), PredictorConfig(rows=16, effort=0.5)
config = JobConfig(space=space, evolution=evolution, predictors=predictors, migration=migration, budget=budget)
island = Island(warmup._small_problem(), config, 1)
while not island.advance():
    pass
print(len(ready), len(island.report().runners_up) > 0)
"""


def test_an_epoch_on_noisy_data_needs_no_kernel_besides_those_of_the_warm_up() -> None:
    assert python(NOISY) == {"0", "True"}


def python(code: str, *words: str) -> set[str]:
    """Return the words that a process of its own prints."""
    command = [sys.executable, "-c", code, *words]
    return set(subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout.split())


@pytest.mark.parametrize(
    "package", ["atoll_coordinator.data.differentiation.derivatives", "atoll_coordinator.model.shooting.warmup"]
)
def test_without_a_compiler_there_is_nothing_to_do(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(package)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    monkeypatch.setattr(module, "np", None)
    module.warm_up()


@pytest.mark.slow
def test_a_coordinator_starts_without_the_compiler() -> None:
    """What a start need not wait for: kernels, and what refining needs."""
    said = python("import sys, atoll_coordinator.service.service_loop; print(*sys.modules)")
    assert {"numba", "scipy", "sympy", "atoll_coordinator.model.pipeline"}.isdisjoint(said)


def test_a_warm_up_that_fails_is_logged_and_nothing_else(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(report: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("atoll_coordinator.warmup.warm_up", fail)
    with caplog.at_level(logging.ERROR):
        load_refinement()
    assert "warm-up failed" in caplog.text


def test_a_real_coordinator_warms_up_its_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []
    monkeypatch.setattr("atoll_coordinator.warmup.warm_up", lambda report: called.append(1))
    load_refinement()
    assert called == [1]


class Hearing(logging.Handler):
    """Collects messages and sets `has_heard` at the first."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.messages: list[str] = []
        self.has_heard = threading.Event()

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())
        self.has_heard.set()


@pytest.mark.parametrize(
    "load", [FUNCTIONS["prepare"].load, FUNCTIONS["prepare"].ready, lambda: load_kernels_of_batches("pursue")],
    ids=["prepare", "prepare within a time", "batch"],
)  # fmt: skip
def test_only_one_process_compiles_the_kernels_of_preparing(
    load: Callable[[], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exercised: list[int] = []
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setattr(cache, "wheel_kernels", lambda package: None)
    monkeypatch.setattr(warmup, "exercise_preparing", lambda: str(exercised.append(1)))
    folder, hearing = cache.cache_directory(warmup.PACKAGE), Hearing()
    folder.mkdir(parents=True)
    log = logging.getLogger("atoll.tasks.functions")
    monkeypatch.setattr(log, "level", logging.INFO)
    log.addHandler(hearing)
    try:
        with (folder / "lock").open("w") as other:  # as a process that compiles; a dead process holds no lock
            fcntl.flock(other, fcntl.LOCK_EX)
            thread = threading.Thread(target=load)
            thread.start()
            assert hearing.has_heard.wait(30.0)
            assert exercised == []
            assert "waiting" in hearing.messages[0]
        thread.join(30.0)
        assert exercised == [1]
        load()
        assert hearing.messages[-1].startswith("compiling kernels"), "the second call compiles nothing"
        assert cache.is_compiled(warmup.PACKAGE, warmup.PREPARING)
    finally:
        log.removeHandler(hearing)


def test_the_remaining_time_counts_only_kernels_that_are_not_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path))
    monkeypatch.setattr(cache, "wheel_kernels", lambda package: None)
    given: list[float] = []
    monkeypatch.setattr(warmup, "compile_or_load", lambda *arguments: given.append(sum(arguments[2].values())))
    warmup.warm_up(lambda sentence: None)
    warmup.warm_up_preparing(lambda sentence: None)
    file = cache.marker(warmup.PACKAGE, warmup.PREPARING)
    file.parent.mkdir(parents=True)
    file.touch()
    warmup.warm_up(lambda sentence: None)
    whole, preparing, others = given
    assert whole == pytest.approx(preparing + others)
    assert min(preparing, others) > 0.0
