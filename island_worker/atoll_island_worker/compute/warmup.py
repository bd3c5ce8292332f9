"""Prepares the kernels of the search before work arrives: compiled once per machine, loaded afterwards."""

import hashlib
from typing import TYPE_CHECKING, Final

from atoll_core.compilation.cache import compile_or_load
from atoll_core.compilation.progress import Report

if TYPE_CHECKING:
    from atoll_core.data.dataset import Problem

_PACKAGE: Final = "atoll_island_worker"
_ROWS: Final = 40
COSTS: Final = {
    "_apply": 2.6, "gather": 0.6, "random_population": 0.5, "draw_coevolution": 0.4, "train": 2.1, "judge_all": 0.4,
    "measure_all": 8.6, "advance": 9.4, "most_disputed": 2.3, "choose_offers": 2.6, "refit_offers": 4.0,
    "write_variant": 1.8, "refit": 1.4, "choose_near": 1.8, "structure_hash": 0.1,
}  # fmt: skip
"""The separately compiled kernels that an epoch needs, and the seconds of a processor that each took on one machine
(``python -m benchmarks.kernels.compiling``)."""


def warm_up(report: Report) -> None:
    """Compile or load every kernel that an epoch needs, by running a very small epoch for each preset.

    Raises:
        AtollError: the cache of compiled kernels cannot be written.
    """
    compile_or_load(_PACKAGE, run_small_epochs, COSTS, report)


def run_small_epochs() -> str:
    """Run one small epoch of one island for each preset, and the steps between two epochs.

    Return a digest of the last states of the islands.
    """
    from atoll_core.config import PRESETS, BudgetConfig, JobConfig, MigrationConfig
    from atoll_island_worker.evolution.island import Island

    digest = hashlib.blake2b(digest_size=16)
    for preset in PRESETS.values():
        kept = preset.evolution.runners_up
        runners_up = 1 if kept is None else kept  # None: kept with noise, which has kernels of its own
        fields = {
            **{name: getattr(preset, name) for name in JobConfig.model_fields},
            "space": preset.space.model_copy(update={"terminals": 7}),
            "evolution": preset.evolution.model_copy(update={"islands": 1, "population": 16, "runners_up": runners_up}),
            "predictors": preset.predictors.model_copy(update={"rows": 16, "renewal": 2, "effort": 0.5}),
            "migration": MigrationConfig(generations=20),
            "budget": BudgetConfig(target_error=1e-300),
        }
        config, problem = JobConfig(**fields), _small_problem()
        island = Island(problem, config, 0)
        while not island.advance():
            pass
        if island.report().hit is None:
            island.immigrate(island.emigrants())
            Island.from_bytes(island.to_bytes(), problem, config, 0).advance()
        digest.update(island.to_bytes())
    return digest.hexdigest()


def _small_problem() -> "Problem":
    """Return a problem without an exact solution, over two variables and enough rows for predictors."""
    import numpy as np

    from atoll_core.data.dataset import Problem, Target

    numbers = np.arange(_ROWS)
    inputs = np.stack([numbers * 37 % 41 / 8.0 + 0.5, numbers * 29 % 43 / 16.0 - 1.0])
    values = numbers * 31 % 47 / 4.0 - 5.0
    return Problem(("x", "y"), inputs, Target("x", "dx/dt", values, uncertainty=0.0, standard_deviation=3.4))
