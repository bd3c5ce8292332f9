"""The judge of forms on truths in odd dress (right), with summands too many (counted), and on other functions."""

import numpy as np
import pytest

from benchmarks.judging.forms import judge_form
from benchmarks.judging.rules import Form

RNG = np.random.default_rng(5)
COLUMNS = {"x": RNG.uniform(0.3, 6.0, 200), "y": RNG.uniform(0.4, 3.0, 200)}

RIGHT = [
    ("0.79*x*(1.0 - x/74.3)", "0.79*x - 0.0106325*x**2"),
    ("0.79*x*(1.0 - x/74.3)", "(0.79*(74.3 - x))*x/74.3"),
    ("0.79*x*(1.0 - x/74.3)", "x*(0.7 + 0.05 - 0.01*x)"),
    ("1.1*x - 0.4*x*y", "x - x*y*(0.3 + 0.07)"),
    ("x - cos(y)/x", "x - x/(x/cos(y)*x)"),
    ("1.09*x - 0.894*cos(y)/x", "x - sin(y + 1.5707963267948966)/x"),
    ("-9.81*sin(x) - 0.3*y", "-19.6*sin(0.5*x)*cos(x/2) - 0.3*y"),
    ("0.5*sin(y - x) - sin(y)", "0.5*(2.0*y + cos(x + 1.5707963267948966 - y)) - sin(y) - y"),
    ("1.5*x - 0.4*x*log(x)", "2.0*x - 0.5*x*log(1.3*x)"),
    ("1.2*exp(-0.3*x) - 0.2*x", "exp(0.1 - 0.4*x) - 0.2*x"),
    ("1.2*sqrt(x) - 0.9", "sqrt(4.1*x) - 1.0"),
    ("1.2*x**0.7 - 0.6*x", "1.1*x**0.74 - x*0.5"),
    ("1.0*x**2/(1.0 + x**2) + 0.2", "3.1*x**2/(2.0 + 2.0*x*x) + 0.1"),
    (
        "y - 0.075*y**2",
        "2.0*y - y/(x + 1.0)*(x + 1.0)*(0.074999999996*(y/(x + 1.0)*(x + 1.0))) - y/(x + 1.0) - y*x/(x + 1.0)",
    ),
]
EXTRA = [
    ("0.79*x*(1.0 - x/74.3)", "x*(0.7 - 0.01*x) + 1e-9*x**3", 1),
    ("0.79*x*(1.0 - x/74.3)", "x*cos(y)*(4.2e-09 - 6e-11*(x**2 + 0.0002)) + 0.79*x - 0.0106*(x**2 + 1e-08)", 2),
    ("1.1*x - 0.4*x*y", "1.1*x*cos(1e-06*y) - 0.4*x*y", 1),
    ("-9.81*sin(x) - 0.3*y", "-9.81*sin(x) - 0.3*y - 1.34e-05*x", 1),
    ("0.79*x*(1.0 - x/74.3)", "0.013*cos(0.2*x) + 0.79*x - 0.0106328*x**2 + 0.007", 2),
    ("x - cos(y)/x", "x - cos(y)/x + 0.01*y", 1),
    ("-9.81*sin(x) - 0.3*y", "-9.8*sin(x) - y*(0.3 + 1e-4*x)", 1),
    ("1.1*x - 0.4*x*y", "1.09999992*x - 5e-05*(y*x*(cos(0.16666*(y*x))/y)*x) - 0.4*x*y", 1),
    ("1.0*x/(1.0 + x)", "1.1*x/(1.01 + x) + 0.3/(x + 5.0)", 1),
]
OTHER = [
    ("0.79*x*(1.0 - x/74.3)", "0.79*x"),
    ("0.79*x*(1.0 - x/74.3)", "0.79*x*(1.0 + x/74.3)"),
    ("1.1*x - 0.4*x*y", "1.1*x"),
    ("1.1*x - 0.4*x*y", "1.1*x - 0.4*x*y**2"),
    ("1.1*x - 0.4*x*y", "y +"),
    ("1.1*x - 0.4*x*y", "log(-x) - y"),
    ("x - cos(y)/x", "x - y*cos(y)/x"),
    ("1.2*sqrt(x) - 0.9", "1.2*log(x) - 0.9"),
]


@pytest.mark.parametrize(("truth", "expression"), RIGHT)
def test_a_truth_in_odd_dress_is_right(truth, expression):
    assert judge_form(expression, truth, COLUMNS) == Form("right", 0)


@pytest.mark.parametrize(("truth", "expression", "extra"), EXTRA)
def test_summands_beside_the_truth_are_counted(truth, expression, extra):
    assert judge_form(expression, truth, COLUMNS) == Form("extra", extra)


@pytest.mark.parametrize(("truth", "expression"), OTHER)
def test_another_function_is_not_right(truth, expression):
    form = judge_form(expression, truth, COLUMNS)
    assert form.kind in ("missing", "other")
    assert form.extra is None


def test_a_term_that_is_missing_is_said():
    assert judge_form("1.1*x", "1.1*x - 0.4*x*y", COLUMNS).kind == "missing"


def test_no_equation_is_none():
    assert judge_form(None, "x", COLUMNS).kind == "none"


def test_extra_terms_are_not_looked_for_unless_asked_for():
    assert judge_form("x - cos(y)/x + 0.01*y", "x - cos(y)/x", COLUMNS, with_extra=False) == Form("other")
