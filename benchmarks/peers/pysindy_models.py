"""What PySINDy makes of the same measurements, in several set-ups, as equations that the same judges read.

PySINDy (B. de Silva et al., JOSS 2020; A. Kaptanoglu et al., JOSS 2022) fits sparse combinations of terms of a library,
by sequentially thresholded least squares. It needs the extra ``bench``. Library, threshold and differentiation are
chosen on a grid, as its users have to: the model that reconstructs the measured trajectories best, each simulated from
its first measurement, by the Bayesian information criterion of that reconstruction (in the plain square error the
fullest model would win as soon as there is noise).
"""

import importlib.util
import itertools
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from benchmarks.judging.generalisation import field_of, simulated
from benchmarks.noise.data import Case, Path

PLAIN_LIBRARIES: Final = ((1, 0, False), (2, 0, False), (3, 0, False), (4, 0, False))
"""Degree of the polynomials, multiples of sines and cosines, and whether those of two states are multiplied."""

WAVY_LIBRARIES: Final = (
    *((degree, 1, False) for degree in (1, 2, 3, 4)),
    *((degree, multiples, True) for degree in (1, 2) for multiples in (1, 2)),
)
THRESHOLDS: Final = (0.01, 0.03, 0.07, 0.15, 0.3, 0.6)
DOMAINS: Final = 100
"""Test functions of the weak form."""

ENSEMBLE: Final = 20
"""Models on resampled rows, of which the median is taken."""

MAX_EVALUATIONS: Final = 5_000
WORST: Final = 1e6
"""Mean square error over the variance of a model that cannot be simulated."""

POLYNOMIALS, WAVES, WEAK, MANY = METHODS = ("pysindy", "pysindy fourier", "pysindy weak", "pysindy ensemble")
"""Polynomials; those with sines and cosines; the weak form of either; polynomials, fitted to an ensemble."""


_Library = tuple[int, int, bool]


@dataclass(frozen=True, eq=False)
class _Data:
    """Measured trajectories: `times[i]` (n,), `states[i]` (n, S)."""

    names: tuple[str, ...]
    times: list[FloatArray]
    states: list[FloatArray]


@dataclass(frozen=True, eq=False)
class _Model:
    """Right-hand sides as text, with the number of their terms and the length of the reconstruction's description."""

    expressions: tuple[str, ...]
    terms: int
    length: float


def require() -> None:
    """Raise UsageError unless PySINDy is installed."""
    if importlib.util.find_spec("pysindy") is None:
        raise UsageError("pysindy is not installed, which the comparison with it needs; pip install -e '.[bench]'")


def solve(method: str, seed: int, case: Case) -> dict[str, Any]:
    """Return PySINDy's equations in the form of a result.json: the best of the grid of the method.

    Where the method does not apply (the weak form needs one grid of times) or nothing can be simulated, the equations
    have no expression. ``front`` has the equations of the whole grid.
    """
    begun = time.perf_counter()
    data = _measured(case)
    np.random.seed(seed)  # noqa: NPY002  PySINDy draws from numpy's global stream
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        models = [*_models(method, data)]
    best = min(models, key=lambda model: model.length, default=None)
    texts: Sequence[str | None] = best.expressions if best is not None else [None] * len(data.names)
    equations = [
        {"variable": name, "lhs": f"d{name}/dt", "expression": texts[index], "front": _others(models, index)}
        for index, name in enumerate(data.names)
    ]
    return {"equations": equations, "seconds": time.perf_counter() - begun, "warnings": []}


def _models(method: str, data: _Data) -> Iterator[_Model]:
    """Yield the models of the whole grid."""
    for problem in _problems(method, data):
        for threshold in THRESHOLDS:
            coefficients = problem.solved(_optimizer(threshold, method == MANY))
            if coefficients is not None:
                yield _model(data, problem.terms, coefficients)


def _others(models: Sequence[_Model], index: int) -> list[dict[str, str]]:
    """Return the different equations of one state on the whole grid."""
    return [{"expression": text} for text in dict.fromkeys(model.expressions[index] for model in models)]


def _measured(case: Case) -> _Data:
    """Return the trajectories of a table, rows with a missing cell left out."""
    starts = [*case.table.starts, case.table.rows]
    parts = [case.table.columns[:, start:stop].T for start, stop in itertools.pairwise(starts)]
    whole = [np.ascontiguousarray(part[np.isfinite(part).all(axis=1)]) for part in parts]
    return _Data(tuple(case.truths), [part[:, 0].copy() for part in whole], [part[:, 1:].copy() for part in whole])


class _Problem:
    """A linear problem as PySINDy sets it up: it stands in for the optimizer, and keeps what that is given to fit.

    So derivatives, libraries and integrals are made once for all thresholds. `terms` are their names.
    """

    def __init__(self) -> None:
        self.terms: list[str] = []
        self._matrix: Any = None
        self._sides: Any = None

    def fit(self, matrix: Any, sides: Any) -> "_Problem":
        """Keep the values of the terms (rows, terms) and the left-hand sides (rows, S)."""
        self._matrix, self._sides = matrix, sides
        return self

    def solved(self, optimizer: Any) -> FloatArray | None:
        """Return the coefficients (S, terms) that `optimizer` finds; None when it finds none."""
        try:
            optimizer.fit(self._matrix, self._sides)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            return None
        coefficients = np.asarray(optimizer.coef_, dtype=np.float64)
        return coefficients if np.isfinite(coefficients).all() else None


def _differentiated(data: _Data, libraries: Sequence[_Library]) -> Iterator[_Problem]:
    """Yield the problems of derivatives by finite differences, and of smoothed ones."""
    import pysindy as ps

    for method in (ps.FiniteDifference(), ps.SmoothedFiniteDifference()):
        for library in libraries:
            yield _problem(data, data.times, _library(library, True), method)


def _weak(data: _Data) -> Iterator[_Problem]:
    """Yield the problems of the weak form; none when the trajectories have not the same times."""
    import pysindy as ps

    times = data.times[0]
    if any(len(other) != len(times) or not np.array_equal(other, times) for other in data.times):
        return
    for terms in (*PLAIN_LIBRARIES, *WAVY_LIBRARIES):
        library = ps.WeakPDELibrary(
            function_library=_library(terms, False),
            spatiotemporal_grid=times,
            include_bias=True,
            K=DOMAINS,
        )
        yield _problem(data, times, library, None)


def _problem(data: _Data, times: Any, library: Any, differentiation: Any) -> _Problem:
    import pysindy as ps

    problem = _Problem()
    model = ps.SINDy(optimizer=problem, feature_library=library, differentiation_method=differentiation)
    model.fit(data.states, t=times, feature_names=list(data.names))
    problem.terms = list(model.get_feature_names())
    return problem


def _problems(method: str, data: _Data) -> Iterator[_Problem]:
    if method == WEAK:
        return _weak(data)
    return _differentiated(data, WAVY_LIBRARIES if method == WAVES else PLAIN_LIBRARIES)


def _library(library: _Library, has_bias: bool) -> Any:
    import pysindy as ps

    degree, multiples, has_products = library
    parts = [ps.PolynomialLibrary(degree=degree, include_bias=has_bias)]
    if multiples:
        parts.append(ps.FourierLibrary(n_frequencies=multiples))
    if has_products:
        parts.append(_products(multiples))
    return ps.ConcatLibrary(parts) if len(parts) > 1 else parts[0]


def _products(multiples: int) -> Any:
    """Return the library of sin or cos of multiples of one state times the same of another."""
    import pysindy as ps

    waves = [(wave, times) for times in range(1, multiples + 1) for wave in ("sin", "cos")]
    functions, names = zip(*(_product(*pair) for pair in itertools.product(waves, waves)), strict=True)
    return ps.CustomLibrary(list(functions), list(names), interaction_only=True)


_WAVES: Final = {"sin": np.sin, "cos": np.cos}


def _product(
    first: tuple[str, int], second: tuple[str, int]
) -> tuple[Callable[[FloatArray, FloatArray], FloatArray], Callable[[str, str], str]]:
    """Return a function of two states, and the function from their names to its name."""
    (one, times), (other, others) = first, second

    def values(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(_WAVES[one](times * x) * _WAVES[other](others * y), dtype=np.float64)

    def name(x: str, y: str) -> str:
        return f"{one}({times} {x}) {other}({others} {y})"

    return values, name


def _optimizer(threshold: float, is_ensemble: bool) -> Any:
    import pysindy as ps

    single = ps.STLSQ(threshold=threshold)
    return ps.EnsembleOptimizer(single, bagging=True, n_models=ENSEMBLE) if is_ensemble else single


def _model(data: _Data, terms: Sequence[str], coefficients: FloatArray) -> _Model:
    expressions = tuple(as_infix(terms, row.tolist()) for row in coefficients)
    count = int(np.count_nonzero(coefficients))
    field = field_of(expressions, data.names)
    errors = [
        _error(simulated(field, Path(times, states), MAX_EVALUATIONS), states)
        for times, states in zip(data.times, data.states, strict=True)
    ]
    values = sum(state.size for state in data.states)
    spread = np.concatenate(data.states).var(axis=0)
    error = sum(float((errors_of_one / spread).sum()) for errors_of_one in errors) / values
    return _Model(expressions, count, values * math.log(max(error, 1e-30)) + count * math.log(values))


def _error(simulated_states: FloatArray | None, states: FloatArray) -> FloatArray:
    """Return the squared errors summed over time for each state (S,)."""
    if simulated_states is None:
        return np.full(states.shape[1], WORST * len(states))
    return np.asarray(np.minimum((simulated_states - states) ** 2, WORST).sum(axis=0), dtype=np.float64)


def as_infix(terms: Sequence[str], coefficients: Sequence[float]) -> str:
    """Return a sum of PySINDy's `terms`, such as ``x^2 y`` or ``sin(1 x)``, as infix text."""
    parts = [
        repr(value) if term == "1" else f"{value!r}*{term.replace('^', '**').replace(' ', '*')}"
        for term, value in zip(terms, coefficients, strict=True)
        if value != 0.0
    ]
    return " + ".join(parts) or "0.0"
