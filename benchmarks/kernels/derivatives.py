"""How good the derivatives are that a search is given: the truth's error beside the estimated floor.

``python -m benchmarks.kernels.derivatives --step 0.02 --seeds 0-4`` prints, per system, data seed and equation: the
rows kept, the truth's normalized mean absolute error, the floor, their ratio (a search counts as converged at max(1e-9,
twice the floor), so the ratio must stay below 2), and the share of the range of each derivative that the kept rows
still cover.
"""

import time
from argparse import Namespace

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS, JobConfig
from atoll_core.data.dataset import Dataset
from benchmarks.harness.command_line import option, program, seeds_of
from benchmarks.harness.systems import SYSTEMS, TABLE_III, FloatArray, Sampled, table_of, trajectories

SMALLEST = 1e-9
"""Normalized error that always counts as converged."""


def truth_of(system: str, dataset: Dataset) -> FloatArray:
    """Return the true right-hand sides (S, R) at the rows of `dataset`."""
    x, y = dataset.inputs
    with np.errstate(all="ignore"):
        slopes = np.array([SYSTEMS[system].field(*state) for state in zip(x, y, strict=True)]).T
    return slopes[-1:] if SYSTEMS[system].measured else slopes


def report(system: str, step: float, seed: int, noise: float, config: JobConfig) -> list[float]:
    """Print one line per equation of a system and return the ratios of truth error to floor."""
    sampled = trajectories(system, step, seed, noise)
    begun = time.perf_counter()
    dataset = prepare(table_of(sampled), config).dataset
    seconds = time.perf_counter() - begun
    truths = truth_of(system, dataset)
    everything = sum(len(each) for each in sampled.times)
    ratios = []
    for target, truth in zip(dataset.targets, truths, strict=True):
        error = np.abs(target.values - truth) / target.standard_deviation
        ratio = float(error.mean()) / max(0.5 * SMALLEST, target.uncertainty)
        ratios.append(ratio)
        covered = _covered(system, sampled, truth, target.variable)
        print(
            f"{system:22} {seed:4} {target.lhs:12} {len(truth) / everything:6.3f} {error.mean():9.1e} "
            f"{target.uncertainty:9.1e} "
            f"{ratio:7.3f} {error.max():9.1e} {target.noise:8.1e} {covered:6.2f} {seconds:6.3f}"
        )
    return ratios


def _covered(system: str, sampled: Sampled, kept: FloatArray, variable: str) -> float:
    """Return the range of the derivative on the rows kept over its range between the 1 % quantiles of all rows."""
    if SYSTEMS[system].measured:
        return float("nan")
    values = np.concatenate(sampled.values)
    with np.errstate(all="ignore"):
        slopes = np.array([SYSTEMS[system].field(x, y) for x, y in values])
    everything = slopes[:, sampled.names.index(variable)]
    low, high = np.quantile(everything, [0.01, 0.99])
    return float((kept.max() - kept.min()) / (high - low))


@program(
    "benchmarks.kernels.derivatives",
    __doc__,
    option("--step", type=float, default=0.02),
    seeds_of("0-4", "one seed or a range such as 0-4"),
    option("--noise", type=float, default=0.0),
    option("--preset", choices=PRESETS, default="default"),
    option("--system", choices=SYSTEMS, action="append", help="repeat for several; default: Table III"),
)
def main(options: Namespace) -> None:
    """Print the table for all systems and seeds, and the worst ratio."""
    print(
        f"{'system':22} {'seed':>4} {'equation':12} {'kept':>6} {'truth':>9} {'floor':>9} {'ratio':>7} {'worst':>9} "
        f"{'noise':>8} {'range':>6} {'s':>6}"
    )
    ratios: list[float] = []
    for system in options.system or TABLE_III:
        config = PRESETS[options.preset]
        order = 2 if SYSTEMS[system].measured else 1
        config = config.model_copy(update={"data": config.data.model_copy(update={"order": order})})
        for seed in options.seeds:
            ratios += report(system, options.step, seed, options.noise, config)
    print(f"largest ratio {max(ratios):.3f}; {sum(ratio > 1.0 for ratio in ratios)} of {len(ratios)} above 1")


if __name__ == "__main__":
    main()
