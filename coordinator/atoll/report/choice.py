"""Why this equation: the front of each search, and the candidates that were compared."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Child, Element, element, figure, number, paragraph, r2_cell, section, table
from atoll_coordinator.result.equations import Equation, Member

if TYPE_CHECKING:
    from atoll.experiments.suggestion import Suggestions


def choice(its: Findings) -> list[Element]:
    """Return the sections of fronts and of candidates."""
    equations = its.result.equations
    fronts = [_front(one, its) for one in equations if any(member.normalized_error for member in one.front)]
    compared = [part for equation in equations for part in _candidates(equation, its)]
    sections = []
    if compared:
        text = paragraph(
            "In nats, how much longer the data are to describe by another equation than by the one shown: below "
            "about 3 the data hardly decide."
        )
        if its.result.groups or its.result.group is not None:
            compared.append(paragraph("Constants of candidates are of all groups of trajectories together."))
        following = () if its.suggestions is None else _next_experiment(its.suggestions)
        sections.append(section("candidates", "Candidates", text, *compared, *following))
    if fronts:
        text = paragraph(
            "The best expression of each complexity that the search found, by its error over the target's deviation. A "
            "ring marks the one that the equation is made of, if it comes from the front; the line is how uncertain "
            "the target itself is."
        )
        sections.append(section("front", "Accuracy and complexity", text, element("div", *fronts, class_="pictures")))
    return sections


def _next_experiment(found: "Suggestions") -> list[Element]:
    """Return the experiments that would tell most, and which systems they tell apart."""
    told_apart = found.purpose == "discrimination"
    text = f"Experiments that {'tell these apart' if told_apart else 'determine the constants'}, since {found.reason}."
    systems: list[list[Child]] = [
        [number(weight, 2), origin, element("code", "; ".join(map(" = ".join, equations.items())))]
        for each in found.candidates
        for weight, origin, equations in (
            (each.weight, each.origin, each.equations),
            (None, f"{each.origin}, with the constants of the result", each.written),
        )
        if equations
    ]
    rows: list[list[Child]] = [
        [
            element("span", ", ".join(f"{name} = {number(value)}" for name, value in where.items())),
            f"{len(each.times)}, from {number(each.times[0])} to {number(each.times[-1])}",
            number(each.information, 3),
            number(each.evidence, 3) if told_apart else "",
        ]
        for each in found.experiments
        for where in ({**each.initial, **each.inputs},)
    ]
    heads = ["begin at", "samples", "information, nats", "evidence for the right one, nats"]
    return [
        element("h3", "The next experiment"),
        paragraph(text),
        table("Systems, their constants fitted again", ["weight", "origin", "equations"], systems),
        table("Experiments", heads, rows),
    ]


def _front(equation: Equation, its: Findings) -> Element:
    members = [member for member in equation.front if member.normalized_error]
    drawn = Chart(f"error over complexity of {equation.lhs}", Axis("complexity"), Axis("error", is_logarithmic=True))
    sizes, errors = _places(members)
    if equation.derivative_floor:
        drawn.add_line((min(sizes), max(sizes)), (equation.derivative_floor,) * 2, "rule")
    drawn.add_line(sizes, errors, "c0")
    drawn.add_points(sizes, errors, "c0")
    drawn.add_points(*_places([member for member in members if member.selected]), "chosen c1")
    rows = [
        [str(member.complexity), number(member.normalized_error, 3), "yes" if member.selected else "",
         element("code", its.rounded(member.expression))]
        for member in equation.front
    ]  # fmt: skip
    numbers = table(f"front of {equation.lhs}", ["complexity", "error", "chosen", "expression"], rows)
    return figure(drawn.svg(), equation.lhs, numbers)


def _places(members: Sequence[Member]) -> tuple[list[float], list[float | None]]:
    """Return the complexities and the errors of members of a front."""
    return [member.complexity or 0 for member in members], [member.normalized_error for member in members]


def _candidates(equation: Equation, its: Findings) -> list[Element]:
    if not equation.candidates:
        return []
    rows: list[list[Child]] = [
        [
            element("code", its.rounded(candidate.expression)),
            "shown" if candidate.selected else number(candidate.nats, 3),
            r2_cell(candidate.r2),
            r2_cell(candidate.held_out_r2) + (" (left out in turn)" if candidate.cross_validated else ""),
            str(candidate.complexity),
            candidate.origin or "",
        ]
        for candidate in equation.candidates
    ]
    heads = ["expression", "nats", "R²", "held-out R²", "complexity", "origin"]
    return [table(f"Candidates of {equation.lhs}", heads, rows), *_decision(equation)]


def _decision(equation: Equation) -> list[Element]:
    """Return what would decide between the candidates, where that is known."""
    prediction = equation.prediction
    if prediction is None or not prediction.measure_from:
        return []
    start = ", ".join(f"{name} = {number(value)}" for name, value in prediction.measure_from.items())
    disputed = "The candidates foretell different courses from other initial states. " if prediction.is_disputed else ""
    return [paragraph(f"{disputed}A measurement that begins at {start} would tell most between them.")]
