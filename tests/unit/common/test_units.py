"""Units as products of powers: read, written, and by those of the SI."""

import pytest

from atoll.errors import UsageError
from atoll.units import NO_UNIT, expanded, parse_unit


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("m/s^2", "m/s^2"),
        ("m s-1", "m/s"),
        ("mol/(L h)", "mol/(L h)"),
        ("km h⁻¹", "km/h"),
        ("m**0.5", "m^(1/2)"),
        ("s^(1/2)", "s^(1/2)"),
        ("cells/mL", "cells/mL"),
        ("m*m", "m^2"),
        ("m/m", "1"),
        ("1", "1"),
        ("-", "1"),
        ("rad", "1"),
    ],
)
def test_a_unit_is_a_product_of_powers(text, written):
    assert str(parse_unit(text)) == written


@pytest.mark.parametrize("text", ["m/", "m+", "(m", "3.7 m", "^2", "/", "m^^2", "m)", "m^x", "11 m", "m//s"])
def test_what_is_no_unit_is_one_sentence(text):
    with pytest.raises(UsageError, match="is no unit; write a product of powers") as caught:
        parse_unit(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("N", "kg m s^-2"),
        ("km/h", "1000 m/(3600 s)"),
        ("mol/L", "1000 mM"),
        ("µg/mL", "mg/L"),
        ("min", "60 s"),
        ("J", "W s"),
    ],
)
def test_equal_units_are_equal_in_those_of_the_si(one, other):
    assert expanded(parse_unit(one)) == expanded(parse_unit(other))


@pytest.mark.parametrize(("one", "other"), [("km", "m"), ("h", "s"), ("cells", "ind"), ("deg", "1"), ("mol/L", "g/L")])
def test_units_that_differ_by_a_factor_are_not_equal(one, other):
    assert expanded(parse_unit(one)) != expanded(parse_unit(other))


def test_pure_numbers_have_no_unit():
    assert parse_unit("m/m").is_none
    assert NO_UNIT.is_none
    assert not parse_unit("%").is_none, "a hundredth is a factor"
