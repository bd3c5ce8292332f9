"""Whether intervals of found constants hold the truth, however the found equation is written."""

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from benchmarks.judging.coverage import covered

ROWS = np.random.default_rng(0).uniform(0.4, 4.0, (2, 60))
COLUMNS = {"x": ROWS[0], "y": ROWS[1]}
TRUTH = "3*x - 2*x*y - x**2"


def values(text):
    return values_of(from_infix(text, ("x", "y")), np.array([*ROWS]))


def entry(value, half_width=0.1, fitted=None):
    fitted = value if fitted is None else fitted
    interval = [fitted - half_width, fitted + half_width]
    return {"value": value, "fitted": fitted, "std_error": half_width / 2, "interval": interval}


def truths(expression, constants, truth=TRUTH):
    judged = covered(expression, constants, COLUMNS, values(truth))
    return None if judged is None else [(constant.truth, constant.is_covered) for constant in judged]


def close(value):
    return pytest.approx(value, rel=1e-9)


def test_constants_of_another_way_to_write_the_truth_have_their_own_true_values():
    constants = [entry(3.05), entry(1.95), entry(1.2)]
    constants_judged = truths("x*(3.05 - 1.95*y - 1.2*x)", constants)
    assert constants_judged == [(close(3.0), True), (close(2.0), True), (close(1.0), False)]


@pytest.mark.parametrize(
    ("expression", "constants"),
    [
        ("x*(6.1 - 4.1*y - 2.05*x)/2.03", (6.1, 4.1, 2.05, 2.03)),
        ("0.5*x*(3.05 - 1.95*y - 1.2*x)/0.5", (3.05, 1.95, 1.2, 0.5)),
    ],
    ids=["a common factor", "a factor that cancels"],
)
def test_no_constants_are_known_where_others_would_do_as_well(expression, constants):
    assert truths(expression, [entry(value) for value in constants]) is None


def test_signs_that_the_text_moves_belong_to_the_constant():
    program = from_infix("3.1*x + (-2.1)*x*y - x**2", ("x", "y"))
    listed = [entry(value) for value in program.constants[program.constants != 0.0].tolist()]
    assert sorted(constant["value"] for constant in listed) == [-2.1, 3.1]
    constants_judged = truths(to_infix(program, ("x", "y")), listed)
    assert sorted(constants_judged) == [(close(-2.0), True), (close(3.0), True)]


def test_the_interval_belongs_to_the_value_before_it_was_made_simple():
    (constants,) = covered("-0.1*x", [entry(-0.1, 0.01, fitted=-0.107)], COLUMNS, values("-0.11*x"))
    assert (constants.value, constants.fitted, constants.truth) == (-0.1, -0.107, close(-0.11))
    assert constants.is_covered
    assert constants.relative_width == close(0.02 / 0.11)


def test_a_shared_constant_is_one_and_a_doubling_is_none():
    """2.0*x for x + x is no constant of the program; 1.5 is printed twice and listed once."""
    constants_judged = truths("2.0*x + 1.5*y + 1.5*x*y", [entry(1.5)], "2*x + 1.45*y + 1.45*x*y")
    assert constants_judged == [(close(1.45), True)]


def test_no_constants_are_known_of_a_structure_that_is_not_the_truths():
    assert truths("x*(3.05 - 1.95*y)", [entry(3.05), entry(1.95)]) is None


def test_a_constant_without_an_interval_is_not_covered():
    (constants,) = covered("-0.1*x", [{"value": -0.1}], COLUMNS, values("-0.1*x"))
    assert not constants.has_interval
    assert not constants.is_covered
    assert constants.relative_width is None
