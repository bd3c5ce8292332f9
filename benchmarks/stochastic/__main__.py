"""``python -m benchmarks.stochastic``: drift and diffusion from paths of 10,000 steps, through the service."""

import sys
import time
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.result.building import Account, VariableOutcome, build_result
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.command_line import OUT, option, program, seeds_of, workers
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import table_of
from benchmarks.harness.tables import grouped
from benchmarks.stochastic.judging import Judged, judge
from benchmarks.stochastic.processes import PROCESSES, SUBSTEPS, sampled, simulate

HEADS = ("process", "equation", "seeds", "right", "said good", "good but wrong", "covered", "of", "error")


def _judged(searches: Searches | None, case: str, seed: int, substeps: int) -> list[Judged]:
    """Return what is made of the paths of one seed, by a search or by the choice of equations alone, and say it."""
    process, began = PROCESSES[case], time.process_time()
    paths = simulate(process, seed, substeps=substeps)
    measured, config = table_of(sampled(process, paths)), JobConfig(seed=seed, data=DataConfig(stochastic=True))
    if searches is not None:
        result = searches.solve(f"{case} {seed}", measured, config)
        return _said(case, seed, paths, result["equations"], result["seconds"])
    preparation = prepare(measured, config)
    refinement = refine_all(preparation, config, {})
    outcomes = [VariableOutcome(name, (), 0) for name in preparation.dataset.variables]
    account = Account("done", 0.0, 0.0)
    chosen = build_result(f"{case} {seed}", config, preparation, outcomes, account, refinement)
    equations: Any = chosen.as_dict()["equations"]
    return _said(case, seed, paths, equations, time.process_time() - began)


def _said(
    case: str, seed: int, paths: Sequence[FloatArray], equations: Sequence[Mapping[str, Any]], seconds: float
) -> list[Judged]:
    judged = judge(case, PROCESSES[case], seed, np.concatenate(paths, axis=1), equations)
    right = sum(equation.is_right for equation in judged)
    note(f"{case} seed {seed}: {right} of {len(judged)} right in {seconds:.1f} s")
    for equation in judged:
        if not equation.is_right:
            note(f"  {equation.equation} = {equation.found} ({equation.verdict})")
    return judged


def _rows(judged: Sequence[Judged]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for (case, name), alike in grouped(judged, lambda equation: (equation.case, equation.equation)).items():
        intervals = [is_covered for equation in alike for is_covered in equation.is_covered]
        right = sum(equation.is_right for equation in alike)
        good = [equation for equation in alike if equation.verdict == "good"]
        wrong = sum(not equation.is_right for equation in good)
        counts = (len(alike), right, len(good), wrong, sum(intervals), len(intervals))
        error = float(np.median([equation.error for equation in alike]))
        rows.append((case, name, *map(str, counts), f"{100.0 * error:.1f} %"))
    return rows


@program(
    "benchmarks.stochastic",
    __doc__,
    seeds_of("1000-1009", "such as 0-4 (1000-1009)"),
    option("--processes", nargs="*", choices=[*PROCESSES], default=[*PROCESSES], metavar="NAME"),
    workers(),
    option("--without-search", action="store_true", help="candidates of regression alone, in this process; no workers"),
    option("--substeps", type=int, default=SUBSTEPS, help="of each step; 1: Euler and Maruyama's tables (%(default)s)"),
    OUT,
)
def main(options: Namespace) -> None:
    """Run what the command line asks for."""
    record = Record("stochastic", options.words, options.out)
    judged: list[Judged] = []
    with ExitStack() as stack:
        searches = None if options.without_search else stack.enter_context(searching(options.workers))
        for seed in options.seeds:
            for case in options.processes:
                judged += _judged(searches, case, seed, options.substeps)
                record.write(judged=[asdict(equation) for equation in judged])
    say(table(HEADS, _rows(judged)))
    say(f"load {load():.1f}")


if __name__ == "__main__":
    sys.exit(main())
