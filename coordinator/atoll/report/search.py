"""How the islands converged, and what the search cost."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

from atoll.report.chart import COLORS, Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, figure, number, paragraph, section, table

ENDS: Final = {
    "target": "the target error was met",
    "law": "regression has found laws that leave noise alone",
    "stagnation": "no better equation was found for long",
    "max-epochs": "the last epoch was reached",
    "max-time": "the time was up",
    "cancelled": "it was cancelled",
    "known": "it was given",
}


def search(its: Findings) -> list[Element]:
    """Return the section."""
    equations = its.result["equations"]
    rows = [
        [each["lhs"], ENDS.get(each["why"], each["why"] or ""), str(each["epoch"]), f"{each['point_evaluations']:.3g}",
         number(each["seconds"], 3), each.get("origin") or ""]
        for each in equations
    ]  # fmt: skip
    heads = ["equation", "the search ended because", "epochs", "point evaluations", "seconds", "shown comes from"]
    pictures = [_convergence(each) for each in equations if each.get("convergence")]
    text = paragraph("The best error of each island over generations, relative to the target's deviation.")
    return [
        section(
            "search",
            "Search",
            table("Searches", heads, rows),
            *((text,) if pictures else ()),
            element("div", *pictures, class_="pictures"),
        )
    ]


def _convergence(equation: Mapping[str, Any]) -> Element:
    drawn = Chart(
        f"convergence of the islands of {equation['lhs']}", Axis("generation"), Axis("error", is_logarithmic=True)
    )
    last = max(each["generations"][-1] for each in equation["convergence"])
    for each in equation["convergence"]:
        generations, errors = [*each["generations"], last], [*each["errors"], each["errors"][-1]]
        x = [value for pair in pairwise(generations) for value in pair]
        y = [value for value in errors[:-1] for _ in range(2)]
        drawn.add_line(x, y, f"c{each['island'] % COLORS}")
    rows = [
        [str(each["island"]), str(each["generations"][-1]), number(each["errors"][-1], 3)]
        for each in equation["convergence"]
    ]
    numbers = table(f"islands of {equation['lhs']}", ["island", "last improvement", "error"], rows)
    return figure(drawn.svg(), equation["lhs"], numbers)
