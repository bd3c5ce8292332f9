"""How the islands converged, and what the search cost."""

from itertools import pairwise
from typing import Final

from atoll.report.chart import COLORS, Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, figure, number, paragraph, pictures, section, table
from atoll_coordinator.result.equations import Equation

ENDS: Final = {
    "target": "the target error was met",
    "law": "regression has found laws that leave noise alone",
    "stagnation": "no better equation was found for long",
    "max-epochs": "the last epoch was reached",
    "max-time": "the time was up",
    "cancelled": "it was cancelled",
    "known": "it was given",
}


def search(findings: Findings) -> list[Element]:
    """Return the section."""
    equations = findings.result.equations
    rows = [
        [equation.lhs, ENDS.get(equation.why or "", equation.why or ""), str(equation.epoch),
         f"{equation.point_evaluations or 0:.3g}",
         number(equation.seconds, 3), equation.origin or ""]
        for equation in equations
    ]  # fmt: skip
    heads = ["equation", "the search ended because", "epochs", "point evaluations", "seconds", "shown comes from"]
    drawn = [_convergence(equation) for equation in equations if equation.convergence]
    text = paragraph("The best error of each island over generations, relative to the target's deviation.")
    explained = [text] if drawn else []
    return [section("search", "Search", table("Searches", heads, rows), *explained, pictures(drawn))]


def _convergence(equation: Equation) -> Element:
    drawn = Chart(
        f"convergence of the islands of {equation.lhs}", Axis("generation"), Axis("error", is_logarithmic=True)
    )
    last = max(course.generations[-1] for course in equation.convergence)
    for course in equation.convergence:
        generations, errors = [*course.generations, last], [*course.errors, course.errors[-1]]
        x = [value for pair in pairwise(generations) for value in pair]
        y = [value for value in errors[:-1] for _ in range(2)]
        drawn.add_line(x, y, f"c{course.island % COLORS}")
    rows = [
        [str(course.island), str(course.generations[-1]), number(course.errors[-1], 3)]
        for course in equation.convergence
    ]
    numbers = table(f"islands of {equation.lhs}", ["island", "last improvement", "error"], rows)
    return figure(drawn.svg(), equation.lhs, numbers)
