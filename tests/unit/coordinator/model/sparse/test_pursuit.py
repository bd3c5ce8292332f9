"""Sums of a polynomial and of functions: laws are among the candidates, constants inside functions fitted."""

import numpy as np
import pytest

from atoll_coordinator.model.description_length import constant_nats_of, structure_length
from atoll_coordinator.model.sparse.atoms import product_atoms
from atoll_coordinator.model.sparse.pursuit import ResidualGains, pursue
from atoll_coordinator.model.sparse.rows import RegressionRows
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


def test_gains_are_the_shares_of_the_squared_residuals_that_further_terms_explain():
    rng = np.random.default_rng(5)
    inputs, further = rng.uniform(0.3, 2.5, (2, 60)), rng.standard_normal((4, 60))
    rows = RegressionRows(inputs, rng.standard_normal(60))
    atoms = product_atoms(inputs, [(0,), (1, 1)])

    def share(*columns):
        squares = [
            np.linalg.lstsq(np.array([*(atom.values for atom in atoms), *more]).T, rows.sides, rcond=None)[1][0]
            for more in ((), columns)
        ]
        return 1.0 - squares[1] / squares[0]

    with np.errstate(all="ignore"):
        gains, pairs = ResidualGains(rows, atoms).gains(further), ResidualGains(rows, atoms).gains_of_pairs(further)
    assert gains == pytest.approx([share(column) for column in further])
    assert pairs[0, 1:] == pytest.approx([share(further[0], column) for column in further[1:]])
    assert not np.tril(pairs).any()


def test_no_function_is_added_to_a_polynomial_within_the_uncertainty_of_the_target():
    problem, _ = problem_of("0.6*x", 0.1)
    sums = [program for program in pursue(problem, (0, 1), DEFAULT) if len(constant_places(program)) > 5]
    functions = {BY_NAME[name].code for name in ("/", "inverse", "sin", "cos")}
    assert sums
    assert not any(functions & set(program.operators.tolist()) for program in sums)
