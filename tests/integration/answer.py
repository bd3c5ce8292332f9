"""Print what a short search comes to, from the file of measurements to the last digest: run in fresh processes."""

import json
import sys
from pathlib import Path

from atoll.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig, PredictorConfig
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.service.jobs.defaults import resolve
from tests.archipelago import search_all

CONFIG = JobConfig(
    seed=11,
    evolution=EvolutionConfig(islands=2, population=16),
    predictors=PredictorConfig(effort=0.2, renewal=3),
    migration=MigrationConfig(generations=20),
    budget=BudgetConfig(target_error=1e-300),
)


def answer(path: Path) -> dict[str, object]:
    """Return the digest of the prepared data, and all digests, errors and counters of two epochs of two islands."""
    dataset = prepare(read_table([path], CONFIG.data), CONFIG).dataset
    searches = search_all(dataset, resolve(CONFIG, dataset), epochs=2)
    return {
        "dataset": dataset.digest,
        "noise": [target.noise.hex() for target in dataset.targets],
        "islands": [search.digests for search in searches],
        "fronts": [[(entry.error.hex(), entry.program.hex()) for entry in search.front] for search in searches],
        "evaluations": [dict(outcome.evaluations) for search in searches for outcome in search.outcomes],
    }


if __name__ == "__main__":
    json.dump(answer(Path(sys.argv[1])), sys.stdout)
