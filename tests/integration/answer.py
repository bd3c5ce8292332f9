"""Print what a short search comes to, from the file of measurements to the last digest: run in fresh processes."""

import json
import sys
from hashlib import sha256
from pathlib import Path

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Law, Pool
from atoll_coordinator.model.result.building import Account, VariableOutcome, build_result
from atoll_coordinator.model.sparse.laws import find_all_laws, find_laws_among_many, settled_variables
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig, PredictorConfig
from atoll_core.expression.text.infix import to_infix
from tests.archipelago import search_all

CONFIG = JobConfig(
    seed=11,
    evolution=EvolutionConfig(islands=2, population=16),
    predictors=PredictorConfig(effort=0.2, renewal=3),
    migration=MigrationConfig(generations=20),
    budget=BudgetConfig(target_error=1e-300),
)


def answer(path: Path) -> dict[str, object]:
    """Return the digest of the prepared data, all digests, errors and counters of two epochs of two islands, the laws
    by regression with the bits of all their numbers, which searches end soon by these, and what refining shows.
    """
    preparation = prepare(read_table([path], CONFIG.data), CONFIG)
    dataset, config = preparation.dataset, resolve(CONFIG, preparation.dataset)
    searches = search_all(dataset, config, epochs=2)
    pools = {name: Pool(search.front) for name, search in zip(dataset.variables, searches, strict=True)}
    refinement = refine_all(preparation, config, pools)
    outcomes = [VariableOutcome(name, pool.front, 2) for name, pool in pools.items()]
    result = build_result("j", config, preparation, outcomes, Account("done", 1.0, 1.0), refinement)
    plain = config.model_copy(update={"budget": BudgetConfig()})
    return {
        "laws": {name: [bits(law) for law in laws] for name, laws in find_all_laws(preparation, config, {}).items()},
        "settled": sorted(settled_variables(preparation, plain, find_laws_among_many(preparation, plain))),
        "shown": {name: to_infix(one.program, dataset.names) for name, one in refinement.equations.items()},
        "refined": sha256(result.to_json().encode()).hexdigest(),
        "dataset": dataset.digest,
        "noise": [target.noise.hex() for target in dataset.targets],
        "islands": [search.digests for search in searches],
        "fronts": [[(entry.error.hex(), entry.program.hex()) for entry in search.front] for search in searches],
        "evaluations": [dict(report.counters[-1].evaluations) for search in searches for report in search.reports],
    }


def bits(law: Law) -> list[str]:
    """Return a law with the bits of its numbers."""
    return [law.program.to_bytes().hex(), law.nats.hex(), law.excess.hex()]


if __name__ == "__main__":
    json.dump(answer(Path(sys.argv[1])), sys.stdout)
