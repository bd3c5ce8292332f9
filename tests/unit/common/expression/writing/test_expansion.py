"""Equations as sums of terms in which each constant has a meaning of its own."""

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.expansion import (
    expand_program,
    factored_forms,
    form_of,
    raised_quotients,
    shape_of,
    terms_of,
)

NAMES = ("x", "y")
POINTS = np.random.default_rng(3).uniform(0.5, 2.0, (2, 20))


@pytest.mark.parametrize(
    ("text", "expanded"),
    [
        ("x*(3 - 2*y)", "3.0*x - 2.0*x*y"),
        ("x*(1 - x)*(2 + y)", "2.0*x - 2.0*x*x + x*y - x**2*y"),
        ("x/(4 + 2*y) - y", "0.5*x/(2.0 + y) - y"),
        ("-2*x", "-2.0*x"),
        ("exp(-0.5*x)*3", "3.0*exp(-0.5*x)"),
    ],
)
def test_brackets_are_expanded_and_divisors_have_a_leading_one(text, expanded):
    program = from_infix(text, NAMES)
    expansion = expand_program(program)
    assert expansion is not None
    assert to_infix(expansion.program, NAMES) == expanded
    assert np.allclose(values_of(expansion.program, POINTS), values_of(program, POINTS), rtol=1e-12)
    assert len(expansion.roles) == int((expansion.program.operators == 1).sum())


def test_each_constant_has_its_sign_and_its_place():
    expanded = expand_program(from_infix("3*x - 2*x*y/(5 + y)", NAMES))
    assert [(role.sign, role.is_inner) for role in expanded.roles] == [(1.0, False), (-1.0, False), (1.0, True)]


def test_equal_constants_stay_apart():
    expanded = expand_program(from_infix("0.5*x + 0.5*y", NAMES))
    assert len(expanded.roles) == 2


def test_what_has_too_many_terms_is_not_expanded():
    assert expand_program(from_infix("(1 + x + y)**9", NAMES)) is None


def test_each_coefficient_is_a_factor_of_all_in_turn():
    program = from_infix("2*x - 0.5*x*x", NAMES)
    forms = list(factored_forms(program))
    assert [to_infix(form, NAMES) for form in forms] == ["2.0*(x - 0.25*x**2)", "-0.5*(x**2 - 4.0*x)"] or len(
        forms
    ) == 2
    assert all(np.allclose(values_of(form, POINTS), values_of(program, POINTS)) for form in forms)
    assert list(factored_forms(from_infix("3*x", NAMES))) == []


def test_a_quotient_is_raised_where_that_takes_no_new_term() -> None:
    names = ("x", "y")
    expanded = terms_of(from_infix("1.6*y/(0.8 + x) - 2.4*y", names))
    ((shape, raised),) = raised_quotients(expanded)
    ((flux, _),) = terms_of(from_infix("x*y/(0.8 + x)", names))
    assert shape == shape_of(flux)
    assert dict(raised)[flux] == pytest.approx(-2.0)
    assert sorted(factor for _, factor in raised) == pytest.approx([-2.0, -0.4])
    assert list(raised_quotients(terms_of(from_infix("1.6*y/(0.8 + x) - 2.4", names)))) == []


@pytest.mark.parametrize(
    ("one", "other", "are_same"),
    [
        ("0.1*y*(x - 4.02)", "0.1001*x*y - 0.4*y", True),
        ("-0.0033", "-0.0031", True),
        ("x/(4 + 2*y)", "3*x/(y + 7)", True),
        ("sin(2*x + 1)", "3*sin(0.5*x - 2)", True),
        ("y*(x - 4)", "y*(x - 4) + 1", False),
        ("x/(4 + 2*y)", "x/y", False),
        ("-1/x", "-1/y", False),
    ],
)
def test_a_form_knows_no_constants_and_no_brackets(one, other, are_same):
    assert (form_of(from_infix(one, NAMES)) == form_of(from_infix(other, NAMES))) is are_same
