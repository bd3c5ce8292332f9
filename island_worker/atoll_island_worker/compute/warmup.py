"""Making the kernels ready before work comes: compiled once per machine, loaded from the cache everywhere else.

Of several processes that find nothing compiled, one compiles while the others wait and then load. What has been
compiled is marked by a file beside the cache, one for each kind of processor, version of the compiler and checkout.
"""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.compilation.marker import marker_in
from atoll.errors import AtollError

if TYPE_CHECKING:
    from atoll.data.dataset import Problem


Report = Callable[[str], None]

_ROWS: Final = 40


def warm_up(report: Report, exercise: Callable[[], None] | None = None) -> None:
    """Compile or load every kernel that an epoch needs, by running a very small one for each preset.

    Args:
        report: told in one sentence when it is going to take long, and why.
        exercise: what runs the kernels, instead of the small epochs.

    Raises:
        AtollError: the cache of compiled kernels cannot be written.
    """
    run = exercise or run_small_epochs
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    from atoll.compilation.jit import cache_directory

    directory = _made(cache_directory())
    marker = marker_in(directory)
    if not marker.exists():
        with _locked(directory / "lock", report):
            if not marker.exists():
                report("compiling kernels, first time on this machine, about a minute")
                run()
                marker.touch()
                return
    run()


def is_compiled() -> bool:
    """Say whether the kernels have been compiled on this machine, and so need only be loaded."""
    from atoll.compilation.jit import cache_directory

    return marker_in(cache_directory()).exists()


def run_small_epochs() -> None:
    """Run one small epoch of one island for each preset, and what lies between two epochs."""
    from atoll.config import PRESETS, BudgetConfig, JobConfig, MigrationConfig
    from atoll_island_worker.evolution.island import Island

    for preset in PRESETS.values():
        fields = {
            **{name: getattr(preset, name) for name in JobConfig.model_fields},
            "space": preset.space.model_copy(update={"terminals": 7}),
            "evolution": preset.evolution.model_copy(update={"islands": 1, "population": 16}),
            "predictors": preset.predictors.model_copy(update={"rows": 16, "renewal": 2, "effort": 0.5}),
            "migration": MigrationConfig(generations=20),
            "budget": BudgetConfig(target_error=1e-300),
        }
        config, problem = JobConfig(**fields), _small_problem()
        island = Island(problem, config, 0)
        while not island.advance():
            pass
        if island.outcome().hit is None:
            island.immigrate(island.emigrants())
            Island.from_bytes(island.to_bytes(), problem, config, 0).advance()


def _small_problem() -> "Problem":
    """Return a problem that no equation solves, over two variables and enough rows for predictors to be used."""
    import numpy as np

    from atoll.data.dataset import Problem, Target

    numbers = np.arange(_ROWS)
    inputs = np.stack([numbers * 37 % 41 / 8.0 + 0.5, numbers * 29 % 43 / 16.0 - 1.0])
    values = numbers * 31 % 47 / 4.0 - 5.0
    return Problem(("x", "y"), inputs, Target("x", "dx/dt", values, uncertainty=0.0, standard_deviation=3.4))


def _made(directory: Path) -> Path:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(13, "permission denied")
    except OSError as error:
        raise AtollError(
            f"the folder of compiled kernels {directory} cannot be written ({error.strerror}); "
            "set ATOLL_KERNEL_CACHE to one that can"
        ) from error
    return directory


@contextlib.contextmanager
def _locked(path: Path, report: Report) -> Iterator[None]:
    """Hold the machine's one lock on compiling; the system gives it back should the holder die."""
    import fcntl

    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            report("waiting while another process of this machine compiles the kernels")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
