"""Terms that equations have in common."""

import pytest

from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.model.result import shared_terms as made
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.expansion import shape_of, terms_of
from tests.unit.coordinator.model.parts import constant
from tests.unit.coordinator.model.result.plain import plainly

shared_terms = plainly(made.find_shared_terms)

NAMES = ("x", "y", "z")


def equation(text, error=1e-4):
    program = from_infix(text, NAMES)
    values = [value for code, _, _, value in program.nodes() if code == 1]
    return Refined(0, program, 0.0, 0.0, tuple(constant(value, value, error) for value in values))


def test_a_flux_is_in_both_equations_with_its_factors():
    terms = shared_terms(
        {"x": equation("2.5 - 7.3*x*y/(0.0731 + y*y)"), "y": equation("14.6*x*y/(0.0732 + y*y) - 6*z")}, NAMES
    )
    assert terms == [
        {"term": "x*y/(0.0731 + y**2)", "has_function": True, "factors": {"x": -7.3, "y": 14.6}, "multiples": None},
    ]


@pytest.mark.parametrize("inside", ["0.08", "-0.0731"])
def test_numbers_that_differ_inside_make_two_terms(inside):
    flux = equation(f"14.6*x*y/({inside} + y*y)")
    assert shared_terms({"x": equation("7.3*x*y/(0.0731 + y*y)"), "y": flux}, NAMES) == []


def test_products_are_terms_lone_variables_and_numbers_are_none():
    terms = shared_terms({"x": equation("3.0 - x*y - z"), "y": equation("3.0 + x*y - z"), "z": equation("z")}, NAMES)
    assert terms == [{"term": "x*y", "has_function": False, "factors": {"x": -1.0, "y": 1.0}, "multiples": None}]


def test_terms_that_were_fitted_together_have_their_multiples():
    equations = {"x": equation("3.0 - 0.5*x - x*y"), "y": equation("0.5*x - x*y")}
    ((monomial, _),) = terms_of(from_infix("0.5*x", NAMES))
    terms = shared_terms(equations, NAMES, ((shape_of(monomial), {"x": -1.0, "y": 1.0}),))
    assert [(term["term"], term["multiples"]) for term in terms] == [("x", {"x": -1.0, "y": 1.0}), ("x*y", None)]
