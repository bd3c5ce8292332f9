"""First estimates of the parameters of a template, from the derivatives. Pure.

How it works. Each unknown part is replaced by a polynomial of its variables. The parameters, and the coefficients of
the polynomials, are fitted to the derivatives of all equations together, weighted by their uncertainties. The fit
begins from several starts: the start values of the parameters, and values between their bounds. Refining fits whole
trajectories, beginning with these estimates. The targets of the search depend on them, so all sums have a fixed order.

Doubtful: derivatives are smoothed, so estimates from a coarse or noisy table can be far from the truth. A polynomial
may be too stiff for the unknown part. So the estimates are only starts.

Letters: R rows, P parameters, K numbers: parameters, then coefficients.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.model.least_squares import SETTLED, Descent, Solver, minimize, solver
from atoll_coordinator.model.shooting.many_starts import values_between
from atoll_coordinator.model.shooting.points_between import latin_hypercube
from atoll_coordinator.model.sparse.atoms import polynomial_and_fourier_libraries, sum_of
from atoll_coordinator.model.sparse.kernels.elimination import scalar_products, triangularize
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import CLEAN_UNCERTAINTY, Dataset, FloatArray
from atoll_core.expression.evaluation import values_and_gradient
from atoll_core.expression.operators import BY_NAME, VARIABLE
from atoll_core.expression.program import Expression, Program, constant_places, with_constants
from atoll_core.expression.template import EquationTemplate, TemplateParameter

_ROWS_OF_A_TERM: Final = 5
"""Rows for each term of the polynomial that stands for an unknown part."""
_DIGITS: Final = 6
"""Digits of the estimates: a fit is less accurate than its last digits."""
_UNBOUNDED: Final = (1e-2, 1e2)
"""Range of starts of a parameter without bounds, as multiples of its first value."""


@dataclass(frozen=True, eq=False)
class ParameterEstimates:
    """The values (P,) of the parameters of a template, and sentences on those that the data do not determine."""

    values: FloatArray
    warnings: tuple[str, ...] = ()


def estimate_parameters(dataset: Dataset, config: JobConfig, template: EquationTemplate) -> ParameterEstimates:
    """Return estimates of the parameters of a template from the derivatives in the dataset.

    A parameter that the unknown part can replace, such as c in ``-c*v + ?``, keeps its start value.
    """
    names = [target.variable for target in dataset.targets if target.variable in template.sides]
    if not template.parameters or not names:
        return ParameterEstimates(template.starts)
    sides = _FittedSides.of(dataset, config, template, names)
    points = [sides.fit(start) for start in draw_starts(template.parameters, SETTINGS.effort.kept)]
    best = min(points, key=lambda point: point.cost)
    if not math.isfinite(best.cost):
        return ParameterEstimates(template.starts)
    values, warnings = template.starts, list[str]()
    for place, share in enumerate(sides.own_shares(best)):
        if share is None:
            continue
        if share >= CLEAN_UNCERTAINTY:
            values[place] = float(f"{best.numbers[place]:.{_DIGITS - 1}e}")
        elif template.unknowns:
            called = template.parameters[place].name
            warnings.append(
                f"The parameter {called} cannot be told from the unknown part, which may contain the same term: give "
                f"{called} as a number, or name with ?(…) the variables on which the unknown part depends."
            )
    lower, upper = ([getattr(one, end) for one in template.parameters] for end in ("lower", "upper"))
    return ParameterEstimates(np.clip(values, lower, upper), tuple(warnings))


def draw_starts(parameters: Sequence[TemplateParameter], count: int) -> FloatArray:
    """Return start values (S, P) of parameters: their first values, then `count` - 1 values between their bounds (Latin
    hypercube, see `values_between`). A parameter that has not two bounds keeps its sign."""
    firsts = np.array([parameter.first_value for parameter in parameters])
    lower, upper = np.array([(one.lower, one.upper) for one in parameters]).T
    is_bounded, sizes = np.isfinite(lower) & np.isfinite(upper), np.where(firsts == 0.0, 1.0, firsts)
    low, high = (
        np.where(is_bounded, end, factor * sizes) for end, factor in zip((lower, upper), _UNBOUNDED, strict=True)
    )
    drawn = [
        np.clip(values_between(low, high, shares, firsts), lower, upper)
        for shares in latin_hypercube(count - 1, len(parameters))
    ]
    return np.array([firsts, *drawn])


@dataclass(frozen=True, eq=False)
class _EstimatePoint:
    """Numbers (K,) of a fit, half the weighted sum of squares, its gradient (K,) and normal matrix (K, K)."""

    numbers: FloatArray
    cost: float
    gradient: FloatArray
    normal: FloatArray


@dataclass(frozen=True, eq=False)
class _FittedSides:
    """The sides of the equations, with a polynomial in the place of each unknown part.

    `programs` are the sides, `nodes` their fitted constants, `columns` the number of each of these constants. `targets`
    are the derivatives, `errors` their uncertainties, `inputs` (V, R) the variables. `lower` and `upper` (K,) are
    bounds. `first` are the coefficients of the polynomials with which fits start.
    """

    programs: tuple[Program, ...]
    nodes: tuple[tuple[int, ...], ...]
    columns: tuple[tuple[int, ...], ...]
    targets: tuple[FloatArray, ...]
    errors: tuple[float, ...]
    inputs: FloatArray
    lower: FloatArray
    upper: FloatArray
    first: FloatArray

    @classmethod
    def of(
        cls, dataset: Dataset, config: JobConfig, template: EquationTemplate, names: Sequence[str]
    ) -> "_FittedSides":
        polynomials = {one.home: _polynomial(dataset, config, one.home) for one in template.unknowns}
        zero = sum_of([1.0], [0.0])
        equations = tuple(dict.fromkeys([*template.sides, *polynomials]))
        whole = template.for_equations(equations)
        assert whole is not None
        composition = whole.compose([polynomials.get(name, zero) for name in equations], template.starts)
        number = {
            place: parameter for parameter, places in enumerate(composition.parameters) for place in places
        }  # fmt: skip
        first = list[float]()
        for home, polynomial in polynomials.items():
            for node, places in composition.places[equations.index(home)].items():
                number |= dict.fromkeys(places, len(template.parameters) + len(first))
                first.append(float(polynomial.constants[node]))
        indices = [equations.index(name) for name in names]
        programs = tuple(composition.programs[index] for index in indices)
        nodes = tuple(
            tuple(node for node in constant_places(program) if (index, node) in number)
            for index, program in zip(indices, programs, strict=True)
        )
        problems = [dataset.problem(name).target for name in names]
        free = [math.inf] * len(first)
        return cls(
            programs, nodes,
            tuple(tuple(number[index, node] for node in own) for index, own in zip(indices, nodes, strict=True)),
            tuple(target.values for target in problems),
            tuple(
                max(target.uncertainty, CLEAN_UNCERTAINTY) * target.standard_deviation for target in problems
            ),
            dataset.inputs,
            np.array([*(one.lower for one in template.parameters), *(-end for end in free)]),
            np.array([*(one.upper for one in template.parameters), *free]),
            np.array(first),
        )  # fmt: skip

    def fit(self, parameters: FloatArray) -> _EstimatePoint:
        """Return the fit that begins with these values of the parameters."""
        start = self.point(np.concatenate([parameters, self.first]))
        if not math.isfinite(start.cost):
            return start
        return minimize(Descent(start, self._equations, self._step, lambda point: SETTLED * point.cost))

    def point(self, numbers: FloatArray) -> _EstimatePoint:
        """Return the cost of these numbers with its derivatives; the cost is infinite if a side has no finite value."""
        residuals, slopes = self._linearise(numbers)
        products = _scalar_products(np.concatenate([slopes, residuals[None]]))
        cost, gradient = 0.5 * float(products[-1, -1]), products[-1, :-1].copy()
        normal = np.ascontiguousarray(products[:-1, :-1])
        is_finite = math.isfinite(cost) and np.isfinite(gradient).all() and np.isfinite(normal).all()
        return _EstimatePoint(numbers, cost if is_finite else math.inf, gradient, normal)

    def _linearise(self, numbers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residuals of all equations, and their derivatives by the numbers (K, ...)."""
        residuals, slopes = [], []
        for program, nodes, columns, target, error in zip(
            self.programs, self.nodes, self.columns, self.targets, self.errors, strict=True
        ):
            moved = with_constants(program, dict(zip(nodes, numbers[list(columns)].tolist(), strict=True)))
            values, by_node = values_and_gradient(moved, self.inputs, nodes)
            own = np.zeros((len(numbers), len(target)))
            with np.errstate(all="ignore"):
                for column, slope in zip(columns, by_node, strict=True):
                    own[column] += slope / error
                residuals.append((values - target) / error)
            slopes.append(own)
        return np.concatenate(residuals), np.concatenate(slopes, axis=1)

    def _equations(self, point: _EstimatePoint) -> Solver[FloatArray]:
        return solver(point.normal, point.gradient, (self.lower - point.numbers, self.upper - point.numbers))

    def _step(self, point: _EstimatePoint, step: FloatArray) -> tuple[_EstimatePoint, float] | None:
        there = self.point(np.clip(point.numbers + step, self.lower, self.upper))
        return (there, point.cost - there.cost) if math.isfinite(there.cost) else None

    def own_shares(self, point: _EstimatePoint) -> list[float | None]:
        """Return, for each parameter, the share of its effect that no other number can replace; None for a parameter
        without an effect."""
        _, slopes = self._linearise(point.numbers)
        sizes = np.sqrt(np.diag(_scalar_products(slopes)))
        units = slopes / np.where(sizes > 0.0, sizes, 1.0)[:, None]
        shares: list[float | None] = []
        for place in range(len(units) - len(self.first)):
            columns = np.concatenate([np.delete(units, place, axis=0), units[place][None]])
            left = triangularize(columns, np.empty((len(units) - 1, len(units))))
            shares.append(math.sqrt(left) if sizes[place] > 0.0 else None)
        return shares


def _scalar_products(rows: FloatArray) -> FloatArray:
    """Return the scalar products (K, K) of the rows (K, R); they are added in the order of R."""
    products = np.empty((len(rows), len(rows)))
    for row, dots in zip(rows, products, strict=True):
        scalar_products(row, rows, dots)
    return products


def _polynomial(dataset: Dataset, config: JobConfig, name: str) -> Program:
    """Return a polynomial of the variables that the unknown part of an equation may contain, with as many terms as the
    rows allow."""
    columns = config.space.columns_for(name, dataset.names)
    codes = [BY_NAME[text].code for text in ("+", "*")]
    plain: list[Expression] = [1.0, *((VARIABLE, column) for column in columns)]
    libraries = [plain, *polynomial_and_fourier_libraries(columns, codes)]
    most = dataset.inputs.shape[1] // _ROWS_OF_A_TERM
    terms = max((one for one in libraries if len(one) <= most), key=len, default=plain[:1])
    starts = np.linspace(0.5, 1.0, len(terms))  # different numbers, so that no two of them become one constant
    return sum_of(terms, starts.tolist())
