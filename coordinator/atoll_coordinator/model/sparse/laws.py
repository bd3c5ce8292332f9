"""The laws of states by regression alone: which rows an equation is fitted to, which libraries are tried.

Few variables (libraries of all products up to the fourth degree exist): sums of products, on derivatives where there is
no noise, else in the weak form, where they are compared with other programs. Many variables: short sums of products and
of functions, each equation for itself, then with the functions of other laws: a flux that leaves one state enters
another. Dozens of variables: forward selection first says which of them an equation takes.
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
    product_atoms,
    product_libraries,
    products,
    products_of,
    values_of_products,
    whole_program,
)
from atoll_coordinator.model.sparse.many_variables import Equation, find_short_laws, window_rows
from atoll_coordinator.model.sparse.regression import (
    Regression,
    eliminated,
    selected_forward,
)
from atoll_coordinator.model.sparse.rows import (
    Measured,
    RateRows,
    Rows,
    half_width,
    measured_of,
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
"""Programs that are compared with laws: each takes a few milliseconds."""


# --------------------------------------------------------------------------------------------- laws of all states


def find_all_laws(
    preparation: Preparation,
    config: JobConfig,
    others: Mapping[str, Sequence[Program]],
    among_many: LawsByGroup | None = None,
    spread: Spread | None = None,
) -> dict[str, tuple[Law, ...]]:
    """Return the laws of each variable that is not known already, group by group of trajectories.

    Args:
        preparation: the derivatives on the rows of the search, and the recording of their states.
        config: the resolved configuration.
        others: programs by variable that laws are compared with where there is noise.
        among_many: the result of `laws_among_many`; None: it is computed here.
        spread: computes in threads or on workers; one after another unless given.
    """
    by_variable: dict[str, tuple[Law, ...]] = {}
    among_many = laws_among_many(preparation, config) if among_many is None else among_many
    for part, known in zip(_parts(preparation), among_many, strict=True):
        for name, laws in _laws(part, config, others, known, spread or Spread()).items():
            by_variable[name] = by_variable.get(name, ()) + laws
    return by_variable


def laws_among_many(preparation: Preparation, config: JobConfig) -> LawsByGroup:
    """Return the laws among many variables, which need no programs to be compared with; none where variables are few.

    That is most of the work of `find_all_laws`; preparing does it and passes the result on to refining.
    """
    return [_among_many(part, config) for part in _parts(preparation)]


def _parts(preparation: Preparation) -> Sequence[Preparation]:
    """Return the preparation of each group of trajectories, of all together where there are no groups."""
    return tuple(by_group(preparation)) or (preparation,)


def _laws(
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
    return dict(zip(spaces, spread.branches(calls), strict=True))


def _spaces(dataset: Dataset, config: JobConfig) -> dict[str, tuple[tuple[int, ...], frozenset[int]]]:
    """Return by variable that is sought the columns of variables and the codes of operators that are allowed."""
    space = config.space
    return {
        name: (
            space.columns_for(name, dataset.names),
            frozenset(BY_NAME[operator].code for operator in space.operators_for(name)),
        )
        for name in dataset.variables
        if name not in config.prior.known
    }


def settled_variables(preparation: Preparation, config: JobConfig, among_many: LawsByGroup) -> frozenset[str]:
    """Return the variables whose equations have laws that need no long search to compare them with.

    The residuals of these laws are like noise, and they were chosen on more rows than systems are compared on. Among
    many variables each equation is settled independently; among few, all are settled or none, since a search of few
    variables ends soon. None if the user has set the end or the beginning of the search. `among_many` is the
    result of `laws_among_many`.
    """
    budget = config.budget
    is_asked = budget.target_error is not None or budget.stagnation is not None or bool(config.prior.guesses)
    if preparation.recording is None or is_asked:
        return frozenset()
    parts = zip(_parts(preparation), among_many, strict=True)
    return frozenset.intersection(*(_settled_variables(part, config, laws) for part, laws in parts))


def _settled_variables(
    part: Preparation, config: JobConfig, among_many: Mapping[str, tuple[Law, ...]]
) -> frozenset[str]:
    assert part.recording is not None
    rows = sum(len(trajectory.times) for trajectory in part.recording.trajectories if not trajectory.held_out)
    settled = set()
    for name, laws in _laws(part, config, {}, among_many, Spread()).items():
        if _settles(laws, rows, config.space.max_size):
            settled.add(name)
        elif not _are_many(len(part.dataset.names)):
            return frozenset()
    return frozenset(settled)


def _settles(laws: Sequence[Law], rows: int, largest: int | None) -> bool:
    """Tell whether the first of these laws of an equation needs no long search to compare it with."""
    if not laws or not may_be_shown(laws[0].program, largest):
        return False
    is_like_noise = laws[0].is_tested and laws[0].probability >= SETTINGS.inference.improbable
    return is_like_noise and (rows > SETTINGS.selection.compared_rows or laws[0].is_of_rates)


def _are_many(variables: int, degree: int = SETTINGS.sparse.degree) -> bool:
    """Tell whether there are too many variables for a library of all products up to a degree."""
    return math.comb(variables + degree, variables) > SETTINGS.sparse.largest_library


def _has_like_rows(recording: Recording) -> bool:
    """Tell whether rows count alike, and states are measured without an unknown offset, as is assumed here."""
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
    """Return the laws of one state by itself that its rows single out, the shortest description first.

    None where there are none, or where variables are too many for libraries of all products.

    Args:
        problem: its derivative on the rows of the search; the target's variable is a state of `recording`.
        recording: the measurements.
        columns: indices of the variables that it may be made of.
        operators: codes of the operators.
        others: programs that laws are compared with where there is noise.
        spread: computes in threads or on workers; one after another unless given.
    """
    if not _has_like_rows(recording) or not _makes_sums(columns, operators) or recording.order == 2:
        return ()
    if _is_interpolated(recording) and problem.target.uncertainty <= SETTINGS.inference.largest_uncertainty:
        return tuple(_without_noise(problem, columns))
    return tuple(_with_noise(problem, recording, columns, others, spread or Spread()))


def _without_noise(problem: Problem, columns: Sequence[int]) -> Iterator[Law]:
    """Yield the smallest sum that has converged, of the library of lowest degree that has one.

    Where none has, the same with errors at the level at which equations converge, though not below it.
    """
    rows, limit = Rows(problem.inputs, problem.target.values), problem.target.convergence_error()
    ways = []
    for terms, is_tested in product_libraries(columns, len(rows.sides), _DEGREES):
        regression = Regression(rows, product_atoms(problem.inputs, terms))
        if not regression.is_finite:
            break
        ways.append(([*regression.on_the_way(range(len(terms)), np.ones(len(rows.sides)))], is_tested))
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
    """The parts of a weak form, see `weak_rows`, and the terms of the largest library."""

    measured: Measured
    target: int
    half: int
    largest: tuple[Product, ...]

    def regression(self) -> Regression:
        """Return the regression by all terms; there are windows."""
        rows = weak_rows(self.measured, self.target, self.half)
        assert rows is not None, "there are windows"
        return Regression(rows, product_atoms(self.measured.values, self.largest))


def _law(regression: Regression, terms: tuple[Product, ...]) -> tuple[Law, ...]:
    """Return the law that is found from a sum of these products."""
    places = {atom.shape.factors: place for place, atom in enumerate(regression.atoms)}
    found = regression.search([places[term] for term in terms])
    if found is None or found.assessment is None:
        return ()
    return (Law(found.sum_of_products(), found.nats, found.excess, True, probability=found.assessment.probability),)


_Described = tuple[tuple[Product, ...] | None, float]
"""The products that a program sums up, or None and the nats of the program."""


def _described(regression: Regression, program: Program) -> _Described:
    """Return the description of a program, without x/x, by the criterion of the sums; infinite nats if it has none.

    Its constants were fitted to derivatives that smoothing has flattened, so one factor of it is fitted to the windows.
    """
    written, rows = collected(program), regression.rows
    terms = products_of(written, SETTINGS.sparse.degree)
    if terms is not None:
        return tuple(terms), math.inf
    if not may_be_shown(written, None):
        return None, math.inf
    alone = Regression(rows, [whole_program(written, rows.inputs)])
    fit = alone.refitted([0], np.ones(len(rows.sides))) if alone.is_solvable else None
    if fit is None or fit.assessment is None:
        return None, math.inf
    constants = max(len(constant_places(written)), 1)
    return None, fit.assessment.misfit + structure_length(written) + constants * constant_nats_of(rows.independent)


_SUMS: Final[BatchFunction[Regression, tuple[Product, ...], tuple[Law, ...]]] = BatchFunction(
    "sums of products", _Windows, tuple[Product, ...], tuple[Law, ...], _law, _Windows.regression
)
_OTHERS: Final[BatchFunction[Regression, Program, _Described]] = BatchFunction(
    "alternatives to laws", _Windows, Program, _Described, _described, _Windows.regression
)


def _with_noise(
    problem: Problem, recording: Recording, columns: Sequence[int], others: Sequence[Program], spread: Spread
) -> Iterator[Law]:
    """Yield the best sum of each library, the shortest description first."""
    measured = measured_of(recording, problem.names)
    place = recording.states.index(problem.target.variable)
    target = problem.names.index(recording.state_symbols[place])
    half = half_width(measured, recording.smoothing[place], len(columns))
    rows = weak_rows(measured, target, half)
    tried = [] if rows is None else list(product_libraries(columns, rows.independent, _DEGREES))
    if not tried:
        return
    largest, is_tested = tried[-1]
    windows = _Windows(measured, target, half, tuple(largest))
    regression = windows.regression()

    made = spread.map(_OTHERS, lambda: regression, others, _PROGRAMS_OF_A_BATCH, parts=lambda: windows)
    described = [one for one in made if one is not None]
    own = dict.fromkeys(terms for terms, _ in described if terms and set(terms) <= set(largest))
    begun = dict.fromkeys((*(tuple(terms) for terms, _ in tried), *list(own)[: SETTINGS.effort.beam]))
    candidates = spread.map(_SUMS, lambda: regression, list(begun), parts=lambda: windows)
    laws = [law for laws in candidates for law in laws or () if len(law.program) <= MAX_NODES]
    laws.sort(key=lambda law: law.nats)
    alternative = min((nats for _, nats in described), default=math.inf)
    structures: set[bytes] = set()
    for law in laws:
        key = structure(collected(law.program))
        if key not in structures:
            structures.add(key)
            yield replace(law, is_tested=is_tested, lead=alternative - laws[0].nats)


# ---------------------------------------------------------------------------------------------- many variables


def _among_many(part: Preparation, config: JobConfig) -> dict[str, tuple[Law, ...]]:
    """Return the laws of the states of one group: on derivatives without noise, on short windows with noise."""
    dataset, recording = part.dataset, part.recording
    if recording is None or not _are_many(len(dataset.names)) or not _has_like_rows(recording):
        return {}
    is_interpolated = _is_interpolated(recording)
    if recording.order == 2 and not is_interpolated:
        return {}
    build = rate_rows if is_interpolated else window_rows
    equations: dict[str, Equation] = {}
    for name, space in _spaces(dataset, config).items():
        rows = build(recording, dataset.names, name) if _makes_sums(*space) else None
        if rows is not None:
            columns = screened(rows, space[0]) if isinstance(rows, RateRows) else space[0]
            equations[name] = Equation(rows, columns, space[1])
    return find_short_laws(equations)


# -------------------------------------------------------------------------------------------- dozens of variables


def with_screened_variables(preparation: Preparation, config: JobConfig) -> JobConfig:
    """Return the resolved configuration with the variables that each equation takes, where there are dozens.

    Variables that the user allows stay as they are, and so does an equation for which no variables can be excluded.
    """
    dataset, recording, space = preparation.dataset, preparation.recording, config.space
    if recording is None or not _are_many(len(dataset.names), 2):
        return config
    variables_of = dict(space.variables_of)
    for name in dataset.variables:
        rows = None if name in variables_of or name in config.prior.known else rate_rows(recording, dataset.names, name)
        kept = () if rows is None else screened(rows, range(len(dataset.names)))
        if kept:
            variables_of[name] = tuple(dataset.names[place] for place in kept)
    update: dict[str, object] = {"variables_of": variables_of}
    beginning = space.model_copy(update={"terminals": None})
    if space.terminals == beginning.terminals_for(len(dataset.names)):  # not set by the user
        counts = [len(variables_of.get(name, dataset.names)) for name in dataset.variables]
        update["terminals"] = beginning.terminals_for(max(counts))
    return config.model_copy(update={"space": space.model_copy(update=update)})


def screened(rows: RateRows, columns: Sequence[int]) -> tuple[int, ...]:
    """Return the variables among `columns` (indices) that the equation takes, in ascending order.

    Products of two variables, and cubes, are added one at a time: each time the product that explains most of the
    residuals, as long as this is more than the best of as many explains by chance. A backward elimination first removes
    terms that only replaced later ones; the variables are those of the terms that remain.
    """
    if not _are_many(len(columns), 2):
        return tuple(columns)
    trusted = rows.decisive
    terms = [*products(columns, 2), *((variable,) * 3 for variable in columns)]
    values = values_of_products(terms, trusted.inputs)
    _, deviation = moments(trusted.sides)
    errors = trusted.side_errors
    weights = 1.0 / np.sqrt(errors * errors + (SETTINGS.common.negligible * deviation) ** 2)
    weighted, side = values * weights, trusted.sides * weights
    taken: list[int] = []
    chance, before = 2.0 * log(float(len(terms))) / len(side), math.fsum((side * side).tolist())
    for place, after in islice(selected_forward(weighted, side), 3 * SETTINGS.sparse.screened):
        if before - after <= chance * before:
            break
        taken.append(place)
        before = after
        if after <= len(side):
            break
    if not taken:
        return ()
    kept: list[int] = []
    for index in reversed(eliminated(weighted[taken], side).order):
        new = [variable for variable in dict.fromkeys(terms[taken[index]]) if variable not in kept]
        if len(kept) + len(new) > SETTINGS.sparse.screened:
            break
        kept += new
    return tuple(sorted(kept))
