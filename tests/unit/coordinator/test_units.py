"""Units as products of powers: read, written, and by those of the SI."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.export.sbml import factors_of
from atoll_coordinator.units import NO_UNIT, expanded, parse_unit
from atoll_core.errors import UsageError


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


BROKEN = ["m/", "m+", "(m", "3.7 m", "^2", "/", "m^^2", "m)", "m^x", "11 m", "m//s", "m^(1/0)", "m^(1/(0))", "0 m"]
LONG = ["(" * 3000 + "m", "m^" + "-" * 3000 + "1", "1" * 5000, "(" * 299]


@pytest.mark.parametrize("text", BROKEN + LONG)
def test_what_is_no_unit_is_one_sentence(text):
    with pytest.raises(UsageError, match="is no unit; write a product of powers") as caught:
        parse_unit(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


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


ALONE = ["pH", "ppm", "ppb", "psi", "ft", "mmHg", "dBm", "mph", "cells", "EUR", "°C", "au", "①", "½", "eV", "Hg", "dB"]


@pytest.mark.parametrize("word", ALONE)
def test_words_that_are_no_multiples_stand_for_themselves(word):
    assert expanded(parse_unit(word)) == {word: 1}


def test_acidity_is_no_inductance():
    assert expanded(parse_unit("nH/1000")) == expanded(parse_unit("H/1000000000000"))
    assert factors_of("pH") == ()
    assert factors_of("nH")


WORDS = ["**", "mol", "pH", "10", "1.5", "cells", "^(1/2)"]
PARTS = st.sampled_from([*"mskgHLh0123456789", *"^*/.·()+-− ⁻²³°%①½", *WORDS])


@pytest.mark.slow
@settings(max_examples=1000, deadline=None, derandomize=True, database=None)
@given(st.one_of(st.lists(PARTS, max_size=12).map("".join), st.text(max_size=20)))
def test_any_text_is_a_unit_or_refused_and_a_unit_is_read_as_it_is_written(text):
    try:
        unit = parse_unit(text)
    except UsageError:
        return
    assert expanded(parse_unit(str(unit))) == expanded(unit)
    factors_of(text)
