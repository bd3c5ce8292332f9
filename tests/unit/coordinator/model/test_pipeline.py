"""From a front to the equation that is shown."""

import math
from dataclasses import fields

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.constants.standard_errors import student_quantile_95
from atoll_coordinator.model.description_length import RegressionCriterion
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Pool, decode_members
from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.model.regression import equation
from atoll_coordinator.model.regression.equation import refine_equation
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, SpaceConfig
from atoll_core.expression.program import Program
from atoll_core.expression.writing.expansion import form_of
from atoll_core.search.pareto import FrontEntry
from tests.unit.coordinator.model.fitting import CONFIG, dataset, entry, parsed, problem, settings, shown


def lotka(x, y):
    return 3.0 * x - 2.0 * x * y - x * x


def quotient(x, y):
    return 4.0 - 2.0 * y / (x + 2.0 / x)


def refine(sought, config, front):
    return refine_equation(sought, config, decode_members(front, len(sought.names)))


def refined_text(sought, *front: str, config=CONFIG) -> str:
    refined = refine(sought, config, [entry(text, sought) for text in front])
    assert refined is not None
    return shown(refined.program)


def is_same(text: str, other: str) -> bool:
    import sympy

    x, y = sympy.symbols("x y")
    names = {"x": x, "y": y}
    difference = sympy.nsimplify(sympy.sympify(text, names) - sympy.sympify(other, names), rational=True)
    return sympy.simplify(difference) == 0


def is_near(text: str, other: str) -> bool:
    """Tell whether two expressions in the same monomials have coefficients that differ by less than a hundredth."""
    import sympy

    names = dict(zip("xy", sympy.symbols("x y"), strict=True))
    one, two = (sympy.Poly(sympy.numer(sympy.together(sympy.sympify(entry, names))), *names.values()).as_dict()
                for entry in (text, other))  # fmt: skip
    first = max(two)
    return one.keys() == two.keys() and all(
        abs(one[power] / one[first] / (two[power] / two[first]) - 1) < 0.01 for power in two
    )


LOTKA = "3*x - 2*x*y - x**2"


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_constants_that_the_data_single_out_come_out_simple(noise):
    sought = problem(lotka, noise, rows=300)
    assert is_same(refined_text(sought, "1.2*x", "2.97*x - 2.04*x*y - 0.98*x*x"), LOTKA)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_noisy_constants_come_out_as_estimates(noise):
    sought = problem(lotka, noise, rows=300)
    assert is_near(refined_text(sought, "1.2*x", "2.97*x - 2.04*x*y - 0.98*x*x"), LOTKA)


@pytest.mark.slow
def test_what_the_data_do_not_support_is_left_out():
    sought = problem(lotka, 0.05, rows=300)
    assert is_near(refined_text(sought, "3.0*x - 2.0*x*y - x*x + 0.01*sin(7.0*y)*x + 0.002"), LOTKA)


def test_an_exact_member_stays_as_it_is_bit_for_bit():
    sought = problem(lotka)
    front = [entry("1.5*x", sought), entry("x*(3.0 - x - 2.0*y)", sought)]
    refined = refine(sought, CONFIG, front)
    assert refined is not None
    assert refined.program == Program.from_bytes(front[1].program, 2)
    assert (refined.member, refined.error, refined.mse) == (1, front[1].error, front[1].mse)


def test_the_last_digits_of_exact_constants_are_set_right():
    assert is_same(refined_text(problem(lotka), "x*(2.9999999999999996 - 1.0000000000000002*x - 2.0*y)"), LOTKA)


def test_constants_that_are_not_simple_keep_their_digits():
    sought = problem(lambda x, y: 0.123456789 * x - math.pi * y)
    refined = refine(sought, CONFIG, [entry("0.12*x - 3.1*y", sought)])
    assert refined is not None
    assert refined.mse < 1e-24
    assert sorted(np.abs(refined.program.constants).tolist())[-2:] == pytest.approx([0.123456789, math.pi], rel=1e-12)


@pytest.mark.slow
def test_a_step_beside_the_best_member_is_found():
    sought = problem(quotient, 0.01, rows=300)
    assert is_near(refined_text(sought, "4.1 - 2.0*y/x", "4.1 - 2.1*y/(x + 0.8)"), "4 - 2*y/(x + 2/x)")


def test_operators_that_are_not_allowed_are_not_brought_in():
    sought = problem(quotient, 0.01, rows=300)
    config = CONFIG.model_copy(update={"space": SpaceConfig(operators=("+", "-", "*"))})
    assert "/" not in refined_text(sought, "4.1 - 0.7*y", "4.0 - 0.7*y - 0.1*x*y", config=config)


@pytest.mark.slow
def test_a_double_angle_and_a_shared_factor_become_the_shorter_form():
    sought = problem(lambda x, y: (np.cos(y) ** 2 + 0.1 * np.sin(y) ** 2) * np.sin(x), 0.02, rows=300)
    text = refined_text(sought, "0.45*cos(2.0*y)*sin(x) + 0.55*sin(x)")
    assert text.count("sin") + text.count("cos") == 2
    assert "2.0*y" not in text


def test_standard_errors_are_those_of_the_fit_and_the_fitted_values_stay_known():
    sought = problem(lambda x, y: 3.0 * x - 0.7 * y, noise=0.01)
    refined = refine(sought, CONFIG, [entry("2.8*x - 0.9*y", sought)])
    assert refined is not None
    expected, (squares,), *_ = np.linalg.lstsq(sought.inputs.T, sought.target.values, rcond=None)
    assert sorted(abs(constant.fitted) for constant in refined.constants) == pytest.approx(
        sorted(np.abs(expected)), rel=1e-6
    )
    covariance = np.linalg.inv(sought.inputs @ sought.inputs.T) * squares / (len(sought.target.values) - 2)
    errors = sorted(constant.std_error for constant in refined.constants)
    assert errors == pytest.approx(sorted(np.sqrt(np.diag(covariance))), rel=1e-6)
    shown = np.array(sorted(np.abs(refined.program.constants))[-2:])
    assert (np.abs(shown - [0.7, 3.0]) < 5.0 * np.array(errors)).all()


def test_a_member_that_meets_the_target_is_never_exchanged_for_one_that_misses_it():
    sought = problem(lotka, 0.1, rows=300)
    front = [entry("2.0*x - 2.0*x*y", sought), entry("2.97*x - 2.04*x*y - 0.98*x*x", sought)]
    strict = CONFIG.model_copy(
        update={"budget": BudgetConfig(target_error=front[1].error / sought.target.standard_deviation)}
    )
    refined = refine(sought, strict, front)
    assert refined is None or refined.error <= front[1].error


@pytest.mark.slow
def test_the_largest_size_is_respected():
    sought = problem(lotka, 0.01, rows=40)
    config = CONFIG.model_copy(update={"space": SpaceConfig(max_size=3)})
    refined = refine(sought, config, [entry("1.2*x", sought)])
    assert refined is None or len(refined.program) <= 3


def test_the_error_is_the_loss_of_the_job():
    sought = problem(lotka, 0.1)
    config = CONFIG.model_copy(update={"evolution": EvolutionConfig(loss="rmse")})
    refined = refine(sought, config, [entry("2.9*x - 2.0*x*y - x*x", sought)])
    assert refined is not None
    assert refined.error == math.sqrt(refined.mse)


@pytest.mark.slow
def test_many_rows_are_compared_on_some_and_measured_on_all():
    sought = problem(lotka, 0.01, rows=5000)
    front = [entry("2.97*x - 2.04*x*y - 0.98*x*x", sought)]
    refined = refine(sought, CONFIG, front)
    assert refined is not None
    assert is_same(shown(refined.program), LOTKA)
    assert refined.mse == pytest.approx(entry(LOTKA.replace("**2", "*x"), sought).mse, rel=1e-9)


def test_constants_fitted_to_given_left_hand_sides_have_intervals():
    data = dataset(lambda x, y: 3.0 * x + 0.002 * y, noise=0.1)
    front = (entry("2.9*x + 0.1*y", data.problem("label")),)
    constants = refine_all(Preparation(data), CONFIG, {"label": Pool(front)}).equations["label"].constants
    assert all(constant.identifiable for constant in constants)
    for constant in constants:
        low, high = constant.interval
        assert (low + high) / 2.0 == pytest.approx(constant.fitted)
        assert high - low == pytest.approx(2.0 * student_quantile_95(200 - 1) * constant.std_error, rel=1e-6)


def test_factors_of_one_have_intervals_where_left_hand_sides_are_given():
    data = dataset(lambda x, y: 3.0 * x + y, noise=0.1)
    front = (entry("2.9*x + y", data.problem("label")),)
    equation = refine_all(Preparation(data), CONFIG, {"label": Pool(front)}).equations["label"]
    (unit,) = equation.unit_coefficients
    assert (shown(unit.of), unit.constant.value) == ("y", 1.0)
    low, high = unit.constant.interval
    assert low < 1.0 < high


@pytest.mark.slow
def test_an_empty_front_stays_empty_and_all_variables_are_refined():
    data = dataset(lotka)
    sought = data.problem("label")
    assert refine(sought, CONFIG, []) is None
    preparation = Preparation(data)
    assert refine_all(preparation, CONFIG, {"label": Pool(())}).equations == {}
    assert set(refine_all(preparation, CONFIG, {"label": Pool((entry("2.0*x", sought),))}).equations) == {"label"}


def test_a_member_without_a_finite_value_is_not_shown():
    sought = problem(lotka, rows=60)
    broken = FrontEntry(2, 1e-15, 1e-30, 0, 1, 0, parsed("log(y)").to_bytes())
    refined = refine(sought, CONFIG, [broken])
    assert refined is None or math.isfinite(refined.error)


def test_it_is_repeatable():
    sought = problem(quotient, 0.1, rows=60)
    front = [entry(text, sought) for text in ("4.0 - y", "4.1 - 2.0*y/x")]
    first, second = refine(sought, CONFIG, front), refine(sought, CONFIG, front)
    assert isinstance(first, Refined)
    assert isinstance(second, Refined)
    assert [getattr(first, field.name) for field in fields(Refined)] == [
        getattr(second, field.name) for field in fields(Refined)
    ]


@pytest.mark.slow
def test_the_work_is_bounded(monkeypatch):
    sought = problem(quotient, 0.1)
    front = [entry(text, sought) for text in ("4.0 - y", "4.1 - 2.1*y/(x + 0.8) + 0.1*sin(3.0*x*y) - 0.2*cos(x)/y")]
    spent = []
    for most in (100_000, 2_000_000):
        monkeypatch.setattr(equation, "SETTINGS", settings("effort", work=5 * most))
        rows, criterion = LeastSquares(sought), RegressionCriterion.of(sought.target)
        shortening = equation.make_target_shortening(rows, criterion, frozenset({2, 3, 4, 5, 6, 7}), range(2))
        assert shortening.find_candidates([Program.from_bytes(entry.program, 2) for entry in front])
        spent.append(rows.evaluations)
    assert spent[0] < 0.5 * spent[1]


def test_operators_and_variables_of_one_equation_hold_for_its_refinement():
    """One step from the front there is the truth, which is not taken where it may not be."""
    sought = problem(lambda x, y: x + y, rows=300)
    assert refined_text(sought, "1.7*x") == "x + y"
    for space in (SpaceConfig(operators_of={"label": ("*", "/")}), SpaceConfig(variables_of={"label": ("x",)})):
        refined = refine(sought, CONFIG.model_copy(update={"space": space}), [entry("1.7*x", sought)])
        assert refined is None or "y" not in shown(refined.program)


def test_threads_are_as_many_as_the_cores_that_may_be_used(monkeypatch):
    class Begun(Exception):
        pass

    def spreading(batches, threads, deadline):
        raise Begun(threads)

    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "1")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr("atoll_coordinator.model.pipeline.spreading", spreading)
    preparation = Preparation(dataset(lotka, rows=20), recording=object())
    with pytest.raises(Begun) as begun:
        refine_all(preparation, CONFIG, {})
    assert begun.value.args == (1,)


def test_rivals_of_a_target_are_distinct_in_form_and_no_longer_than_allowed():
    """The same form with other constants is no rival, nor is what --max-size forbids."""
    sought = problem(lambda x, y: 2.0 * x * np.exp(0.1 * y), 0.02, 40)
    front = [entry(text, sought) for text in ("2.0*x", "2.0*x + 0.2*x*y", "1.9*x*exp(0.1*y)", "0.01 + 2.0*x")]
    members = decode_members(front, len(sought.names))
    for size in (None, 3):
        config = JobConfig(space=SpaceConfig(max_size=size)) if size else CONFIG
        refined = refine_equation(sought, config, members, has_intervals=True)
        forms = [form_of(alternative.program) for alternative in refined.alternatives]
        assert refined.alternatives[0].is_shown
        assert len(forms) == len(set(forms)) > (1 if size is None else 0)
        assert size is None or all(len(alternative.program) <= size for alternative in refined.alternatives)
    assert refine_equation(sought, CONFIG, members).alternatives == ()
