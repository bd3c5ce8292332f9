"""What the rows of a target say: an equation that is as near, and predicts something else, is a doubt."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.inference.target_checks import TargetChecks
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.parts import constant

INPUTS = np.linspace(0.5, 3.0, 40)[None]
VALUES = 2.0 * INPUTS[0] + 0.01 * np.random.default_rng(4).standard_normal(40)
PROBLEM = Problem(("a",), INPUTS, Target("f", "f", VALUES, 0.0, float(VALUES.std())))


def parsed(text):
    return from_infix(text, ("a",))


def judged(*others):
    """Return the verdict on 2 a with these (text, nats) beside it."""
    program = parsed("2.0*a")
    errors = VALUES - 2.0 * INPUTS[0]
    alternatives = [Alternative(parsed(text), nats, 0.99) for text, nats in others]
    known = (constant(2.0, 2.0, 0.01, (1.98, 2.02)),)
    shown = Refined(
        0, program, float(np.abs(errors).mean()), float(np.mean(errors**2)), known, (),
        (Alternative(program, 0.0, 1.0, is_shown=True), *alternatives),
    )  # fmt: skip
    return judge(TargetChecks(shown, PROBLEM, None))


@pytest.mark.parametrize("others", [(), (("1.99*a", 0.1),), (("2.0*a + 0.001*a*a", 0.5),), (("9.0*sin(a)", 5.0),)])
def test_what_predicts_the_same_or_is_far_behind_is_no_doubt(others):
    assert judged(*others).grade == "good"


def test_what_is_as_near_and_predicts_something_else_is():
    verdict = judged(("9.0*sin(a)", 0.5))
    assert verdict.grade == "doubtful"
    assert verdict.reason == "Another equation describes the data about as well (Δ description length 0.5)."


def test_rows_left_out_are_predicted_as_by_fits_without_them():
    """Three rows and two constants: a line through two rows predicts the third, and one row is left for the noise."""
    a, values = np.array([1.0, 2.0, 4.0]), np.array([1.0, 3.0, 4.0])
    slope, intercept = np.polyfit(a, values, 1).tolist()
    errors = values - slope * a - intercept
    shown = Refined(0, parsed(f"{slope}*a + {intercept}"), float(np.abs(errors).mean()), float(np.mean(errors**2)), ())
    checks = TargetChecks(shown, Problem(("a",), a[None], Target("f", "f", values, 0.0, float(values.std()))), None)
    others = [np.delete(np.arange(3), row) for row in range(3)]
    missed = [values[row] - np.polyval(np.polyfit(a[kept], values[kept], 1), a[row]) for row, kept in enumerate(others)]
    assert checks.predicted_r2 == pytest.approx(1.0 - np.square(missed).sum() / (3.0 * values.var()))
    assert checks.noise == pytest.approx(math.sqrt(errors @ errors))


def test_a_wave_in_the_last_digit_does_not_make_an_equation_exact():
    """2.4 x + 4.2 rounded to hundredths errs by a function of the last digit of x, which has a period of 0.05."""
    x = np.round(np.random.default_rng(3).uniform(1.0, 6.0, 26), 2)
    values = np.round(4.2 + 2.4 * x, 2)
    table = Problem(("x",), x[None], Target("y", "y", values, 0.0, float(values.std())))

    def judged_as_exact(number, error):
        known = constant(number, number, 1e-14, (number, number))
        shown = Refined(0, from_infix(f"{number}*x + 4.2", ("x",)), error, error**2, (known,))
        checks = TargetChecks(shown, table, None)
        vars(checks).update(error=error, residuals=[np.full(26, 1e-15)], predicted_r2=1.0, noise=0.0)
        return judge(checks)

    assert judged_as_exact(2.4, 1e-14).grade == "exact"
    wave = judged_as_exact(2.400000078645654, 1e-14)
    assert wave.grade == "good"
    assert "rounding errors" in wave.reason


@pytest.mark.parametrize(("text", "grade"), [("2.0*a", "doubtful"), ("a + a", "good")])
def test_constants_that_were_not_fitted_again_are_not_known(text, grade):
    """As the search left them; an equation without constants has none to be known."""
    errors = VALUES - 2.0 * INPUTS[0]
    shown = Refined(0, parsed(text), float(np.abs(errors).mean()), float(np.mean(errors**2)), ())
    verdict = judge(TargetChecks(shown, PROBLEM, None))
    assert verdict.grade == grade
    assert ("its constant" in verdict.reason) == (grade == "doubtful")
