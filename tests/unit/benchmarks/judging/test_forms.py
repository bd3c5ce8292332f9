"""The form checker on rewritings (accepted) and near-misses (refused) of the equations of the benchmarks."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from benchmarks.judging.forms import compare
from benchmarks.judging.rules import Form

RANGES = {"respiration": ((0.5, 12.0), (3.0, 18.0)), "glider": ((1.0, 9.0), (-2.0, 30.0)), "": ((0.3, 6.0), (0.2, 1.5))}
HALF_PI = "1.5707963267948966"
GLIDER, RESPIRATION = "-0.05*x**2 - sin(y)", "20 - x - x*y/(1 + 0.5*x**2)"
MAGNETS, SHEAR = "0.5*sin(x - y) - sin(x)", "(cos(y)**2 + 0.1*sin(y)**2)*sin(x)"
VOLTERRA = "3*x - 2*x*y - x**2"
CASES = [
    ("glider", GLIDER, f"cos(y + {HALF_PI}) - 0.05*x**2", True),
    ("glider", GLIDER, "sin(y + 3.141592653589793) - x**3/(20*x)", True),
    ("glider", GLIDER, "-0.0502*x**2 - 0.9991*sin(y)", True),
    ("glider", GLIDER, "-2.0*sin(y/2)*cos(0.5*y) - 0.05*x**2", True),
    ("glider", GLIDER, "-0.05*x**2 - sin(y) + 1e-9*x", True),
    ("glider", GLIDER, "-0.05*x**2 - sin(y) + 0.001", False),
    ("glider", GLIDER, "-0.05*x**2.1 - sin(y)", False),
    ("glider", GLIDER, "-0.05*x**2 - sin(1.02*y)", False),
    ("glider", "x - cos(y)/x", "x + (2*sin(0.5*y)**2 - 1)/x", True),
    ("glider", "x - cos(y)/x", "x - cos(y)/(x + 0.001)", False),
    ("glider", "x - cos(y)/x", "x - cos(y + 0.001)/x", False),
    ("respiration", RESPIRATION, "20 - x*(x + 3)/(x + 3.0) - x*y/(1 + 0.5*x**2)", True),
    ("respiration", RESPIRATION, "20.05 - 0.999*x - x*y/(1.002 + 0.501*x*x)", True),
    ("respiration", RESPIRATION, "20 - x - x*y*(1 + x)/((1 + 0.5*x**2)*(1.05 + x))", False),
    ("respiration", RESPIRATION, "20 - x - x*y/(1 + 0.01*x + 0.5*x**2)", False),
    ("", "x*(4 - x - y/(1 + x))", "4*x - x**2 - 1/(1/y + 1/(x*y))", True),
    ("", "x*(4 - x - y/(1 + x))", "x*(4 - x - y/(1 + x + 0.001*y))", False),
    ("", MAGNETS, "0.5*sin(x - y + 6.283185307179586) + sin(x + 3.141592653589793)", True),
    ("", MAGNETS, "0.5*sin(1.0005*x - y) - sin(x)", True),
    ("", MAGNETS, "0.5*sin(x - y + 0.001) - sin(x)", False),
    ("", MAGNETS, "0.5*sin(x - y) - sin(x)*cos(0.01*y)", False),
    ("", MAGNETS, "0.5*sin(x - y) - sin(x) + 10*(sin(1.001*y) - sin(y))", False),
    ("", "cot(y)*cos(x)", "0.5*(cos(x + y) + cos(x - y))/sin(y)", True),
    ("", "cot(y)*cos(x)", "cos(x)*(1 + cos(2*y))/sin(2*y)", True),
    ("", "cot(y)*cos(x)", "cot(1.02*y)*cos(x)", False),
    ("", SHEAR, "0.55*sin(x) + 0.225*(sin(x + 2*y) + sin(x - 2*y))", True),
    ("", SHEAR, "(0.55 + 0.45*cos(2.05*y))*sin(x)", False),
    ("", "10*(y - (x**3/3 - x))", "10*(x + y) - x**5/(0.3*x**2)", True),
    ("", "-x/10", "-0.1*sqrt(1)*x", True),
    ("", "-x/10", "0.1*(y - x) - 0.1*y", True),
    ("", VOLTERRA, "0.25*((3 - 2*y)**2 - (2*x + 2*y - 3)**2)", True),
    ("", VOLTERRA, "3*x - 2*x*y - x**2 + 0.0001*y", False),
    ("", VOLTERRA, "x*(3 - 2*y - x)/(1 + 0.001*x)", False),
    ("", VOLTERRA, "3*x - 2*x*y - abs(x)**1.98", False),
]


def judge(model: str, truth: str, tolerance: float = 0.01, place: str = "") -> Form:
    generator = np.random.default_rng(3)
    data = {name: generator.uniform(*span, 400) for name, span in zip("xy", RANGES[place], strict=True)}
    return compare(model, truth, data, tolerance)


@pytest.mark.parametrize(("place", "truth", "text", "is_same"), CASES)
def test_rewritings_are_accepted_and_near_misses_refused(place, truth, text, is_same):
    verdict = judge(text, truth, place=place)
    assert verdict.is_right is is_same, verdict


def test_the_tolerance_is_that_of_each_coefficient():
    truth = "3*x - 2*x*y - x**2"
    verdict = judge("3*x - 2*x*y - 1.003*x**2", truth)
    assert verdict.is_right
    assert verdict.constants_error == pytest.approx(0.003)
    assert not judge("3*x - 2*x*y - 1.003*x**2", truth, tolerance=0.001).is_right


def test_units_do_not_matter():
    generator = np.random.default_rng(5)
    data = {"x": generator.uniform(1e-7, 8e-6, 300), "y": generator.uniform(1e5, 8e6, 300)}
    truth = "3*x - 2e-6*x*y - 1e6*x**2"
    assert compare("x*(3 - 2e-6*y - 1e6*x)", truth, data).is_right
    assert not compare("x*(3 - 2e-6*y - 1e6*x) + 1e-8", truth, data).is_right


@pytest.mark.parametrize(
    ("model", "truth", "is_same"),
    [
        ("exp(x + y)", "exp(x)*exp(y)", True),
        ("exp(-x)*y", "y/exp(x)", True),
        ("exp(2*x)", "exp(x)**2", True),
        ("2.718281828459045*exp(x)", "exp(x + 1)", True),
        ("exp(1.1*x)", "exp(x)", False),
        ("log(2*x*y)", "log(x*y + y*x)", True),
        ("log(x + y)", "log(x*y)", False),
        ("sqrt(x + y)", "(x + y)**0.5", True),
        ("sin(x/y)", "cos(x/y - 1.5707963267948966)", True),
        ("sin(x/(1 + y))", "sin(2*x/(2 + 2*y))", True),
        ("sin(x/(1 + y))", "sin(x/(2 + y))", False),
        ("sin(sin(x))", "sin(cos(x - 1.5707963267948966))", True),
        ("x**-2", "1/x**2", True),
        ("sin(3*x)", "3*sin(x) - 4*sin(x)**3", True),
        ("cos(0.5*x)**2", "(1 + cos(x))/2", True),
        ("sin(0.7*x)", "sin(0.7003*x)", True),
        ("tanh(0.7*x)", "tanh(0.7003*x)", True),
        ("tanh(0.7003*x) + 100*(tanh(0.7003*x) - tanh(0.7*x))", "tanh(0.7003*x)", False),
        ("tanh(0.8*x)", "tanh(0.7*x)", False),
        ("exp(-1.003*x)*y", "y*exp(-x)", True),
    ],
)
def test_other_functions_follow_their_rules(model, truth, is_same):
    generator = np.random.default_rng(7)
    data = {name: generator.uniform(0.5, 2.5, 300) for name in ("x", "y")}
    assert compare(model, truth, data).is_right is is_same


def test_an_approximation_that_is_good_on_the_data_is_not_the_form():
    data = {"x": np.linspace(-0.3, 0.3, 200)}
    series = "x - x**3/6 + x**5/120"
    verdict = compare(series, "sin(x)", data)
    assert verdict.function_error < 1e-6
    assert not verdict.is_right
    assert "approximates" in verdict.reason


@pytest.mark.parametrize(
    ("model", "truth"),
    [
        ("sin({c}*x)/{c}", "x"),
        ("tanh({c}*x)/{c}", "x"),
        ("(1 - cos({c}*x))*2/{c}**2", "x**2"),
        ("(exp({c}*x) + exp(-{c}*x) - 2)/{c}**2", "x**2"),
    ],
)
def test_no_angle_is_so_small_that_a_function_passes_for_a_power(model, truth):
    data = {"x": np.random.default_rng(3).uniform(-1.0, 1.0, 300)}
    for c in np.geomspace(1e-5, 1.0, 120).tolist():
        assert not compare(model.format(c=c), truth, data).is_right, c


@pytest.mark.parametrize(
    "model", ["1/(x - x)", "x/0", "(x + y + sin(x) + cos(y) + 1)**40", "log(-x*x)", "0", "1e300*x*1e300"]
)
def test_hopeless_models_are_refused_and_do_not_hang(model):
    assert not judge(model, "3*x - 2*x*y - x**2").is_right


def test_names_that_the_data_lack_are_refused():
    with pytest.raises(UsageError, match="'z'"):
        judge("x + z", "-x/10")


def test_a_constant_is_a_form_too():
    data = {"x": np.linspace(0.0, 1.0, 50)}
    assert compare("0.5", "0.5", data).is_right
    assert not compare("0.5 + x", "0.5", data).is_right
