"""The constant parts of an island: the problem's rows, the search space, and the settings of fits."""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import Any, Final, get_args
from weakref import WeakKeyDictionary

import numpy as np

from atoll_core.compilation.jit import entry_point
from atoll_core.config import ConstantSteps, JobConfig
from atoll_core.data.dataset import FloatArray, Problem, Target
from atoll_core.errors import LocalProtocolError
from atoll_core.expression.operators import BY_NAME, COS, SIN, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.expression.restrictions import restrictions_of
from atoll_core.search.pareto import FrontEntry
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import (
    MOST_REQUIRED,
    Coevolution,
    Coevolving,
    Fit,
    Rows,
    Scratch,
    Space,
    empty_lists,
    empty_rows,
    empty_scratch,
)

LEAST_INNER = 2
"""Number of constants inside terms that may be fitted with any number of rows. With many rows, a quarter of their
number may be fitted (ADR 0005)."""

LEAST_SHARE = 2
"""An island keeps at least this number of runners-up of each complexity, unless fewer are wanted."""

UNREACHABLE_TARGET = -1.0
"""A target error that no equation reaches."""


SPREAD_ROWS: Final = 64
"""Rows of `EquationSetup.spread`."""

_entries: Final[dict[Callable[..., Any], Callable[..., Any]]] = {}
"""The machine code of each kernel."""


class EquationSetup:
    """The constant parts that all islands with the same rows share; no island changes them.

    The islands only know the variables that their equation may use: `columns` are their places in the whole problem.
    """

    def __init__(self, problem: Problem, config: JobConfig) -> None:
        self.variable = problem.target.variable
        self.columns = config.space.columns_for(self.variable, problem.names)
        self.is_narrowed = len(self.columns) < len(problem.names)
        if self.is_narrowed:
            names = tuple(problem.names[column] for column in self.columns)
            problem = Problem(names, np.ascontiguousarray(problem.inputs[list(self.columns)]), problem.target)
        self.names = problem.names
        self.restrictions = restrictions_of(config, self.variable, problem.names, problem.inputs)
        self.deviation = problem.target.standard_deviation
        self.target = target_error(config, problem.target) * self.deviation
        self.space = _space(problem, config)
        self.allowed = frozenset(int(code) for code in self.space.operators)
        self.keeps_waves = bool(self.allowed & {SIN, COS})
        self.every = padded_rows(problem.inputs, problem.target.values, self.keeps_waves)

    @cached_property
    def spread(self) -> Rows:
        """Return at most `SPREAD_ROWS` rows, evenly spaced over all rows."""
        every = self.every
        index = np.arange(min(every.length, SPREAD_ROWS)) * every.length // min(every.length, SPREAD_ROWS)
        return padded_rows(every.inputs[:, index], every.target[0, index])


_equations: Final[WeakKeyDictionary[Problem, list[tuple[JobConfig, int, EquationSetup]]]] = WeakKeyDictionary()
"""For each problem in use: configurations and groups of rows with their setups."""


def _equation_setup(problem: Problem, config: JobConfig, island: int) -> EquationSetup:
    """Return the setup of an island's equation; it is made once for all islands with this problem and configuration."""
    group = 0 if problem.groups is None else island % (int(problem.groups.max()) + 1)
    known = _equations.setdefault(problem, [])
    for other, of_group, setup in known:
        if other is config and of_group == group:
            return setup
    rows = problem.of_group(group)  # migration brings solutions to islands with the rows of other groups
    known.append((config, group, EquationSetup(rows, config)))
    return known[-1][2]


class IslandSetup:
    """All settings of one island that follow from problem and configuration, in the form that kernels need."""

    def __init__(self, problem: Problem, config: JobConfig, island: int) -> None:
        self.config = config
        self.island = island
        self.equation = equation = _equation_setup(problem, config, island)
        self.variable, self.names, self.every = equation.variable, equation.names, equation.every
        self.restrictions, self.deviation, self.target = equation.restrictions, equation.deviation, equation.target
        self.space, self.allowed = equation.space, equation.allowed
        evolution, predictors = config.evolution, config.predictors
        sample = predictors.rows
        if sample is None:
            raise LocalProtocolError("predictors.rows is not resolved")
        rows = self.every.length
        self.coevolving = Coevolving(
            int(predictors.enabled and rows > 2 * sample), predictors.effort, predictors.renewal,
            int(predictors.agreement == "relative"),
        )  # fmt: skip
        self.sample = sample if self.coevolving.enabled else rows
        self.fit = Fit(
            evolution.constant_fit_steps, evolution.linear_terms, LEAST_INNER, int(evolution.loss != "mae"),
            evolution.constant_fit_gate,
            sum(1 << variable for variable in self.restrictions.required if variable < MOST_REQUIRED),
        )  # fmt: skip
        self.runners_up = island_share(evolution.runners_up or 0, evolution.islands)
        variables = self.space.variables
        waves = 2 * variables if equation.keeps_waves else 0
        self.rows = empty_rows(variables, sample, waves) if self.coevolving.enabled else self.every
        shared = _shared_scratch(
            threading.get_ident(), evolution.population, self.space.nodes, variables, self.sample, rows
        )
        # `settled` is kept between two calls; islands take turns, so each island has its own array.
        self.scratch = shared._replace(settled=np.zeros(evolution.population, np.bool_))

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a kernel whose arguments have the same types in every call, for all islands."""
        entry = _entries.get(function)
        if entry is None:
            entry = _entries[function] = entry_point(function, *arguments)
        return entry(*arguments)

    def outward(self, entry: FrontEntry) -> FrontEntry:
        """Return a front member whose program refers to all variables, for use outside of the island."""
        if not self.equation.is_narrowed:
            return entry
        program = Program.from_bytes(entry.program, len(self.equation.columns))
        left = program.left.copy()
        is_variable = program.operators == VARIABLE
        left[is_variable] = np.array(self.equation.columns, np.int16)[left[is_variable]]
        return replace(entry, program=replace(program, left=left).to_bytes())

    def empty_coevolution(self) -> Coevolution:
        """Return empty predictors and trainers; if predictors are off, one of each, which is not used."""
        predictors = self.config.predictors
        on = bool(self.coevolving.enabled)
        number, trainers = (predictors.predictors, predictors.trainers) if on else (1, 1)
        return Coevolution(
            predictors=np.zeros((number, self.sample if on else 1), np.int64),
            quality=np.zeros(number),
            trainers=empty_lists(trainers, self.space.nodes),
            exact=np.zeros(trainers),
            losses=np.zeros((trainers, self.every.length if on else 1)),
            born=np.zeros(trainers, np.int64),
            best=np.zeros(1, np.int64),
            clock=np.zeros(1, np.int64),
            due=np.zeros(2, np.bool_),
        )


@lru_cache(maxsize=4)
def _shared_scratch(thread: int, population: int, nodes: int, variables: int, sample: int, rows: int) -> Scratch:
    """Return the scratch arrays of all islands of one shape that a thread advances, one at a time.

    No data stay in them between two calls of a kernel. With 100,000 rows they have 40 MB.
    """
    del thread  # as a cache key: each thread has its own arrays
    return empty_scratch(population, nodes, variables, sample, rows)


def island_share(runners_up: int, islands: int) -> int:
    """Return the number of runners-up of each complexity that an island keeps, so that all islands find `runners_up`.

    Solutions are reshuffled, so islands find similar ones: together they keep twice as many as are wanted.
    """
    return min(runners_up, max(LEAST_SHARE, -(-2 * runners_up // islands)))


def target_error(config: JobConfig, target: Target) -> float:
    """Return the normalized error at which the search for an equation ends.

    Without an explicit target error and without noise, it is the error at which an equation has converged. With noise,
    many equations reach the noise level and most of them are wrong: no error ends that search (ADR 0018), and the
    number returned is less than any error.
    """
    asked = config.budget.target_error
    if asked is not None:
        return asked
    return UNREACHABLE_TARGET if target.is_noisy else target.convergence_threshold()


def _space(problem: Problem, config: JobConfig) -> Space:
    terminals, evolution = config.space.terminals, config.evolution
    operators = config.space.operators_for(problem.target.variable)
    if terminals is None:
        raise LocalProtocolError("space.terminals is not resolved")
    return Space(
        terminals=terminals,
        nodes=terminals + config.space.operator_nodes,
        variables=problem.inputs.shape[0],
        operators=np.array(sorted({BY_NAME[name].code for name in operators}), np.int64),
        scales=_scales(problem) if evolution.scaled_constants else np.zeros(0),
        crossover=evolution.crossover,
        mutation=evolution.mutation,
        steps=get_args(ConstantSteps).index(evolution.constant_steps),
        moves=evolution.constant_moves,
    )


def _scales(problem: Problem) -> FloatArray:
    """Return the scales of columns and of the target that are below 1/64 or above 64.

    The scale of a column is the power of two above its mean magnitude. If there is no such scale, 1 is returned,
    because an empty array means constants in [-10, 10].
    """
    scales = [_power_of_two(column) for column in (*problem.inputs, problem.target.values)]
    unusual = [scale for scale in scales if not 1 / 64 <= scale <= 64]
    return np.array(unusual or [1.0])


def _power_of_two(column: FloatArray) -> float:
    (total,) = deque(accumulate(map(abs, column.tolist())), maxlen=1)  # numbers are added in order, one by one
    mean = total / len(column)
    return math.ldexp(1.0, math.frexp(mean)[1]) if mean > 0.0 else 1.0
