"""Sums of a polynomial and of functions: laws are among the candidates, constants inside functions fitted."""

from itertools import combinations

import numpy as np
import pytest

from atoll_coordinator.model.description_length import constant_nats_of, structure_length
from atoll_coordinator.model.sparse.atoms import powers, product_atoms, products_with_functions
from atoll_coordinator.model.sparse.pursuit import ResidualGains, gains_of_terms, make_grid, pursue, rank_pairs
from atoll_coordinator.model.sparse.rows import RateRows, RegressionRows
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y")
ALL = {program.code for program in BY_NAME.values()}
DEFAULT = {BY_NAME[name].code for name in ("+", "-", "*", "/", "sin", "cos")}


def problem_of(law, noise=0.0):
    rng = np.random.default_rng(1)
    inputs = rng.uniform(0.3, 2.5, (2, 150))
    exact = values_of(from_infix(law, NAMES), inputs)
    values = exact + noise * exact.std() * rng.standard_normal(150)
    return Problem(NAMES, inputs, Target("x", "dx/dt", values, noise, float(values.std()))), exact


@pytest.mark.parametrize(
    ("law", "constants", "noise"),
    [
        ("0.6*y*exp(-0.7*x) - 1.2*y**3", 3, 0.0),
        ("1.5/(1.3 + y**2) - 1.5*x**2 + 0.2*y**2", 4, 1e-4),
        pytest.param("2.95*x**0.644 - 2.94*x", 3, 1e-4, marks=pytest.mark.slow),
        pytest.param("0.2*sin(y - x) + 0.6*y**2 - 0.2*x**3", 3, 0.0, marks=pytest.mark.slow),
        ("0.6*x - 0.4*x*log(x)", 2, 1e-4),
        pytest.param("1.2*x/(0.4 + x) - 0.3*x*y/(2.0 + y)", 4, 0.0, marks=pytest.mark.slow),
        pytest.param("0.5*x - 4.0*x*exp(-1.5/y)", 3, 1e-4, marks=pytest.mark.slow),
        pytest.param("0.5*x - 0.8*abs(y - 1.1)", 3, 1e-4, marks=pytest.mark.slow),
    ],
)
def test_a_law_is_among_the_sums_of_as_many_constants(law, constants, noise):
    problem, exact = problem_of(law, noise)
    programs = pursue(problem, (0, 1), ALL)
    sums = [program for program in programs if len(constant_places(program)) <= constants]
    errors = [np.abs(values_of(program, problem.inputs) - exact).max() for program in sums]
    assert min(errors) < max(1e-8, noise) * exact.std()


def test_only_operators_and_variables_that_are_allowed_are_used():
    problem, _ = problem_of("0.6*y*exp(-0.7*x) - 1.2*y**3")
    programs = pursue(problem, (1,), DEFAULT)
    codes = {code for program in programs for code in program.operators.tolist()} - {0, 1}
    assert codes <= DEFAULT | {BY_NAME["neg"].code, BY_NAME["square"].code, BY_NAME["inverse"].code}
    assert {int(program.left[node]) for program in programs for node in np.flatnonzero(program.operators == 0)} == {1}
    assert pursue(problem, (0, 1), {BY_NAME["sin"].code}) == []


def test_sums_are_few_and_finite():
    problem, _ = problem_of("1.0/(x - 0.25) + 0.1*y", 0.01)
    programs = pursue(problem, (0, 1), ALL)
    assert 0 < len(programs) <= SETTINGS.effort.beam * SETTINGS.sparse.most_constants
    for program in programs:
        assert np.isfinite(values_of(program, problem.inputs)).all()


@pytest.mark.slow
@pytest.mark.parametrize("rows", [8, 40])
def test_inputs_that_do_not_vary_have_constant_sums(rows):
    values = np.random.default_rng(1).standard_normal(rows)
    for inputs in (np.ones((2, rows)), np.zeros((2, rows))):
        programs = pursue(Problem(NAMES, inputs, Target("x", "dx/dt", values, 0.0, 1.0)), (0, 1), ALL)
        assert programs
        assert all(np.ptp(values_of(program, inputs)) == 0.0 for program in programs)


def test_rows_in_step_with_a_period_are_not_one_state():
    """Every 51st of 13,006 rows, 51 to a period, would be the same point."""
    phases = 2.0 * np.pi * (np.arange(255 * 51 + 1) % 51) / 51.0
    inputs = np.array([1.5 + np.cos(phases), 1.5 - np.sin(phases)])
    values = 0.6 * inputs[1] - 1.2 * inputs[0]
    target = Target("x", "dx/dt", values, 0.0, float(values.std()))
    programs = pursue(Problem(NAMES, inputs, target), (0, 1), {BY_NAME["+"].code, BY_NAME["*"].code})
    errors = [
        np.abs(values_of(program, inputs) - values).max() for program in programs if len(constant_places(program)) <= 2
    ]
    assert min(errors) < 1e-8


def test_the_sign_of_a_variable_is_among_the_functions():
    inputs = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 150))
    values = -0.5 * inputs[0] - 0.3 * np.sign(inputs[1])
    problem = Problem(NAMES, inputs, Target("x", "dx/dt", values, 0.0, float(values.std())))
    programs = pursue(problem, (0, 1), ALL, {BY_NAME["abs"].code}, 30.0)
    assert min(np.abs(values_of(program, inputs) - values).max() for program in programs) < 1e-8


def test_sums_that_must_have_an_operator_and_be_short_do_and_are():
    problem, _ = problem_of("0.6*x - 0.4*x*log(x)", 0.01)
    needed = {BY_NAME["log"].code, BY_NAME["sqrt"].code}
    programs = pursue(problem, (0, 1), ALL, needed, 20.0)
    nats = constant_nats_of(len(problem.target.values))
    assert programs
    assert all(needed & set(program.operators.tolist()) for program in programs)
    lengths = [structure_length(program) + nats * len(constant_places(program)) for program in programs]
    assert min(lengths) < 20.0
    assert max(lengths) < 40.0  # that of a sum and one of its terms once more
    assert pursue(problem, (0, 1), ALL, needed, 5.0) == []


def share_explained(rows, atoms, columns):
    def squared_residuals(columns):
        columns = np.array(columns) / np.linalg.norm(columns, axis=1)[:, None]
        return float(np.sum((rows.sides - np.linalg.lstsq(columns.T, rows.sides, rcond=1e-9)[0] @ columns) ** 2))

    own = [atom.values for atom in atoms]
    return 1.0 - squared_residuals([*own, *columns]) / squared_residuals(own)


def test_gains_are_the_shares_of_the_squared_residuals_that_further_terms_explain():
    rng = np.random.default_rng(5)
    inputs, further = rng.uniform(0.3, 2.5, (2, 60)), rng.standard_normal((4, 60))
    rows = RegressionRows(inputs, rng.standard_normal(60))
    sums = [product_atoms(inputs, terms) for terms in ([(0,), (1, 1)], [()], [(0,), (1,), (0, 1)])]
    gains = gains_of_terms([ResidualGains(rows, atoms) for atoms in sums], further)
    assert gains == pytest.approx(
        np.array([[share_explained(rows, atoms, [column]) for column in further] for atoms in sums])
    )
    assert ResidualGains(rows, sums[0]).gains(inputs[:1]) == [0.0], "a multiple of a term explains nothing"


def test_rows_with_large_errors_count_less_among_the_gains():
    rng = np.random.default_rng(5)
    inputs, spoilt = rng.uniform(0.3, 2.5, (1, 60)), np.arange(60) % 10 == 0
    sides = 0.5 * inputs[0] + np.where(spoilt, 50.0 * rng.standard_normal(60), 1e-3 * rng.standard_normal(60))
    term = product_atoms(inputs, [(0,)])[0]
    known = ResidualGains(RateRows(inputs, sides, np.where(spoilt, 50.0, 1e-3)), ()).gains(term.values[None])
    equal = ResidualGains(RegressionRows(inputs, sides), ()).gains(term.values[None])
    assert equal[0] < 0.5 < 0.9 < known[0]


@pytest.fixture(scope="module")
def grid_of_two_variables():
    """The rows of a law, a grid of shapes with one term and of shapes with several, and the prices of the shapes."""
    problem, _ = problem_of("1.2*x/(0.4 + x) - 0.3*y", 0.1)
    rows = RegressionRows(problem.inputs, problem.target.values)
    quotients = products_with_functions(problem.inputs, (0, 1), {BY_NAME["/"].code})
    grid = make_grid(rows, [*powers(problem.inputs, [(), (0,), (1,)]), *quotients[:: len(quotients) // 4]])
    return rows, grid, np.array([shape.price(rows.independent) for shape in grid.shapes])


@pytest.mark.parametrize("quantile", [0.6, 1.0])
def test_the_best_pair_of_each_two_shapes_is_ranked_if_its_price_is_allowed(grid_of_two_variables, quantile):
    rows, grid, prices = grid_of_two_variables
    terms, most = product_atoms(rows.inputs, [(1,)]), 2.0 * float(np.quantile(prices, quantile))
    ranked = list(rank_pairs(ResidualGains(rows, terms), grid, prices, most, 10))
    best: dict[frozenset[int], float] = {}
    for first, second in combinations(range(len(grid.atoms)), 2):
        pair = [grid.atoms[first], grid.atoms[second]]
        shapes = [grid.shapes.index(atom.shape) for atom in pair]
        if prices[shapes].sum() <= most:
            share = share_explained(rows, terms, [atom.values for atom in pair])
            best[frozenset(shapes)] = max(best.get(frozenset(shapes), 0.0), share)
    assert len(ranked) == 10
    assert [share for share, _ in ranked] == sorted((share for share, _ in ranked), reverse=True)
    keys = [frozenset(grid.shapes.index(atom.shape) for atom in pair) for _, pair in ranked]
    assert len(set(keys)) == len(keys)
    for (share, pair), key in zip(ranked, keys, strict=True):
        assert grid.atoms.index(pair[0]) < grid.atoms.index(pair[1])
        assert share == pytest.approx(share_explained(rows, terms, [atom.values for atom in pair]), rel=1e-5)
        assert share >= best.get(key, 0.0) * (1.0 - 1e-6)
    assert not [key for key, share in best.items() if key not in keys and share > ranked[-1][0] * (1.0 + 1e-6)]


def test_a_grid_has_the_finite_terms_of_each_shape_one_after_another(grid_of_two_variables):
    rows, grid, _ = grid_of_two_variables
    assert np.array_equal(grid.columns, rows.columns(grid.atoms))
    for shape, places in zip(grid.shapes, grid.ranges, strict=True):
        own = [constant for constant in shape.constants() if np.isfinite(shape.value(constant)).all()]
        assert [atom.constant for atom in grid.atoms[places]] == own
        assert all(atom.shape is shape for atom in grid.atoms[places])
    assert len(grid.atoms) == sum(places.stop - places.start for places in grid.ranges)


def test_no_function_is_added_to_a_polynomial_within_the_uncertainty_of_the_target():
    problem, _ = problem_of("0.6*x", 0.1)
    sums = [program for program in pursue(problem, (0, 1), DEFAULT) if len(constant_places(program)) > 5]
    functions = {BY_NAME[name].code for name in ("/", "inverse", "sin", "cos")}
    assert sums
    assert not any(functions & set(program.operators.tolist()) for program in sums)
