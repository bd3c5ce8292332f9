"""The units of an equation: those of its constants, and terms that cannot be right."""

import pytest

from atoll_coordinator.dimensions import units_of, units_of_sides
from atoll_coordinator.units import parse_unit
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y", "u")
UNITS = {"x": parse_unit("m"), "y": parse_unit("m/s"), "u": parse_unit("N")}


def units(text, left="m/s", known=None):
    given = UNITS if known is None else {name: UNITS[name] for name in known}
    return units_of(from_infix(text, NAMES), NAMES, given, None if left is None else parse_unit(left))


@pytest.mark.parametrize(
    ("text", "constants"),
    [
        ("3*x - 2*x*y", ["1/s", "1/m"]),
        ("x*(3 - 2*y)", ["1/s", "1/m"]),
        ("2*x/(3 + x)", ["m/s", "m"]),
        ("4*exp(-0.5*x)", ["m/s", "1/m"]),
        ("2*sin(3*x + 1)", ["m/s", "1/m", "1"]),
        ("2*x**0.5", ["m^(1/2)/s", "1"]),
        ("3*u", ["m/(N s)"]),
    ],
)
def test_constants_have_the_units_that_make_each_term_right(text, constants):
    units_found = units(text)
    assert units_found.faults == ()
    assert sorted(map(str, units_found.constants)) == sorted(constants)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2*exp(x)", "the argument x of a function has the unit m instead of none"),
        ("2*sin(x + y)", "x has the unit m and y the unit m/s, but they are added"),
        ("2*log(x*y)", "the argument x*y of a function has the unit m^2/s instead of none"),
        ("3*x/(x + exp(y))", "the argument y of a function has the unit m/s instead of none"),
        ("2*x**y", "the exponent y has the unit m/s instead of none"),
    ],
)
def test_what_cannot_be_right_is_named_with_its_term(text, words):
    assert words in units(text).faults


def test_a_factor_of_one_that_is_not_written_has_a_unit_as_well():
    units_found = units("y - x*y")
    assert [(term, str(unit)) for term, unit in units_found.implied] == [("x*y", "1/m")]
    assert units_found.faults == ()
    assert units("y").implied == ()


def test_units_that_are_equal_but_for_their_names_agree():
    assert units("u", "kg m/s^2").implied == ()
    assert units("y", "km/h").implied != ()


def test_nothing_is_said_where_units_are_not_known():
    units_found = units("3*x - 2*u", known=("x",))
    assert [str(unit) if unit else None for unit in units_found.constants] == ["1/s", None]
    assert units("exp(u)", known=("x",)).faults == ()
    assert units("2*exp(x)", left=None).faults != ()


def units_together(**sides):
    names = (*NAMES, "k", "c", "q")
    programs = {name: from_infix(text, names) for name, text in sides.items()}
    lefts = {"x": parse_unit("m/s"), "y": parse_unit("m/s^2")}
    found, faults = units_of_sides(programs, names, UNITS, lefts)
    return {name: str(unit) for name, unit in found.items()}, faults


@pytest.mark.parametrize(
    ("sides", "expected"),
    [
        ({"x": "-k*x + q"}, {"k": "1/s", "q": "m/s"}),
        ({"x": "-2*x*k + q"}, {"q": "m/s"}),  # the number may have any unit
        ({"x": "k*x", "y": "k*c*x + q"}, {"k": "1/s", "c": "1/s", "q": "m/s^2"}),
        ({"y": "k*c*x", "x": "k*x"}, {"k": "1/s", "c": "1/s"}),
        ({"x": "k*q"}, {}),
        ({"x": "k*q", "y": "k*y"}, {"k": "1/s", "q": "m"}),
        ({"x": "y*exp(-q/k)", "y": "c - k*y"}, {"k": "1/s", "c": "m/s^2", "q": "1/s"}),
    ],
)
def test_units_of_parameters_and_unknown_parts_follow_from_all_equations(sides, expected):
    assert units_together(**sides) == (expected, {})


def test_an_equation_that_contradicts_an_earlier_one_is_named():
    found, faults = units_together(x="k*x", y="k*x + q")
    assert found["k"] == "1/s"
    assert list(faults) == ["y"]
    assert "instead of the unit m/s^2" in faults["y"][0]
