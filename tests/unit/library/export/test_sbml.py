"""SBML is well formed, has all digits, and means what the model does; libsbml looks at it where it is installed."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Final

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.export.sbml import factors_of
from benchmarks.exports.readers import integrated
from tests.unit.library.export.exported import TIMES, decay, difference, everything

CORE: Final = "{http://www.sbml.org/sbml/level3/version2/core}"
MATH: Final = "{http://www.w3.org/1998/Math/MathML}"
FUNCTIONS: Final[dict[str, Callable[..., float]]] = {
    "plus": lambda a, b: a + b,
    "minus": lambda a, b=None: -a if b is None else a - b,
    "times": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "power": lambda a, b: a**b,
    "sin": math.sin,
    "cos": math.cos,
    "exp": math.exp,
    "ln": math.log,
    "root": math.sqrt,
    "abs": abs,
    "tanh": math.tanh,
    "lt": lambda a, b: float(a < b),
    "geq": lambda a, b: float(a >= b),
    "and": lambda a, b: float(bool(a) and bool(b)),
}


def value(node: ET.Element, names: dict[str, float]) -> float:
    """Return the value of MathML."""
    kind = node.tag.removeprefix(MATH)
    if kind == "ci":
        return names[str(node.text).strip()]
    if kind == "csymbol":
        return names["time"]
    if kind == "cn":
        exponent = "" if node.get("type") != "e-notation" else f"e{str(node[0].tail).strip()}"
        return float(str(node.text).strip() + exponent)
    if kind == "piecewise":
        pieces = [element for element in node if element.tag == f"{MATH}piece" and value(element[1], names)]
        assert len(pieces) < 2
        return value(pieces[0][0] if pieces else node[-1][0], names)
    name, *arguments = node
    return FUNCTIONS[name.tag.removeprefix(MATH)](*(value(argument, names) for argument in arguments))


def simulated(text: str) -> np.ndarray:
    """Return the states at `TIMES` of a document."""
    tree = ET.fromstring(text)
    numbers = {str(element.get("id")): float(element.get("value", "nan")) for element in tree.iter(f"{CORE}parameter")}
    rates = {str(element.get("variable")): element[0][0] for element in tree.iter(f"{CORE}rateRule")}
    inputs = {str(element.get("variable")): element[0][0] for element in tree.iter(f"{CORE}assignmentRule")}

    def slope(t: float, x: np.ndarray) -> list[float]:
        names = {**numbers, "time": t, **dict(zip(rates, x.tolist(), strict=True))}
        names |= {name: value(element, names) for name, element in inputs.items()}
        return [value(rate, names) for rate in rates.values()]

    return integrated(slope, np.array([numbers[name] for name in rates]), TIMES)


def test_rates_are_those_of_the_model() -> None:
    assert difference(simulated(everything().to_sbml()), everything()) < 1e-8


def test_tables_of_inputs_are_rules() -> None:
    u = {"u": np.array([0.0, 1.0, 4.0, 4.0, 3.0, 1.0, 0.0, 0.5, 0.5])}
    assert difference(simulated(decay().to_sbml(t=TIMES, u=u)), decay(), t=TIMES, u=u) < 1e-8


def test_constants_have_their_errors_in_notes() -> None:
    tree = ET.fromstring(decay().to_sbml())
    constant = next(element for element in tree.iter(f"{CORE}parameter") if element.get("id") == "c1")
    notes = "".join(constant.itertext())
    assert "standard error 0.1" in notes
    assert "95 % interval -0.5 to -0.09999999999999998" in notes


def with_units() -> Model:
    contents = decay().result.as_dict()
    contents["system"]["units"] = {"x": "mg/L", "t": "min"}
    contents["equations"][0]["constants"][0]["unit"] = "1/min"
    return Model(contents)


def test_units_of_the_si_are_defined() -> None:
    text = with_units().to_sbml()
    assert 'timeUnits="unit_1"' in text
    assert '<unit kind="second" exponent="1" scale="0" multiplier="60.0"/>' in text
    assert '<unit kind="second" exponent="-1" scale="0" multiplier="60.0"/>' in text
    assert "# 1/min, standard error 0.1" in with_units().to_python()


@pytest.mark.parametrize(
    ("text", "factors"),
    [
        ("m/s^2", (("metre", 1.0, 1.0), ("second", -2.0, 1.0))),
        ("kg m s**-1", (("gram", 1.0, 1000.0), ("metre", 1.0, 1.0), ("second", -1.0, 1.0))),
        ("mg/L", (("gram", 1.0, 1.0), ("metre", -3.0, 1.0))),
        ("1/h", (("second", -1.0, 3600.0),)),
        ("%", (("dimensionless", 1.0, 0.01),)),
        ("1", (("dimensionless", 1.0, 1.0),)),
        ("hares", ()),
        ("m/(", ()),
        ("", ()),
    ],
)
def test_units_are_products_of_powers_or_left(text: str, factors: tuple[tuple[str, float, float], ...]) -> None:
    assert factors_of(text) == factors


def test_libsbml_finds_no_error() -> None:
    libsbml = pytest.importorskip("libsbml")
    document = libsbml.readSBMLFromString(with_units().to_sbml())
    document.checkConsistency()
    errors = [document.getError(number) for number in range(document.getNumErrors())]
    assert not [error.getMessage() for error in errors if error.getSeverity() >= libsbml.LIBSBML_SEV_ERROR]
