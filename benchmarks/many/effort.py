"""How search effort is spread over equations by need: eight equations with laws, and one without.

The real islands, in the world of the simulation tests, in one process and unrefined: each equation that has a law ends
after its first epoch, with one and with three workers; and, as it was before, with all equations or none.
"""

from argparse import Namespace
from unittest.mock import patch

from atoll.terminal.output import say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.sparse import product_laws
from atoll_core.config import JobConfig
from benchmarks.many.campaign import case
from tests.simulation.harness.simulated_cluster import World
from tests.simulation.test_real_islands import RealCompute, unrefined


def run(options: Namespace) -> None:
    """Print point evaluations of each seed, of all equations and of the one without a law, and digests."""
    rows = [row for seed in options.seeds for row in _searched(seed)]
    say(table(("seed", "rule", "workers", "evaluations", "of h", "epochs", "digest"), rows))


def _searched(seed: int) -> list[tuple[str, ...]]:
    its = case("uneven", 0.0, seed, Namespace(runs=None, max_time=None, dysts=None))
    preparation = prepare(its.table, its.config)
    settled = product_laws.settled_variables(
        preparation, its.config, product_laws.laws_among_many(preparation, its.config)
    )
    return [_row(seed, "each", workers, preparation, its.config, settled) for workers in (1, 3)] + [
        _row(seed, "all or none", 1, preparation, its.config, frozenset())
    ]


def _row(
    seed: int, rule: str, workers: int, preparation: Preparation, config: JobConfig, settled: frozenset[str]
) -> tuple[str, ...]:
    with patch.object(product_laws, "settled_variables", lambda *_: settled):
        world = World(workers, seed, compute=RealCompute, prepare=lambda *_: preparation, refiner=unrefined)
        result = world.run(config)
    points = {equation["variable"]: equation["point_evaluations"] for equation in result["equations"]}
    epochs = [str(each["epoch"]) for each in result["equations"]]
    return (
        str(seed), rule, str(workers), f"{sum(points.values()):.3g}", f"{points['h']:.3g}", " ".join(epochs),
        result["digest"][:8],
    )  # fmt: skip
