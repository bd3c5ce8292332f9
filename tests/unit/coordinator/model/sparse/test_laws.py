"""Laws by backward elimination: the right terms with and without noise, and what they are compared with."""

import numpy as np
import pytest
from scipy import special

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.sparse.atoms import product_atoms, products
from atoll_coordinator.model.sparse.laws import find_laws, find_laws_among_many, settled_variables
from atoll_coordinator.model.sparse.regression import SparseRegression
from atoll_coordinator.model.sparse.rows import MeasuredRows, weak_rows
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import BudgetConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import Known, table
from tests.unit.coordinator.model.sparse.lorenz import NAMES, TERMS, monomials, prepared
from tests.unit.coordinator.model.sparse.ring import RING, SUMS, ring

OPERATORS = frozenset(BY_NAME[name].code for name in ("+", "-", "*", "/"))


def laws_of(preparation, name, columns=(0, 1, 2), **options):
    return find_laws(preparation.dataset.problem(name), preparation.recording, columns, OPERATORS, **options)


def settled_of(preparation, config):
    return settled_variables(preparation, config, find_laws_among_many(preparation, config))


def terms(law):
    return monomials(to_infix(law.program, NAMES))


@pytest.mark.parametrize("noise", [0.0, 0.01, pytest.param(0.05, marks=pytest.mark.slow)])
def test_the_terms_of_lorenz_are_found(noise):
    preparation = prepared(1000, noise, trajectories=4)
    for name in NAMES:
        best = laws_of(preparation, name)[0]
        assert terms(best) == TERMS[name], name
        assert best.is_tested
        assert best.excess < 1.3


def test_the_terms_are_found_where_noise_is_a_fifth_of_the_deviation_and_rows_are_few_to_a_period():
    preparation = prepared(4000, 0.2, step=0.05, method="DOP853", rtol=1e-6, atol=1e-6)
    for name in NAMES:
        best = laws_of(preparation, name)[0]
        assert terms(best) == TERMS[name], name
        assert best.excess < 1.1


def test_tolerances_of_a_solver_add_no_terms():
    preparation = prepared(1000, 0.0, step=0.02, rtol=1e-6, atol=1e-9, method="RK45")
    for name in NAMES:
        assert terms(laws_of(preparation, name)[0]) == TERMS[name], name


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_sums_of_more_nodes_than_programs_may_have_are_no_laws(noise, monkeypatch):
    preparation = prepared(400, noise)
    assert laws_of(preparation, "y")
    monkeypatch.setattr("atoll_coordinator.model.sparse.laws.MAX_NODES", 5)
    assert not laws_of(preparation, "y")


def test_with_few_rows_the_largest_library_is_not_tested():
    assert not any(law.is_tested for law in laws_of(prepared(150, 0.05), "x"))


def test_only_allowed_variables_and_operators_are_used():
    preparation = prepared(1000, 0.01)
    assert all("z" not in to_infix(law.program, NAMES) for law in laws_of(preparation, "x", columns=(0, 1)))
    problem = preparation.dataset.problem("x")
    assert find_laws(problem, preparation.recording, (0, 1, 2), {BY_NAME["sin"].code}) == ()


@pytest.mark.slow
def test_other_functions_that_describe_the_data_as_well_leave_no_lead():
    preparation = prepared(1000, 0.02, trajectories=2)
    wrong, as_well = (from_infix(text, NAMES) for text in ("9*(y - x) + sin(x)", "10*(y - x)*cos(0.001*z)"))
    assert laws_of(preparation, "x", others=[wrong])[0].lead > 17.0
    assert laws_of(preparation, "x", others=[wrong, as_well])[0].lead < 15.0


PENDULUM = Known(("x", "v"), lambda _, z: [z[1], -np.sin(z[0])])


def test_a_rival_is_compared_with_one_factor_fitted_to_the_windows():
    """Smoothing flattens the peaks of derivatives, so that a search gives a sine a factor that is too small."""
    preparation = prepare(table(PENDULUM, [[2.5, 0.0]], 0.05 * np.arange(1000.0), 0.03, 1), JobConfig())
    sines = [from_infix(text, PENDULUM.names) for text in ("-0.95*sin(x)", "-0.98*sin(x)")]
    leads = [laws_of(preparation, "v", columns=(0, 1), others=[sine])[0].lead for sine in sines]
    assert leads[0] == pytest.approx(leads[1], abs=1e-3)
    assert leads[0] < SETTINGS.inference.distinct_nats


def test_a_product_that_is_written_with_a_quotient_of_equals_is_no_rival():
    preparation = prepared(1000, 0.02, trajectories=2)
    assert laws_of(preparation, "x", others=[from_infix("10*(y/y*y - x)", NAMES)])[0].lead == np.inf


@pytest.mark.slow
def test_sums_of_products_are_no_rivals_and_further_libraries():
    preparation = prepared(1000, 0.02, trajectories=2)
    truth = from_infix("10*(y - x)", NAMES)
    alone, beside = laws_of(preparation, "x")[0], laws_of(preparation, "x", others=[truth])[0]
    assert beside.lead == np.inf
    assert terms(beside) == terms(alone) == TERMS["x"]


def test_windows_that_differ_much_in_variance_decide_the_terms_of_a_state_in_bursts():
    """y' = x y + 0.1 y: the weights of windows are those of the sum itself."""
    generator = np.random.default_rng(1)
    times = np.linspace(0.0, 30.0, 3000)
    values = np.array([6.0 * np.sin(times), np.exp(-6.0 * np.cos(times) + 0.1 * times - 3.0), np.cos(0.37 * times)])
    sizes = 0.02 * values.std(axis=1)
    noisy = values + sizes[:, None] * generator.normal(size=values.shape)
    measured_states = MeasuredRows(times, ((0, len(times)),), noisy, values, sizes)
    form = weak_rows(measured_states, 1, 12)
    wrong = products((0, 1, 2), 2)
    found = SparseRegression(form, product_atoms(noisy, wrong)).select_terms(range(len(wrong)))
    assert monomials(to_infix(found.program(), NAMES)) == {"y", "x*y"}
    assert 0.7 < found.excess < 1.3


def test_fitted_coefficients_are_no_degrees_of_freedom_of_what_a_law_leaves():
    """Up to ten terms where one suffices: what they take away is no sign of errors that are smaller than measured."""
    generator = np.random.default_rng(1)
    times = np.linspace(0.0, 20.0, 400)
    values = np.array([np.sin(times) + 0.3 * np.sin(2.3 * times), np.cos(times) + 0.69 * np.cos(2.3 * times)])
    sizes = 0.02 * values.std(axis=1)
    noisy = values + sizes[:, None] * generator.normal(size=values.shape)
    form = weak_rows(MeasuredRows(times, ((0, len(times)),), noisy, values, sizes), 0, 20)
    for degree, count in ((1, 3), (2, 6), (3, 10)):
        regression = SparseRegression(form, product_atoms(noisy, products((0, 1), degree)))
        found, free = regression.refit(range(count), np.ones(len(form.sides))), form.independent - count
        assert found.assessment.probability == pytest.approx(special.chdtrc(free, free * found.excess**2))


@pytest.mark.parametrize(
    ("rows", "changes", "expected"),
    [
        (1000, {}, True),
        (150, {}, False),
        (1000, {"budget": BudgetConfig(target_error=0.01)}, False),
        (1000, {"budget": BudgetConfig(stagnation=5)}, False),
        (1000, {"prior": PriorConfig(guesses={"x": ("y - x",)})}, False),
        (1000, {"space": SpaceConfig(operators=("+", "sin"))}, False),
        (1000, {"space": SpaceConfig(variables_of={"x": ("x", "z")})}, False),
    ],
)
@pytest.mark.slow
def test_a_long_search_is_spared_where_all_equations_have_laws_and_nothing_else_is_asked_for(rows, changes, expected):
    preparation = prepared(rows, 0.01, trajectories=4)
    assert settled_of(preparation, JobConfig(**changes)) == (set(NAMES) if expected else set())


def test_among_many_variables_each_equation_that_has_a_law_is_settled_by_itself():
    assert settled_of(prepare(ring(), SUMS), SUMS) == set(RING[:5])


def test_weights_of_rows_are_not_taken_for_equal():
    preparation = prepared(400, 0.02)
    part = preparation.recording.trajectories[0]
    object.__setattr__(part, "weights", np.ones(len(part.times)))
    assert laws_of(preparation, "x") == ()
