"""The cost of a pursuit: processor seconds and most memory for each equation of drawn systems.

``python -m benchmarks.operations.pursuing --states 2 3 4 --seeds 0-1`` draws random systems of `benchmarks.corpus` with
1 % of noise, prepares them, and searches the sums of each equation, first with the operators of the preset, then with
all operators. Both dictionaries are used when noisy tables are refined. Each system is computed by a process of its
own. To measure another tree, set ``PYTHONPATH`` to its source roots.
"""

import resource
import sys
import time
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from atoll.terminal.output import note, say, table
from atoll_coordinator.model.sparse.pursuit import pursue
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_coordinator.warmup import warm_up
from atoll_core.expression.operators import BY_NAME
from benchmarks.corpus.cases import Key, make_case
from benchmarks.harness.command_line import option, program, seeds, whole
from benchmarks.harness.jobs import configured

PRESET = ("+", "-", "*", "/", "sin", "cos")


@dataclass(frozen=True)
class Cost:
    """Processor seconds for each equation with the operators of the preset and with all operators, the number of sums
    found, and the megabytes of the process before and at most."""

    seconds: tuple[float, float]
    sums: int
    megabytes: tuple[float, float]


def measured(key: Key, most: float) -> Cost:
    """Return the cost of the pursuits of all equations of a drawn system; sums have at most `most` nats."""
    prepared, _ = prepare_job(make_case(key, has_fresh=False).table.to_bytes(), configured(0, {}, {}))
    dataset = prepared.dataset
    dictionaries = [frozenset(BY_NAME[name].code for name in names) for names in (PRESET, BY_NAME)]
    problems = [dataset.problem(name) for name in dataset.variables]
    warm_up(lambda _: None)
    before, seconds, sums = _megabytes(), [0.0, 0.0], 0
    for place, operators in enumerate(dictionaries):
        began = time.process_time()
        for problem in problems:
            sums += len(pursue(problem, range(len(dataset.names)), operators, most=most))
        seconds[place] = (time.process_time() - began) / len(problems)
    return Cost((seconds[0], seconds[1]), sums, (before, _megabytes()))


def _megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


@program(
    "benchmarks.operations.pursuing",
    __doc__,
    option("--states", type=whole, nargs="*", default=[2, 3, 4], help="numbers of states"),
    option("--seeds", type=seeds, default=[0], help="seeds of drawn systems"),
    option("--most", type=float, default=50.0, help="largest price of a sum in nats (%(default)g)"),
)
def main(options: Namespace) -> None:
    """Measure and print."""
    lines = []
    for states in options.states:
        for seed in options.seeds:
            with ProcessPoolExecutor(1, get_context("spawn")) as process:
                key = Key("random", states, 4, "even", "noise-0.01", seed)
                cost = process.submit(measured, key, options.most).result()
            numbers = (*(f"{value:.2f}" for value in cost.seconds), f"{cost.sums}")
            lines.append((f"{states}", f"{seed}", *numbers, *(f"{value:.0f}" for value in cost.megabytes)))
            note(", ".join(lines[-1]))
    say(table(("states", "seed", "preset, cpu s", "all operators, cpu s", "sums", "MB before", "most MB"), lines))


if __name__ == "__main__":
    sys.exit(main())
