"""The laws of states by sparse regression: the rows to which an equation is fitted, and the libraries that are tried.

How it works. There are three cases. Few variables (all products up to the fourth degree fit in a library): laws are
sums of products. If there is no noise, they are fitted to derivatives. If there is noise, they are fitted in the weak
form and compared with other programs. Many variables: laws are short sums of products and functions. First each
equation is fitted independently. Then it is fitted again with functions of the other laws, since a flux that leaves one
state enters another. Dozens of variables: forward selection first chooses the variables of each equation.

Doubts. A law is only assessed by the residuals of its regression; `selection` tests it along trajectories later. A sum
of products can approximate another function within the noise: see `Law.lead`.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import Preparation, Recording, by_group
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.description_length import constant_nats_of, log, structure_length
from atoll_coordinator.model.pools import Law, LawsByGroup, may_be_shown
from atoll_coordinator.model.sparse.atoms import (
    Product,
    polynomial_libraries,
    product_atoms,
    products,
    products_of,
    program_atom,
)
from atoll_coordinator.model.sparse.many_variables import UnknownEquation, find_short_laws, window_rows
from atoll_coordinator.model.sparse.regression import (
    SparseRegression,
    WeightedProducts,
    eliminate_columns,
    select_forward,
)
from atoll_coordinator.model.sparse.rows import (
    MeasuredRows,
    RateRows,
    RegressionRows,
    half_width,
    measured_rows_of,
    rate_rows,
    weak_rows,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Problem
from atoll_core.expression.operators import ADD, BY_NAME, MULTIPLY
from atoll_core.expression.program import MAX_NODES, Program, constant_places, structure
from atoll_core.expression.writing.shortest import collected

_DEGREES: Final = range(1, SETTINGS.sparse.degree + 1)
_PROGRAMS_OF_A_BATCH: Final = 16
"""Most programs of a batch that are compared with laws: each takes a few milliseconds."""


# --------------------------------------------------------------------------------------------- laws of all states


def find_all_laws(
    preparation: Preparation,
    config: JobConfig,
    others: Mapping[str, Sequence[Program]],
    among_many: LawsByGroup | None = None,
    spread: Spread | None = None,
) -> dict[str, tuple[Law, ...]]:
    """Return the laws of each variable without a known equation, in the order of the groups of trajectories.

    Args:
        preparation: the derivatives on the rows of the search, and the recording of their states.
        config: the resolved configuration.
        others: programs by variable with which laws are compared if there is noise.
        among_many: the result of `find_laws_among_many`; None: it is computed here.
        spread: computes in threads or on workers; None: one after another.
    """
    by_variable: dict[str, tuple[Law, ...]] = {}
    spread = spread or Spread()
    among_many = find_laws_among_many(preparation, config, spread) if among_many is None else among_many
    for part, known in zip(_parts(preparation), among_many, strict=True):
        for name, laws in _find_laws_of_part(part, config, others, known, spread).items():
            by_variable[name] = by_variable.get(name, ()) + laws
    return by_variable


def find_laws_among_many(preparation: Preparation, config: JobConfig, spread: Spread | None = None) -> LawsByGroup:
    """Return the laws among many variables, by group of trajectories; empty mappings for few variables.

    `spread` computes equations in threads or on workers; None: one after another. These laws are not compared with
    other programs. Finding them is most of the work of `find_all_laws`. It is done when a job is prepared, and the
    result is passed on to refining.
    """
    return [_find_laws_among_many(part, config, spread or Spread()) for part in _parts(preparation)]


def _parts(preparation: Preparation) -> Sequence[Preparation]:
    """Return the preparation of each group of trajectories. If there are no groups, return the whole preparation."""
    return tuple(by_group(preparation)) or (preparation,)


def _find_laws_of_part(
    part: Preparation,
    config: JobConfig,
    others: Mapping[str, Sequence[Program]],
    among_many: Mapping[str, tuple[Law, ...]],
    spread: Spread,
) -> dict[str, tuple[Law, ...]]:
    dataset, recording = part.dataset, part.recording
    assert recording is not None

    def found(name: str, columns: Sequence[int], operators: Collection[int]) -> tuple[Law, ...]:
        alone = (dataset.problem(name), recording, columns, operators, others.get(name, ()))
        return among_many.get(name) or find_laws(*alone, spread)

    spaces = _spaces(dataset, config)
    calls = [partial(found, name, *space) for name, space in spaces.items()]
    return dict(zip(spaces, spread.run_calls(calls), strict=True))


def _spaces(dataset: Dataset, config: JobConfig) -> dict[str, tuple[tuple[int, ...], frozenset[int]]]:
    """Return, for each variable without a known equation, the indices of allowed variables and the codes of allowed
    operators."""
    space = config.space
    return {
        name: (
            space.columns_for(name, dataset.names),
            frozenset(BY_NAME[operator].code for operator in space.operators_for(name)),
        )
        for name in dataset.variables
        if name not in config.prior.known and name not in config.prior.equations
    }


def settled_variables(
    preparation: Preparation, config: JobConfig, among_many: LawsByGroup, spread: Spread | None = None
) -> frozenset[str]:
    """Return the variables whose laws are so certain that no long search is needed.

    The residuals of these laws are like noise, and the laws were fitted to more rows than systems are compared on. With
    many variables, each equation is settled independently. With few variables, either all equations are settled or no
    equation is, since a search with few variables is short. The result is empty if the user has set an end of the
    search, or guesses. `among_many` is the result of `find_laws_among_many`; `spread` computes in threads or on
    workers, None: one after another.
    """
    budget = config.budget
    is_asked = budget.target_error is not None or budget.stagnation is not None or bool(config.prior.guesses)
    if preparation.recording is None or is_asked:
        return frozenset()
    parts = zip(_parts(preparation), among_many, strict=True)
    spread = spread or Spread()
    return frozenset.intersection(*(_settled_variables(part, config, laws, spread) for part, laws in parts))


def _settled_variables(
    part: Preparation, config: JobConfig, among_many: Mapping[str, tuple[Law, ...]], spread: Spread
) -> frozenset[str]:
    assert part.recording is not None
    rows = sum(len(trajectory.times) for trajectory in part.recording.trajectories if not trajectory.held_out)
    settled = set()
    for name, laws in _find_laws_of_part(part, config, {}, among_many, spread).items():
        if _is_settled(laws, rows, config.space.max_size):
            settled.add(name)
        elif not _are_many(len(part.dataset.names)):
            return frozenset()
    return frozenset(settled)


def _is_settled(laws: Sequence[Law], rows: int, largest: int | None) -> bool:
    """Tell whether the first of these laws is so certain that no long search for the equation is needed."""
    if not laws or not may_be_shown(laws[0].program, largest):
        return False
    is_like_noise = laws[0].is_tested and laws[0].probability >= SETTINGS.inference.improbable
    return is_like_noise and (rows > SETTINGS.selection.compared_rows or laws[0].is_of_rates)


def _are_many(variables: int, degree: int = SETTINGS.sparse.degree) -> bool:
    """Tell whether there are too many variables for a library of all products up to a degree."""
    return math.comb(variables + degree, variables) > SETTINGS.sparse.largest_library


def _meets_assumptions(recording: Recording) -> bool:
    """Tell whether the assumptions of these methods hold: all rows have equal weights, and no state has an unknown
    offset."""
    return not recording.offsets and all(
        part.weights is None and part.robustness_weights is None for part in recording.trajectories
    )


def _makes_sums(columns: Sequence[int], operators: Collection[int]) -> bool:
    return bool(columns) and {ADD, MULTIPLY} <= set(operators)


def _is_interpolated(recording: Recording) -> bool:
    return all(smoothing.method == "interpolation" for smoothing in recording.smoothing)


# ----------------------------------------------------------------------------------------------- few variables


def find_laws(
    problem: Problem,
    recording: Recording,
    columns: Sequence[int],
    operators: Collection[int],
    others: Sequence[Program] = (),
    spread: Spread | None = None,
) -> tuple[Law, ...]:
    """Return the laws of one state, the shortest description first.

    Only the rows of this state are used. The result is empty if no law was found, or if there are too many variables
    for libraries of all products.

    Args:
        problem: the derivative on the rows of the search; the target's variable is a state of `recording`.
        recording: the measurements.
        columns: indices of the allowed variables.
        operators: codes of the operators.
        others: programs with which laws are compared if there is noise.
        spread: computes in threads or on workers; None: one after another.
    """
    if not _meets_assumptions(recording) or not _makes_sums(columns, operators) or recording.order == 2:
        return ()
    if _is_interpolated(recording) and problem.target.uncertainty <= SETTINGS.inference.largest_uncertainty:
        return tuple(_find_laws_without_noise(problem, columns))
    return tuple(_find_laws_with_noise(problem, recording, columns, others, spread or Spread()))


def _find_laws_without_noise(problem: Problem, columns: Sequence[int]) -> Iterator[Law]:
    """Yield the smallest sum whose error is below the limit of convergence, from the library of the lowest degree that
    has such a sum.

    If no library has one, yield the smallest sum whose error is about as large as this limit.
    """
    rows, limit = RegressionRows(problem.inputs, problem.target.values), problem.target.convergence_error()
    ways = []
    for terms, is_tested in polynomial_libraries(columns, len(rows.sides), _DEGREES):
        regression = SparseRegression(rows, product_atoms(problem.inputs, terms))
        if not regression.is_finite:
            break
        ways.append(([*regression.elimination_path(range(len(terms)), np.ones(len(rows.sides)))], is_tested))
    for allowed in (1.0, SETTINGS.inference.excess):
        for sums, is_tested in ways:
            for fit in sums:
                residuals = fit.regression.residuals(fit)
                excess = math.fsum(np.abs(residuals).tolist()) / len(residuals) / limit
                if excess > allowed:
                    continue
                program = fit.sum_of_products()
                if len(program) <= MAX_NODES:
                    yield Law(program, structure_length(program), excess, is_tested)
                    return
                break


@dataclass(frozen=True, eq=False)
class _Windows:
    """The parts of a weak form (see `weak_rows`), and the terms of the largest library."""

    measured: MeasuredRows
    target: int
    half: int
    largest: tuple[Product, ...]

    def regression(self) -> SparseRegression:
        """Return the regression with all terms of the largest library."""
        rows = weak_rows(self.measured, self.target, self.half)
        assert rows is not None, "there are windows"
        return SparseRegression(rows, product_atoms(self.measured.values, self.largest))


def _search_law(regression: SparseRegression, terms: tuple[Product, ...]) -> tuple[Law, ...]:
    """Return the law that a search finds if it begins with the sum of these products. The result is empty if no law is
    found."""
    places = {atom.shape.factors: place for place, atom in enumerate(regression.atoms)}
    found = regression.select_terms([places[term] for term in terms])
    if found is None or found.assessment is None:
        return ()
    return (Law(found.sum_of_products(), found.nats, found.excess, True, probability=found.assessment.probability),)


_Description = tuple[tuple[Product, ...] | None, float]
"""The products of a program (None if the program is no sum of products), and the nats of the program."""


def _describe(regression: SparseRegression, program: Program) -> _Description:
    """Return the products of a program, or its nats by the same criterion as for sums. The nats are infinite if the
    program cannot be fitted.

    The constants of the program were fitted to smoothed derivatives, which are too flat. So a factor of the whole
    program is fitted to the windows.
    """
    written, rows = collected(program), regression.rows
    terms = products_of(written, SETTINGS.sparse.degree)
    if terms is not None:
        return tuple(terms), math.inf
    if not may_be_shown(written, None):
        return None, math.inf
    alone = SparseRegression(rows, [program_atom(written, rows.inputs)])
    fit = alone.refit([0], np.ones(len(rows.sides))) if alone.is_solvable else None
    if fit is None or fit.assessment is None:
        return None, math.inf
    constants = max(len(constant_places(written)), 1)
    return None, fit.assessment.misfit + structure_length(written) + constants * constant_nats_of(rows.independent)


_SUMS: Final[BatchFunction[SparseRegression, tuple[Product, ...], tuple[Law, ...]]] = BatchFunction(
    "sums of products", _Windows, tuple[Product, ...], tuple[Law, ...], _search_law, _Windows.regression
)
_OTHERS: Final[BatchFunction[SparseRegression, Program, _Description]] = BatchFunction(
    "alternatives to laws", _Windows, Program, _Description, _describe, _Windows.regression
)


def _find_laws_with_noise(
    problem: Problem, recording: Recording, columns: Sequence[int], others: Sequence[Program], spread: Spread
) -> Iterator[Law]:
    """Yield the best sum of each library, the shortest description first."""
    measured = measured_rows_of(recording, problem.names)
    place = recording.states.index(problem.target.variable)
    target = problem.names.index(recording.state_symbols[place])
    half = half_width(measured, recording.smoothing[place], len(columns))
    rows = weak_rows(measured, target, half)
    libraries = [] if rows is None else list(polynomial_libraries(columns, rows.independent, _DEGREES))
    if not libraries:
        return
    largest, is_tested = libraries[-1]
    windows = _Windows(measured, target, half, tuple(largest))
    regression = windows.regression()

    descriptions_or_none = spread.map(_OTHERS, lambda: regression, others, _PROGRAMS_OF_A_BATCH, parts=lambda: windows)
    descriptions = [one for one in descriptions_or_none if one is not None]
    own = dict.fromkeys(terms for terms, _ in descriptions if terms and set(terms) <= set(largest))
    starts = dict.fromkeys((*(tuple(terms) for terms, _ in libraries), *list(own)[: SETTINGS.effort.beam]))
    candidates = spread.map(_SUMS, lambda: regression, list(starts), parts=lambda: windows)
    laws = [law for laws in candidates for law in laws or () if len(law.program) <= MAX_NODES]
    laws.sort(key=lambda law: law.nats)
    alternative = min((nats for _, nats in descriptions), default=math.inf)
    structures: set[bytes] = set()
    for law in laws:
        key = structure(collected(law.program))
        if key not in structures:
            structures.add(key)
            yield replace(law, is_tested=is_tested, lead=alternative - laws[0].nats)


# ---------------------------------------------------------------------------------------------- many variables


def _find_laws_among_many(part: Preparation, config: JobConfig, spread: Spread) -> dict[str, tuple[Law, ...]]:
    """Return the laws of the states of one group: they are fitted to derivatives if there is no noise, and to short
    windows if there is noise."""
    dataset, recording = part.dataset, part.recording
    if recording is None or not _are_many(len(dataset.names)) or not _meets_assumptions(recording):
        return {}
    is_interpolated = _is_interpolated(recording)
    if recording.order == 2 and not is_interpolated:
        return {}
    spaces = {name: space for name, space in _spaces(dataset, config).items() if _makes_sums(*space)}
    equations: dict[str, UnknownEquation] = {}
    if is_interpolated:
        for name, (columns, operators) in spaces.items():
            rows = rate_rows(recording, dataset.names, name)
            if rows is not None:
                equations[name] = UnknownEquation(rows, screen_columns(rows, columns), operators)
    else:
        for name, windows in window_rows(recording, dataset.names, list(spaces)).items():
            equations[name] = UnknownEquation(windows, *spaces[name])
    return find_short_laws(equations, spread)


# -------------------------------------------------------------------------------------------- dozens of variables


def screen_variables(preparation: Preparation, config: JobConfig) -> JobConfig:
    """Return the configuration with screened variables for each equation, if there are dozens of variables.

    Variables that the user has set are not changed. An equation is not changed either if no variable can be excluded.
    """
    dataset, recording, space = preparation.dataset, preparation.recording, config.space
    if recording is None or not _are_many(len(dataset.names), 2):
        return config
    variables_of = dict(space.variables_of)
    for name in dataset.variables:
        is_left = name in variables_of or name in config.prior.known or name in config.prior.equations
        rows = None if is_left else rate_rows(recording, dataset.names, name)
        kept = () if rows is None else screen_columns(rows, range(len(dataset.names)))
        if kept:
            variables_of[name] = tuple(dataset.names[place] for place in kept)
    update: dict[str, object] = {"variables_of": variables_of}
    beginning = space.model_copy(update={"terminals": None})
    if space.terminals == beginning.terminals_for(len(dataset.names)):  # not set by the user
        counts = [len(variables_of.get(name, dataset.names)) for name in dataset.variables]
        update["terminals"] = beginning.terminals_for(max(counts))
    return config.model_copy(update={"space": space.model_copy(update=update)})


def screen_columns(rows: RateRows, columns: Sequence[int]) -> tuple[int, ...]:
    """Return the variables among `columns` (indices) that the equation needs, in ascending order. The result is empty
    if no variable explains the equation.

    Products of two variables, and cubes, are added one at a time (forward selection). Each step adds the product that
    explains most of the residuals. The selection ends when this product explains no more than the best of all products
    would explain by chance. Backward elimination then ranks the terms, since a later term may make an earlier term
    unnecessary. The result contains the variables of the best terms.
    """
    if not _are_many(len(columns), 2):
        return tuple(columns)
    trusted = rows.trusted
    terms = [*products(columns, 2), *((variable,) * 3 for variable in columns)]
    _, deviation = moments(trusted.sides)
    errors = trusted.side_errors
    weights = 1.0 / np.sqrt(errors * errors + (SETTINGS.common.negligible * deviation) ** 2)
    weighted, side = WeightedProducts(trusted.inputs[list(columns)], weights), trusted.sides * weights
    taken: list[int] = []
    chance, before = 2.0 * log(float(len(terms))) / len(side), math.fsum((side * side).tolist())
    for place, after in islice(select_forward(weighted, side), 3 * SETTINGS.sparse.screened):
        if before - after <= chance * before:
            break
        taken.append(place)
        before = after
        if after <= len(side):
            break
    if not taken:
        return ()
    kept: list[int] = []
    for index in reversed(eliminate_columns(np.array([weighted.column(place) for place in taken]), side).order):
        new = [variable for variable in dict.fromkeys(terms[taken[index]]) if variable not in kept]
        if len(kept) + len(new) > SETTINGS.sparse.screened:
            break
        kept += new
    return tuple(sorted(kept))
