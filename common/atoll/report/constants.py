"""The constants with their errors, and which of them the data hardly tell apart."""

from collections.abc import Mapping
from typing import Any

from atoll.report.findings import Findings
from atoll.report.markup import Element, element, number, paragraph, section, table


def constants(its: Findings) -> list[Element]:
    """Return the section, none where no equation has a constant."""
    rows = [row for each in its.result["equations"] for row in _rows(each)]
    if not rows:
        return []
    heads = [
        "equation",
        "constant",
        "shown",
        "fitted",
        "standard error",
        "95 % interval",
        "simple number near it",
        "determined",
    ]
    notes = [paragraph(_correlation(each)) for each in its.result.get("correlations") or ()]
    return [section("constants", "Constants", table("Constants", heads, rows), *notes)]


def _rows(equation: Mapping[str, Any]) -> list[list[str | Element]]:
    listed = [(f"constant {index + 1}", each) for index, each in enumerate(equation.get("constants") or ())]
    listed += [(f"factor of {each['of']}", each) for each in equation.get("implied") or ()]
    return [
        [
            equation["lhs"],
            element("span", name),
            number(its["value"], 6),
            number(its["fitted"], 6),
            number(its["std_error"], 2),
            _interval(its),
            _simple(its.get("simple")),
            "yes" if its["identifiable"] else "not by these data",
        ]
        for name, its in listed
    ]


def _interval(its: Mapping[str, Any]) -> str:
    if not its.get("interval"):
        return ""
    low, high = its["interval"]
    return f"{number(low)} to {number(high)}"


def _simple(its: Mapping[str, Any] | None) -> str:
    if not its or its.get("odds") is None:
        return ""
    return f"{number(its['value'], 6)}, odds {number(its['odds'], 2)}, {number(its['standard_errors'], 2)} se off"


def _correlation(its: Mapping[str, Any]) -> str:
    names = [f"constant {its[key]['constant'] + 1} of {its[key]['variable']}" for key in ("first", "second")]
    return f"{names[0]} and {names[1]} are hardly told apart: correlation {number(its['value'], 3)}."
