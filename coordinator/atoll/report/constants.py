"""The constants with their errors, and which of them the data hardly tell apart."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from atoll.model.parameters import constant_names, differing_groups, interval_text
from atoll.report.chart import Axis, Chart
from atoll.report.findings import MOST_PROFILES, Findings, count_constants
from atoll.report.markup import Element, element, figure, number, paragraph, section, table

if TYPE_CHECKING:
    from atoll.experiments.determination import Identifiability, ProfiledConstant


def constants(its: Findings) -> list[Element]:
    """Return the section, none where no equation has a constant."""
    names = constant_names(its.result)
    rows = [row for each in its.result["equations"] for row in _rows(each, names[each["variable"]])]
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
    notes = [paragraph(text) for each in its.result["equations"] for text in _together(each, names[each["variable"]])]
    notes += [paragraph(_correlation(each, names)) for each in its.result.get("correlations") or ()]
    profiles = [] if its.identifiability is None else _profiles(its.identifiability)
    if count_constants(its.result) > MOST_PROFILES:
        profiles.append(paragraph("coordinator analyse --identifiability says what the data determine of so many."))
    return [
        section(
            "constants",
            "Constants",
            table("Constants", heads, rows, is_stacked=True),
            *_groups(its, names),
            *notes,
            *profiles,
        )
    ]


def _groups(its: Findings, names: Mapping[str, Sequence[str]]) -> list[Element]:
    """Return a table of the constants that differ between groups of trajectories, none where there are none."""
    if not differing_groups(its.result):
        return []
    heads = ["equation", "constant", "group", "value", "standard error", "95 % interval"]
    rows = [row for each in its.result["equations"] for row in _rows_of_groups(each, names[each["variable"]])]
    return [table("Constants that differ between groups; those above are means", heads, rows)]


def _rows_of_groups(equation: Mapping[str, Any], names: Sequence[str]) -> list[list[str | Element]]:
    return [
        [
            equation["lhs"],
            element("span", names[place]),
            element("span", str(group["group"])),
            number(its["value"], 6),
            number(its["std_error"], 2),
            interval_text(its["interval"]) if its.get("interval") else "",
        ]
        for place, mean in enumerate(equation.get("constants") or ())
        if not mean.get("shared")
        for group in equation.get("groups") or ()
        for its in group["constants"][place : place + 1]
    ]


def _profiles(found: "Identifiability") -> list[Element]:
    """Return what the data determine of each constant, by profile likelihood, with the profiles drawn."""
    text = paragraph(
        "A constant is held at each value of a range while all others are fitted again. Where the deviance stays below "
        "the line, the data allow the value."
    )
    listed = [element("li", f"{each.name} = {each.sentence}") for each in found.constants]
    listed += [element("li", each.words) for each in found.sloppy]
    pictures = [_profile(each, found.quantile**2) for each in found.constants]
    return [
        element("h3", "What the data determine"),
        text,
        element("ul", *listed),
        element("div", *pictures, class_="pictures"),
    ]


def _profile(its: "ProfiledConstant", most: float) -> Element:
    values, deviances = its.values.tolist(), its.deviances.tolist()
    drawn = Chart(f"profile of {its.name}", Axis(its.name), Axis("deviance", bounds=(0.0, 2.0 * most)))
    drawn.add_line([min(values), max(values)], [most, most], "rule")
    drawn.add_line(values, deviances, "c0")
    drawn.add_points([its.estimate], [0.0], "c0")
    rows = [[number(value, 6), number(deviance)] for value, deviance in zip(values, deviances, strict=True)]
    return figure(drawn.svg(), its.name, table(f"profile of {its.name}", ["value", "deviance"], rows))


def _rows(equation: Mapping[str, Any], names: Sequence[str]) -> list[list[str | Element]]:
    listed = [*zip(names, equation.get("constants") or (), strict=True)]
    listed += [(f"1 of {each['of']}", each) for each in equation.get("implied") or ()]
    return [
        [
            equation["lhs"],
            element("span", name),
            number(its["value"], 6),
            number(its["fitted"], 6),
            number(its["std_error"], 2),
            interval_text(its["interval"]) if its.get("interval") else "",
            _simple(its.get("simple")),
            "" if its["std_error"] is None else "yes" if its["identifiable"] else "not by these data",
        ]
        for name, its in listed
    ]


def _simple(its: Mapping[str, Any] | None) -> str:
    if not its or its.get("odds") is None:
        return ""
    return f"{number(its['value'], 6)}, odds {number(its['odds'], 2)}, {number(its['standard_errors'], 2)} se off"


def _together(equation: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Return a sentence on simple numbers of several constants together; nothing where others are likelier."""
    its = equation.get("simple_together")
    if not its or its.get("odds") is None:
        return []
    pairs = zip(its["constants"], its["values"], strict=True)
    simple = " and ".join(f"{names[place]} = {number(value, 6)}" for place, value in pairs)
    return [
        f"{simple}, judged together: odds {number(its['odds'], 2)} against all other numbers "
        f"(chi-square {number(its['chi_square'], 2)})."
    ]


def _correlation(its: Mapping[str, Any], names: Mapping[str, Sequence[str]]) -> str:
    first, second = (names[its[key]["variable"]][its[key]["constant"]] for key in ("first", "second"))
    return f"{first} and {second} are hardly told apart: correlation {number(its['value'], 3)}."
