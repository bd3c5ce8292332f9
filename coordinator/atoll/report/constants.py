"""The constants with their errors, and which of them the data hardly tell apart."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from atoll.model.groups import differing_groups
from atoll.model.parameters import constant_names, interval_text
from atoll.report.chart import Axis, Chart
from atoll.report.findings import MOST_PROFILES, Findings, count_constants
from atoll.report.markup import Child, Element, element, figure, number, paragraph, pictures, section, table
from atoll_coordinator.result.equations import Equation, Estimate, SimpleNumber
from atoll_coordinator.result.findings import Correlation

if TYPE_CHECKING:
    from atoll.experiments.determination import Identifiability, ProfiledConstant


def constants(findings: Findings) -> list[Element]:
    """Return the section, none where no equation has a constant."""
    names = constant_names(findings.result)
    rows = [row for equation in findings.result.equations for row in _rows(equation, names[equation.variable])]
    if not rows:
        return []
    heads = ["equation", "constant", "shown", "fitted", "standard error", "95 % interval", "simple number near it"]
    equations = findings.result.equations
    notes = [paragraph(text) for equation in equations for text in _together(equation, names[equation.variable])]
    notes += [paragraph(_correlation(pair, names)) for pair in findings.result.correlations]
    profiles = [] if findings.identifiability is None else _profiles(findings.identifiability)
    if count_constants(findings.result) > MOST_PROFILES:
        profiles.append(paragraph("coordinator analyse --identifiability says what the data determine of so many."))
    listed = table("Constants", [*heads, "determined"], rows, is_stacked=True)
    return [section("constants", "Constants", listed, *_groups(findings, names), *notes, *profiles)]


def _groups(findings: Findings, names: Mapping[str, Sequence[str]]) -> list[Element]:
    """Return a table of the constants that differ between groups of trajectories, none where there are none."""
    if not differing_groups(findings.result):
        return []
    heads = ["equation", "constant", "group", "value", "standard error", "95 % interval"]
    rows: list[list[Child]] = [
        [
            equation.lhs,
            element("span", names[equation.variable][place]),
            element("span", group.group),
            number(constant.value, 6),
            number(constant.std_error, 2),
            interval_text(constant.interval) if constant.interval else "",
        ]
        for equation in findings.result.equations
        for place, mean in enumerate(equation.constants)
        if not mean.shared
        for group in equation.groups
        for constant in group.constants[place : place + 1]
    ]
    return [table("Constants that differ between groups; those above are means", heads, rows)]


def _profiles(identifiability: "Identifiability") -> list[Element]:
    """Return what the data determine of each constant, by profile likelihood, with the profiles drawn."""
    text = paragraph(
        "A constant is held at each value of a range while all others are fitted again. Where the deviance stays below "
        "the line, the data allow the value."
    )
    listed = [element("li", f"{constant.name} = {constant.sentence}") for constant in identifiability.constants]
    listed += [element("li", direction.words) for direction in identifiability.sloppy]
    drawn = [_profile(constant, identifiability.quantile**2) for constant in identifiability.constants]
    return [element("h3", "What the data determine"), text, element("ul", *listed), pictures(drawn)]


def _profile(constant: "ProfiledConstant", most: float) -> Element:
    values, deviances = constant.values.tolist(), constant.deviances.tolist()
    drawn = Chart(f"profile of {constant.name}", Axis(constant.name), Axis("deviance", bounds=(0.0, 2.0 * most)))
    drawn.add_line([min(values), max(values)], [most, most], "rule")
    drawn.add_line(values, deviances, "c0")
    drawn.add_points([constant.estimate], [0.0], "c0")
    rows = [[number(value, 6), number(deviance)] for value, deviance in zip(values, deviances, strict=True)]
    return figure(drawn.svg(), constant.name, table(f"profile of {constant.name}", ["value", "deviance"], rows))


def _rows(equation: Equation, names: Sequence[str]) -> list[list[Child]]:
    listed: list[tuple[str, Estimate]] = [*zip(names, equation.constants, strict=True)]
    listed += [(f"1 of {factor.of}", factor) for factor in equation.implied]
    return [
        [
            equation.lhs,
            element("span", name),
            number(estimate.value, 6),
            number(estimate.fitted, 6),
            number(estimate.std_error, 2),
            interval_text(estimate.interval) if estimate.interval else "",
            _simple(estimate.simple),
            "" if estimate.std_error is None else "yes" if estimate.identifiable else "not by these data",
        ]
        for name, estimate in listed
    ]


def _simple(simple: SimpleNumber | None) -> str:
    if not simple or simple.odds is None:
        return ""
    return f"{number(simple.value, 6)}, odds {number(simple.odds, 2)}, {number(simple.standard_errors, 2)} se off"


def _together(equation: Equation, names: Sequence[str]) -> list[str]:
    """Return a sentence on simple numbers of several constants together; nothing where others are likelier."""
    together = equation.simple_together
    if not together or together.odds is None:
        return []
    pairs = zip(together.constants, together.values, strict=True)
    simple = " and ".join(f"{names[place]} = {number(value, 6)}" for place, value in pairs)
    return [
        f"{simple}, judged together: odds {number(together.odds, 2)} against all other numbers "
        f"(chi-square {number(together.chi_square, 2)})."
    ]


def _correlation(correlation: Correlation, names: Mapping[str, Sequence[str]]) -> str:
    places = (correlation.first, correlation.second)
    first, second = (names[place.variable][place.constant or 0] for place in places)
    return f"{first} and {second} are hardly told apart: correlation {number(correlation.value, 3)}."
