"""Laws of one state as sums of products, by backward elimination: from full libraries to what is significant."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation, Recording, Smoothing, by_group
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.criteria import constant_nats_of, structure_length
from atoll_coordinator.model.pools import Law, LawsByGroup, may_be_shown
from atoll_coordinator.model.sparse.elimination import Elimination, eliminated
from atoll_coordinator.model.sparse.products import Product, libraries, products_of, sum_of_products, values_of_products
from atoll_coordinator.model.sparse.rates.rate_laws import find_rate_laws
from atoll_coordinator.model.sparse.rates.rate_rows import rate_rows
from atoll_coordinator.model.sparse.regression import Regression, misfit
from atoll_coordinator.model.sparse.weak_form import Measured, WeakForm, measured_of, weak_form
from atoll_coordinator.model.sparse.windows.window_laws import WindowEquation, find_window_laws
from atoll_coordinator.model.sparse.windows.window_rows import window_rows
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray, Problem
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, BY_NAME, MULTIPLY
from atoll_core.expression.program import MAX_NODES, Program, constant_places, structure
from atoll_core.expression.writing.shortest import collected

_DEGREES: Final = range(1, SETTINGS.sparse.degree + 1)
_RIVALS_OF_A_BATCH: Final = 16
"""Programs that are compared with laws: each takes a millisecond or two."""
_WRITTEN_OF_A_BATCH: Final = 16
"""Programs whose products are looked for, the same ones."""


@dataclass(frozen=True, eq=False)
class _Windows:
    """What a weak form is made of, see `weak_form`, and the terms of the largest library."""

    measured: Measured
    target: int
    half: int
    largest: tuple[Product, ...]

    def form(self) -> WeakForm:
        """Return the weak form, which there is."""
        form = weak_form(self.measured, self.target, self.half)
        assert form is not None, "there are windows"
        return form


@dataclass(frozen=True, eq=False)
class _Search:
    """The terms that the search of a law begins with."""

    terms: tuple[Product, ...]
    is_tested: bool


@dataclass(frozen=True, eq=False)
class _Written:
    """A program without x/x, of which no sum of products is made, and the products that it sums up.

    `terms` are None where it is no sum of products.
    """

    program: Program
    terms: tuple[Product, ...] | None

    @classmethod
    def of(cls, degree: int, program: Program) -> "_Written":
        """Return what becomes of a program; products are of this degree at most."""
        written = collected(program)
        terms = products_of(written, degree)
        return cls(written, None if terms is None else tuple(terms))


def _law(regression: Regression, search: _Search) -> tuple[Law, ...]:
    law = regression.law(search.terms, is_tested=search.is_tested)
    return () if law is None else (law,)


def _nats(law: Law) -> float:
    return law.nats


def find_all_laws(
    preparation: Preparation,
    config: JobConfig,
    others: Mapping[str, Sequence[Program]],
    among_many: LawsByGroup | None = None,
    spread: Spread | None = None,
) -> dict[str, tuple[Law, ...]]:
    """Return the laws of each variable that is not known already, those of one group of trajectories after another.

    Args:
        preparation: the derivatives on the rows of the search, and the recording of their states.
        config: the resolved configuration.
        others: programs by variable that laws are compared with where there is noise.
        among_many: what `laws_among_many` gave; None: it is asked here.
        spread: has the work done; one after another unless given.
    """
    by_variable: dict[str, tuple[Law, ...]] = {}
    among_many = laws_among_many(preparation, config) if among_many is None else among_many
    for part, known in zip(_parts(preparation), among_many, strict=True):
        for name, laws in _laws(part, config, others, known, spread or Spread()).items():
            by_variable[name] = by_variable.get(name, ()) + laws
    return by_variable


def laws_among_many(preparation: Preparation, config: JobConfig) -> LawsByGroup:
    """Return the laws among many variables, which need no programs to be compared with; none where variables are few.

    That is most of the work of `find_all_laws`; preparing does it, and refining is given what it found.
    """
    return [_among_many(part, config) for part in _parts(preparation)]


def _parts(preparation: Preparation) -> Sequence[Preparation]:
    """Return what each group of trajectories gives by itself, all together where there are no groups."""
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
    """Return by variable that is sought what its equation may be made of: columns of variables, codes of operators."""
    space = config.space
    return {
        name: (
            space.columns_for(name, dataset.names),
            frozenset(BY_NAME[operator].code for operator in space.operators_for(name)),
        )
        for name in dataset.variables
        if name not in config.prior.known
    }


def _among_many(part: Preparation, config: JobConfig) -> dict[str, tuple[Law, ...]]:
    """Return the laws of the states of one group: on derivatives without noise, on windows with noise."""
    dataset, recording = part.dataset, part.recording
    if recording is None or not _are_many(dataset.names) or not _has_like_rows(recording):
        return {}
    spaces = {name: space for name, space in _spaces(dataset, config).items() if _makes_sums(*space)}
    if _is_interpolated(recording):
        rates = ((name, rate_rows(recording, dataset.names, name), space) for name, space in spaces.items())
        return {name: find_rate_laws(rows, *space) for name, rows, space in rates if rows is not None}
    if recording.order == 2:
        return {}
    windows = ((name, window_rows(recording, dataset.names, name), space) for name, space in spaces.items())
    return find_window_laws({name: WindowEquation(rows, *space) for name, rows, space in windows if rows is not None})


def _makes_sums(columns: Sequence[int], operators: Collection[int]) -> bool:
    return bool(columns) and {ADD, MULTIPLY} <= set(operators)


def _is_interpolated(recording: Recording) -> bool:
    return all(smoothing.method == "interpolation" for smoothing in recording.smoothing)


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
        recording: what was measured.
        columns: indices of the variables that it may be made of.
        operators: codes of the operators.
        others: programs that laws are compared with where there is noise.
        spread: has the work done; one after another unless given.
    """
    if not _has_like_rows(recording) or not _makes_sums(columns, operators) or recording.order == 2:
        return ()
    if _is_interpolated(recording) and problem.target.uncertainty <= SETTINGS.inference.largest_uncertainty:
        return tuple(_without_noise(problem, columns))
    return tuple(_with_noise(problem, recording, columns, others, spread or Spread()))


def _are_many(names: Sequence[str]) -> bool:
    """Tell whether there are too many variables for a library of all products up to the highest degree."""
    return math.comb(len(names) + SETTINGS.sparse.degree, len(names)) > SETTINGS.sparse.largest_library


def settled_variables(preparation: Preparation, config: JobConfig, among_many: LawsByGroup) -> frozenset[str]:
    """Return the variables whose equations have laws that need no long search to compare them with.

    Those are laws whose errors are those of noise, chosen on more rows than systems are compared on. Among many
    variables each equation counts for itself; else all are settled or none, since the laws of few are found beside a
    search that ends soon. None where the user has said when the search ends or where it begins. `among_many` is what
    `laws_among_many` gave.
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
        elif not _are_many(part.dataset.names):
            return frozenset()
    return frozenset(settled)


def _settles(laws: Sequence[Law], rows: int, largest: int | None) -> bool:
    """Tell whether the first of these laws of an equation needs no long search to compare it with."""
    if not laws or not may_be_shown(laws[0].program, largest):
        return False
    is_like_noise = laws[0].is_tested and laws[0].probability >= SETTINGS.inference.improbable
    return is_like_noise and (rows > SETTINGS.selection.compared_rows or laws[0].is_of_rates)


def _has_like_rows(recording: Recording) -> bool:
    """Tell whether rows count alike, and states are measured without an unknown offset, as is assumed here."""
    return not recording.offsets and all(
        part.weights is None and part.robustness_weights is None for part in recording.trajectories
    )


def _without_noise(problem: Problem, columns: Sequence[int]) -> Iterator[Law]:
    """Yield the smallest sum that has converged, of the library of lowest degree that has one.

    Where none has, the same of those whose errors are at the level at which equations converge, though not below it.
    """
    paths = []
    for terms, is_tested in libraries(columns, len(problem.target.values), _DEGREES):
        values = values_of_products(terms, problem.inputs)
        if not np.isfinite(values).all():
            break
        paths.append((terms, eliminated(values, problem.target.values), values, is_tested))
    for allowed in (1.0, SETTINGS.inference.excess):
        for terms, path, values, is_tested in paths:
            law = _converged(problem, terms, path, values, allowed)
            if law is not None:
                yield replace(law, is_tested=is_tested)
                return


def _converged(
    problem: Problem, terms: Sequence[Product], path: Elimination, values: FloatArray, allowed: float
) -> Law | None:
    """Return the smallest sum of these `values` (K, N) whose error is at most so many times that of convergence."""
    limit = problem.target.convergence_error()
    for step in range(len(terms) - 1, -1, -1):
        kept, coefficients = path.kept(step), path.factors(step)
        errors = -problem.target.values
        for coefficient, place in zip(coefficients, kept, strict=True):
            errors += coefficient * values[place]
        excess = math.fsum(np.abs(errors).tolist()) / len(errors) / limit
        if excess <= allowed:
            program = sum_of_products([terms[place] for place in kept], coefficients)
            if len(program) > MAX_NODES:
                return None
            return Law(program, structure_length(program), excess, is_tested=False)
    return None


def _with_noise(
    problem: Problem, recording: Recording, columns: Sequence[int], others: Sequence[Program], spread: Spread
) -> Iterator[Law]:
    """Yield the best sum of each library, the shortest description first."""
    measured = measured_of(recording, problem.names)
    place = recording.states.index(problem.target.variable)
    target = problem.names.index(recording.state_symbols[place])
    half = _half(measured, recording.smoothing[place], len(columns))
    form = weak_form(measured, target, half)
    if form is None:
        return
    tried = list(libraries(columns, form.independent, _DEGREES))
    if not tried:
        return
    largest, is_tested = tried[-1]
    made = spread.map(_WRITTEN, lambda: SETTINGS.sparse.degree, others, _WRITTEN_OF_A_BATCH)
    written = [one for one in made if one is not None]
    own = dict.fromkeys(one.terms for one in written if one.terms and set(one.terms) <= set(largest))
    begun = dict.fromkeys((*(tuple(terms) for terms, _ in tried), *list(own)[: SETTINGS.effort.beam]))
    parts = _Windows(measured, target, half, tuple(largest))
    searches = [_Search(terms, is_tested) for terms in begun]
    candidates = spread.map(_SUMS, partial(Regression, form, largest), searches, parts=lambda: parts)
    laws = sorted((law for laws in candidates for law in laws or () if len(law.program) <= MAX_NODES), key=_nats)
    if not laws:
        return
    functions = [one.program for one in written if one.terms is None]
    nats = spread.map(_RIVALS, lambda: form, functions, _RIVALS_OF_A_BATCH, parts=lambda: parts)
    rival = min((one for one in nats if one is not None), default=math.inf)
    structures: set[bytes] = set()
    for law in laws:
        key = structure(collected(law.program))
        if key not in structures:
            structures.add(key)
            yield replace(law, lead=rival - laws[0].nats)


def _half(measured: Measured, smoothing: Smoothing, variables: int) -> int:
    """Return the rows of half a window: half of the smoother's span, as far as windows suffice for the largest library.

    In windows that are longer, errors of terms that nearly depend on each other are larger beside what tells them
    apart; in shorter ones those of the trapezoidal rule, of which the noise should be ten times as large.
    """
    terms = min(math.comb(variables + SETTINGS.sparse.degree, variables), SETTINGS.sparse.largest_library)
    most = int(len(measured.times) / (SETTINGS.sparse.rows_per_term * terms + 2 * len(measured.ranges) + 1))
    longest = max(end - start for start, end in measured.ranges)
    half = min(smoothing.span // 2 if smoothing.span else most, most, longest // SETTINGS.sparse.least_windows)
    return max(half, _least_half(smoothing.relative_noise))


def _least_half(noise: float) -> int:
    """Return the least half of a window in which relative noise hides the errors of the trapezoidal rule.

    Those of the left side fall as h^-(p + 1) with the width h (p: `smoothness`), those of noise as h^-1.5.
    """
    half, exponent = SETTINGS.sparse.least_half, 2 * SETTINGS.sparse.smoothness - 1
    share = SETTINGS.sparse.least_half_noise / max(noise, SETTINGS.selection.least_noise)
    while (half / SETTINGS.sparse.least_half) ** exponent < share * share:
        half += 1
    return half


@np.errstate(all="ignore")
def _nats_of(form: WeakForm, program: Program) -> float:
    """Return the nats of another program by the same criterion; infinite where it has no finite value.

    Its constants were fitted to derivatives that smoothing has flattened, so one factor of it is fitted to the windows.
    """
    measured = form.measured
    steps = np.diag(measured.noise)[:, :, None]
    values = values_of(program, measured.values)
    slopes = np.array([
        (values_of(program, measured.smoothed + step) - values_of(program, measured.smoothed - step)) / (2.0 * size)
        if size
        else np.zeros(len(measured.times))
        for step, size in zip(steps, measured.noise, strict=True)
    ])  # fmt: skip
    if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
        return math.inf
    constants = len(constant_places(program))
    integrals, variances = form.integrals(values), form.variances_of(slopes)
    factor = _factor(form.sides, integrals, variances) if constants else 1.0
    left = form.sides - factor * integrals
    nats = misfit(form, left, form.variances_of(factor * slopes)) + structure_length(program)
    return nats + constants * constant_nats_of(form.independent) if math.isfinite(nats) else math.inf


def _factor(sides: FloatArray, integrals: FloatArray, variances: FloatArray) -> float:
    """Return by how much integrals (W,) are to be multiplied to be nearest to the left sides, of these variances."""
    if not (variances > 0.0).all():
        return 1.0
    squares = math.fsum((integrals * integrals / variances).tolist())
    return math.fsum((sides * integrals / variances).tolist()) / squares if squares > 0.0 else 1.0


_WRITTEN: Final[BatchFunction[int, Program, _Written]] = BatchFunction(
    "products in sums", int, Program, _Written, _Written.of
)
_SUMS: Final[BatchFunction[Regression, _Search, tuple[Law, ...]]] = BatchFunction(
    "sums of products", _Windows, _Search, tuple[Law, ...], _law, lambda parts: Regression(parts.form(), parts.largest)
)
_RIVALS: Final[BatchFunction[WeakForm, Program, float]] = BatchFunction(
    "rivals of laws", _Windows, Program, float, lambda form, program: _nats_of(form, program), _Windows.form
)
