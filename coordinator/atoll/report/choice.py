"""Why this equation: the front of each search, and the candidates that were compared."""

from typing import TYPE_CHECKING

from atoll.display.series import front
from atoll.experiments.suggestion import equations_text
from atoll.model.equations import rounded
from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Child, Element, element, figure, number, paragraph, pictures, r2_cell, section, table
from atoll_coordinator.result.equations import Equation

if TYPE_CHECKING:
    from atoll.experiments.suggestion import Suggestions


def choice(findings: Findings) -> list[Element]:
    """Return the sections of fronts and of candidates."""
    equations = findings.result.equations
    fronts = [_front(equation, findings) for equation in equations if front(equation.front)[0]]
    compared = [part for equation in equations for part in _candidates(equation, findings)]
    sections = []
    if compared:
        text = paragraph(
            "Δ description length: how much longer the data are to describe with another equation than with the one "
            "shown, in nats. Below about 3 the data hardly decide."
        )
        if findings.result.groups or findings.result.group is not None:
            compared.append(paragraph("Constants of candidates are of all groups of trajectories together."))
        following = () if findings.suggestions is None else _next_experiment(findings.suggestions)
        sections.append(section("candidates", "Candidates", text, *compared, *following))
    if fronts:
        text = paragraph(
            "The best expression of each complexity that the search found, by its error over the target's deviation. A "
            "ring marks the one that the equation is made of, if it comes from the front; the line is how uncertain "
            "the target itself is."
        )
        sections.append(section("front", "Accuracy and complexity", text, pictures(fronts)))
    return sections


def _next_experiment(suggestions: "Suggestions") -> list[Element]:
    """Return the experiments that would tell most, and which systems they tell apart."""
    told_apart = suggestions.purpose == "discrimination"
    systems: list[list[Child]] = [
        [number(weight, 2), origin, element("code", equations_text(equations))]
        for candidate in suggestions.candidates
        for weight, origin, equations in (
            (candidate.weight, candidate.origin_text, candidate.equations),
            (None, f"{candidate.origin}, with the constants of the result", candidate.written),
        )
        if equations
    ]
    rows: list[list[Child]] = [
        [
            element("span", experiment.initial_text),
            experiment.samples_text,
            experiment.certainty_text if told_apart else f"{number(experiment.information, 3)} nats",
            experiment.remark,
        ]
        for experiment in suggestions.experiments
    ]
    heads = ["initial state", "samples", "what it tells" if told_apart else "about the constants", "warning"]
    if not any(experiment.remark for experiment in suggestions.experiments):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return [
        element("h3", "The next experiment"),
        paragraph(" ".join(filter(None, [f"Purpose: {suggestions.purpose_text}.", suggestions.verdict]))),
        table("Systems, their constants fitted again", ["weight", "origin", "equations"], systems),
        table("Experiments", heads, rows),
    ]


def _front(equation: Equation, findings: Findings) -> Element:
    drawn = Chart(f"error over complexity of {equation.lhs}", Axis("complexity"), Axis("error", is_logarithmic=True))
    sizes, errors = front(equation.front)
    if equation.derivative_floor:
        drawn.add_line((min(sizes), max(sizes)), (equation.derivative_floor,) * 2, "rule")
    drawn.add_line(sizes, errors, "c0")
    drawn.add_points(sizes, errors, "c0")
    drawn.add_points(*front(equation.front, is_selected=True), "chosen c1")
    rows = [
        [str(member.complexity), number(member.normalized_error, 3), "yes" if member.selected else "",
         element("code", rounded(member.expression, findings.result.names))]
        for member in equation.front
    ]  # fmt: skip
    numbers = table(f"front of {equation.lhs}", ["complexity", "error", "chosen", "expression"], rows)
    return figure(drawn.svg(), equation.lhs, numbers)


def _candidates(equation: Equation, findings: Findings) -> list[Element]:
    if not equation.candidates:
        return []
    rows: list[list[Child]] = [
        [
            element("code", rounded(candidate.expression, findings.result.names)),
            "shown" if candidate.selected else number(candidate.nats, 3),
            r2_cell(candidate.r2),
            r2_cell(candidate.held_out_r2) + (" (left out in turn)" if candidate.cross_validated else ""),
            str(candidate.complexity),
            candidate.origin or "",
        ]
        for candidate in equation.candidates
    ]
    heads = ["expression", "Δ description length", "R²", "held-out R²", "complexity", "origin"]
    return [table(f"Candidates of {equation.lhs}", heads, rows), *_decision(equation)]


def _decision(equation: Equation) -> list[Element]:
    """Return what would decide between the candidates, where that is known."""
    prediction = equation.prediction
    if prediction is None or not prediction.measure_from:
        return []
    start = ", ".join(f"{name} = {number(value)}" for name, value in prediction.measure_from.items())
    disputed = "The candidates predict different courses from other initial states. " if prediction.is_disputed else ""
    return [paragraph(f"{disputed}A measurement from the initial state {start} would tell most between them.")]
