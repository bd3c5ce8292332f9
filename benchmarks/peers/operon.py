"""One search by Operon, to a target error, for a comparison side by side.

``python -m benchmarks.peers.operon FILE.csv --seed S`` prints one JSON object (`Run`). It needs pyoperon, which the
extra ``bench`` installs. Operon (B. Burlacu, G. Kronberger, M. Kommenda, *Operon C++*, GECCO 2020) is used by its own
classes rather than by the regressor of scikit-learn's kind that it brings along, since only so a search can end at the
first generation whose best model meets the target; the parts are put together as that regressor does.

The target is the mean absolute error on all rows over the standard deviation of the label, as for our own searches.
After each generation the best model, scaled by least squares as Operon's own objective scales it, is measured in
double precision. The time goes from the first object to that moment; loading the library and a search of one
generation beforehand, which starts its threads, are not counted.
"""

import importlib.util
import json
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError, UsageError
from benchmarks.harness.command_line import option, program

THREADS: Final = 2
POPULATION: Final = 1000
TOURNAMENT: Final = 5
MAX_LENGTH: Final = 50
MAX_DEPTH: Final = 10
INITIAL_LENGTH: Final = 10
FIT_STEPS: Final = 5
"""Levenberg-Marquardt iterations for each offspring."""

CROSSOVER: Final = 1.0
MUTATION: Final = 0.25
INTERNAL_CROSSOVER: Final = 0.9

_ENDLESS: Final = 10**9
_NEVER: Final = 10**12
_END_LIMIT_S: Final = 30.0
"""How much longer than its limit a process may take to start and to end."""


@dataclass(frozen=True)
class Run:
    """How a search came out.

    `seconds` is the time to the target, None when it was not met; `elapsed` that to the end; `processor_seconds` what
    all threads used until then, which other programs on the machine hardly change. `error` is the one of the last best
    model, None when it had none that is finite everywhere.
    """

    seconds: float | None
    elapsed: float
    processor_seconds: float
    error: float | None
    generations: int
    evaluations: int
    expression: str


@dataclass
class _Watch:
    """Looks at the best model after each generation, and ends the search at the target or the limit of time."""

    label: FloatArray
    target_error: float
    limit: float
    begun: float = field(default_factory=time.perf_counter)
    begun_processor: float = field(default_factory=time.process_time)
    error: float | None = None
    met: float | None = None

    def look(self, values: FloatArray) -> bool:
        """Take in the values (R,) of the best model; whether the search is over."""
        self.error = scaled_error(values, self.label)
        now = time.perf_counter() - self.begun
        if self.met is None and self.error is not None and self.error < self.target_error:
            self.met = now
        return self.met is not None or now > self.limit


def scaled_error(values: FloatArray, label: FloatArray) -> float | None:
    """Return the mean of |a f + b - label| over label's deviation, a and b by least squares; None if not finite."""
    if not np.isfinite(values).all():
        return None
    around, sought = values - np.mean(values), label - np.mean(label)
    spread = float(np.mean(around**2))
    factor = float(np.mean(around * sought)) / spread if spread > 0.0 else 0.0
    return float(np.mean(np.abs(factor * around - sought)) / np.std(label))


class _Parts:
    """Operon's objects for one problem: they refer to each other by address, so that all are kept here."""

    def __init__(self, inputs: FloatArray, label: FloatArray, seed: int, generations: int) -> None:
        """Put a search together for `inputs` (R, V) and `label` (R,)."""
        import pyoperon as op

        self.op = op
        self.dataset = op.Dataset(np.asfortranarray(np.column_stack((inputs, label))))
        self.rows = op.Range(0, self.dataset.Rows)
        *variables, target = sorted(self.dataset.Variables, key=lambda variable: variable.Index)
        self.hashes = [variable.Hash for variable in variables]
        self.problem = op.Problem(self.dataset)
        self.problem.TrainingRange = self.rows
        self.problem.TestRange = op.Range(self.dataset.Rows - 1, self.dataset.Rows)
        self.problem.Target = target
        self.problem.InputHashes = self.hashes
        kind = op.NodeType
        kinds = (kind.Add, kind.Sub, kind.Mul, kind.Div, kind.Sin, kind.Cos, kind.Constant, kind.Variable)
        self.problem.ConfigurePrimitiveSet(sum(map(int, kinds)))
        self.table = op.DispatchTable()
        self.evaluator = op.Evaluator(self.problem, self.table, op.NMSE(), True)
        self.evaluator.Budget = _NEVER
        self.random = op.RandomGenerator(np.uint64(seed))
        self._assemble(seed, generations)

    def _assemble(self, seed: int, generations: int) -> None:
        op = self.op
        primitives = self.problem.PrimitiveSet
        creator = op.BalancedTreeCreator(primitives, self.hashes, 0.0)
        coefficients = op.NormalCoefficientInitializer()
        coefficients.ParameterizeDistribution(0, 1)
        least, _ = primitives.FunctionArityLimits()
        initializer = op.UniformLengthTreeInitializer(creator)
        initializer.ParameterizeDistribution(least + 1, INITIAL_LENGTH)
        initializer.MinDepth, initializer.MaxDepth = 1, 1000
        comparison = op.SingleObjectiveComparison(0)
        selectors = [op.TournamentSelector(comparison) for _ in range(2)]
        for selector in selectors:
            selector.TournamentSize = TOURNAMENT
        reinserter = op.KeepBestReinserter(comparison)
        crossover = op.SubtreeCrossover(INTERNAL_CROSSOVER, MAX_DEPTH, MAX_LENGTH)
        mutations, kinds = op.MultiMutation(), self._mutations(creator, coefficients)
        for kind in kinds:
            mutations.Add(kind, 1.0)
        optimizer = op.LMOptimizer(self.table, self.problem, FIT_STEPS, 0)
        fit = op.CoefficientOptimizer(optimizer)
        generator = op.BasicOffspringGenerator(self.evaluator, crossover, mutations, *selectors, fit)
        config = op.GeneticAlgorithmConfig(
            generations=generations, max_evaluations=_NEVER, local_iterations=FIT_STEPS, population_size=POPULATION,
            pool_size=POPULATION, p_crossover=CROSSOVER, p_mutation=MUTATION, epsilon=0.0, seed=seed,
        )  # fmt: skip
        self.search = op.GeneticProgrammingAlgorithm(
            config, self.problem, initializer, coefficients, generator, reinserter
        )
        self._kept = (primitives, creator, coefficients, initializer, comparison, selectors, reinserter, crossover)
        self._kept_too = (mutations, kinds, optimizer, fit, generator, config)

    def _mutations(self, creator: Any, coefficients: Any) -> list[Any]:
        op, primitives = self.op, self.problem.PrimitiveSet
        one, many, discrete = op.NormalOnePointMutation(), op.NormalMultiPointMutation(), op.DiscretePointMutation()
        for point_mutation in (one, many):
            point_mutation.ParameterizeDistribution(0, 1)
        for constant in op.Math.Constants:
            discrete.Add(constant, 1.0)
        return [
            one,
            many,
            discrete,
            op.ChangeVariableMutation(self.hashes),
            op.ChangeFunctionMutation(primitives),
            op.InsertSubtreeMutation(creator, coefficients, MAX_DEPTH, MAX_LENGTH),
            op.ReplaceSubtreeMutation(creator, coefficients, MAX_DEPTH, MAX_LENGTH),
            op.RemoveSubtreeMutation(primitives),
        ]

    def values(self) -> FloatArray:
        """Return the values (R,) of the best model."""
        return np.asarray(self.op.Evaluate(self.table, self.search.BestModel.Genotype, self.dataset, self.rows), float)

    def expression(self) -> str:
        """Return the best model as text, before scaling."""
        names = {hash_: f"v{index}" for index, hash_ in enumerate(self.hashes)}
        return str(self.op.InfixFormatter.Format(self.search.BestModel.Genotype, names, 6))


def search(inputs: FloatArray, label: FloatArray, seed: int, target_error: float, limit: float) -> Run:
    """Search for `label` (R,) over `inputs` (R, V) until `target_error` is met or `limit` seconds have passed."""
    warm = _Parts(inputs, label, seed, 1)
    warm.search.Run(warm.random, None, THREADS, False)
    watch = _Watch(label, target_error, limit)
    parts = _Parts(inputs, label, seed, _ENDLESS)

    def look() -> None:
        if watch.look(parts.values()):
            parts.evaluator.Budget = 0  # ends the search after this generation

    parts.search.Run(parts.random, look, THREADS, False)
    return Run(
        seconds=watch.met,
        elapsed=time.perf_counter() - watch.begun,
        processor_seconds=time.process_time() - watch.begun_processor,
        error=watch.error,
        generations=int(parts.search.Generation),
        evaluations=int(parts.evaluator.CallCount),
        expression=parts.expression(),
    )


def require() -> None:
    """Raise UsageError unless pyoperon is installed."""
    if importlib.util.find_spec("pyoperon") is None:
        raise UsageError("pyoperon is not installed, which a comparison with Operon needs; pip install -e '.[bench]'")


def search_apart(file: Path, seed: int, target_error: float, limit: float) -> Run:
    """Search in a process of its own, of which nothing remains; raises AtollError where it fails, or does not end."""
    options = ["--seed", str(seed), "--target-error", repr(target_error), "--max-time", repr(limit)]
    command = [sys.executable, "-m", "benchmarks.peers.operon", str(file), *options]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=limit + _END_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        raise AtollError(f"Operon did not end within {limit + _END_LIMIT_S:.0f} s on {file.name}") from None
    if ended.returncode != 0:
        raise AtollError(f"Operon failed on {file.name} with code {ended.returncode}: {ended.stderr.strip()[-300:]}")
    return Run(**json.loads(ended.stdout))


@program(
    "benchmarks.peers.operon",
    __doc__,
    option("file", type=Path, help="CSV with a header, the label in the first column"),
    option("--seed", type=int, default=0),
    option("--target-error", type=float, default=1e-4, help="mean absolute error over deviation (1e-4)"),
    option("--max-time", type=float, default=60.0, metavar="SECONDS", help="end of the search (60)"),
)
def main(options: Namespace) -> int:
    """Search the label of one file and print how it came out; return 0."""
    label, *inputs = np.loadtxt(options.file, delimiter=",", skiprows=1, unpack=True)
    run = search(np.column_stack(inputs), label, options.seed, options.target_error, options.max_time)
    sys.stdout.write(json.dumps(asdict(run)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
