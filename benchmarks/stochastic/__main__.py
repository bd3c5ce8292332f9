"""``python -m benchmarks.stochastic``: drift and diffusion of six processes, 10,000 steps each, through the service.

``--peer PYTHON`` names the interpreter of an environment with the packages ``kramersmoyal`` and ``scipy``, by which the
same paths are then treated as well.
"""

import json
import sys
import time
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.result.result import Account, VariableOutcome, build_result
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.command_line import OUT, option, program, seeds_of
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.tables import grouped
from benchmarks.stochastic.judging import Judged, judge
from benchmarks.stochastic.peers import METHODS, Estimate, estimate
from benchmarks.stochastic.processes import PROCESSES, SUBSTEPS, simulate
from benchmarks.stochastic.processes import table as table_of

HEADS = ("process", "equation", "seeds", "right", "said good", "good but wrong", "covered", "of", "error")


def _searched(searches: Searches, case: str, seed: int, substeps: int) -> list[Judged]:
    """Return what a search makes of the paths of one seed, and say it."""
    process = PROCESSES[case]
    paths = simulate(process, seed, substeps=substeps)
    result = searches.solve(f"{case} {seed}", table_of(process, paths), _config(seed))
    return _said(case, seed, paths, result["equations"], result["seconds"])


def _chosen(case: str, seed: int, substeps: int) -> list[Judged]:
    """Return what the choice of equations makes of the paths of one seed without programs of a search, and say it."""
    process, began = PROCESSES[case], time.process_time()
    paths, config = simulate(process, seed, substeps=substeps), _config(seed)
    preparation = prepare(table_of(process, paths), config)
    refinement = refine_all(preparation, config, {})
    outcomes = [VariableOutcome(name, (), 0, refined=refinement.equations.get(name))
                for name in preparation.dataset.variables]  # fmt: skip
    account = Account("done", 0.0, 0.0)
    result = build_result(f"{case} {seed}", config, preparation, outcomes, account, refinement)
    return _said(case, seed, paths, json.loads(result.to_json())["equations"], time.process_time() - began)


def _config(seed: int) -> JobConfig:
    return JobConfig(seed=seed, data=DataConfig(stochastic=True))


def _said(
    case: str, seed: int, paths: Sequence[FloatArray], equations: Sequence[Mapping[str, Any]], seconds: float
) -> list[Judged]:
    found = judge(case, PROCESSES[case], seed, np.concatenate(paths, axis=1), equations)
    right = sum(each.is_right for each in found)
    note(f"{case} seed {seed}: {right} of {len(found)} right in {seconds:.1f} s")
    for each in found:
        if not each.is_right:
            note(f"  {each.equation} = {each.found} ({each.verdict})")
    return found


def _rows(judged: Sequence[Judged]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for (case, equation), found in grouped(judged, lambda each: (each.case, each.equation)).items():
        intervals = [is_covered for each in found for is_covered in each.is_covered]
        good = [each for each in found if each.verdict == "good"]
        wrong = sum(not each.is_right for each in good)
        counts = (len(found), sum(each.is_right for each in found), len(good), wrong, sum(intervals), len(intervals))
        error = float(np.median([each.error for each in found]))
        rows.append((case, equation, *map(str, counts), f"{100.0 * error:.1f} %"))
    return rows


def _peer_rows(estimates: Sequence[Estimate]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for (case, equation), made in grouped(estimates, lambda each: (each.case, each.equation)).items():
        for method in METHODS:
            own = [estimate for estimate in made if estimate.method == method]
            right = "-" if any(each.is_right is None for each in own) else str(sum(bool(each.is_right) for each in own))
            error = float(np.median([each.error for each in own]))
            rows.append((case, equation, method, str(len(own)), right, f"{100.0 * error:.1f} %"))
    return rows


@program(
    "benchmarks.stochastic",
    __doc__,
    seeds_of("1000-1009", "such as 0-4 (1000-1009)"),
    option("--processes", nargs="*", choices=[*PROCESSES], default=[*PROCESSES], metavar="NAME"),
    option("--workers", type=int, default=2, help="worker processes (%(default)s); 0: peers alone"),
    option("--without-search", action="store_true", help="candidates of regression alone, in this process; no workers"),
    option("--substeps", type=int, default=SUBSTEPS, help="of each step; 1: Euler and Maruyama's tables (%(default)s)"),
    option("--peer", metavar="PYTHON", help="interpreter with kramersmoyal"),
    OUT,
    description=__doc__,
)
def main(options: Namespace) -> None:
    """Run what the command line asks for."""
    record = Record("stochastic", options.words, options.out)
    judged: list[Judged] = []
    estimates: list[Estimate] = []
    if options.without_search:
        for seed in options.seeds:
            for case in options.processes:
                judged += _chosen(case, seed, options.substeps)
                record.write(judged=[asdict(each) for each in judged])
    elif options.workers:
        with searching(options.workers) as searches:
            for seed in options.seeds:
                for case in options.processes:
                    judged += _searched(searches, case, seed, options.substeps)
                    record.write(judged=[asdict(each) for each in judged])
    for case in options.processes if options.peer else ():
        for seed in options.seeds:
            estimates += estimate(options.peer, case, seed)
            record.write(judged=[asdict(each) for each in judged], peers=[asdict(each) for each in estimates])
    say(table(HEADS, _rows(judged)) if judged else "")
    if estimates:
        say(table(("process", "equation", "method", "seeds", "right", "error"), _peer_rows(estimates)))
    say(f"load {load():.1f}")


if __name__ == "__main__":
    sys.exit(main())
