"""Which texts are units."""

import pytest

from atoll_coordinator.data.roles.columns import are_units


@pytest.mark.parametrize(
    "text",
    [
        "s",
        "m/s",
        "m s^-2",
        "m·s⁻²",
        "°C",
        "µg/mL",
        "1/min",
        "mol/(L h)",
        "kg*m**2",
        "%",
        "years",
        "W/m2",
        "hPa",
        "mg/dL",
    ],
)
def test_products_of_powers_of_known_symbols_are_units(text):
    assert are_units([text])


@pytest.mark.parametrize(
    "text", ["zero", "two", "1.5", "1e5", "x1", "", "t=0", "a rather long remark on a column", "north"]
)
def test_other_texts_are_none(text):
    assert not are_units([text])


def test_beside_a_known_unit_others_may_stand():
    assert are_units(["years", "pelts"])
    assert not are_units(["s", "1.5"])
