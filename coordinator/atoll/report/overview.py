"""What was asked and what was found, in one screen."""

from collections.abc import Sequence
from typing import Final

from atoll.display.notation import equation_mathml
from atoll.model.groups import remark_on_groups
from atoll.model.parameters import r2_text
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, facts, number, paragraph, parse_mathml, scrolling, section
from atoll.text.conclusion import conclusion
from atoll.text.tables import checks_text, constants_line
from atoll_coordinator.result.equations import Check, Equation

MEANINGS: Final = {
    "exact": "the data single this equation out, to all of their digits",
    "good": "within the measured range, predictions of this equation can be trusted",
    "doubtful": "another equation may be the right one, or that was not tested; the reason says why",
    "no model": "nothing was found that describes the data",
}


def overview(findings: Findings) -> Element:
    """Return the section: equations with verdicts, then what was asked."""
    result = findings.result
    equations = [_equation(equation, findings) for equation in result.equations]
    warned = _list("Warnings", result.proper_warnings)
    noted = _list("Notes", result.notes)
    of_noise = "Of a state x, d[x]/dt is the variance that noise adds in a unit of time." if result.process else ""
    remarks = map(paragraph, filter(None, [remark_on_groups(result), of_noise]))
    verdicts = dict.fromkeys(equation.verdict or "" for equation in result.equations)
    meanings = [f"{verdict.capitalize()}: {MEANINGS[verdict]}." for verdict in verdicts if verdict in MEANINGS]
    explained = paragraph(element("small", " ".join(meanings)))
    opening = paragraph(conclusion(result))
    return section("found", "Found", opening, *equations, explained, *remarks, *warned, facts(_facts(findings)), *noted)


def _list(title: str, texts: Sequence[str]) -> list[Element]:
    """Return a list with its heading; nothing of no texts."""
    return [element("h3", title), element("ul", *(element("li", text) for text in texts))] if texts else []


def _equation(equation: Equation, findings: Findings) -> Element:
    lhs, verdict = equation.lhs, equation.verdict
    if equation.expression is None:
        parts = [paragraph(f"{lhs}: no equation")]
    else:
        formula = equation_mathml(lhs, equation.variable, equation.expression, findings.result.names)
        parts = [scrolling(f"equation {lhs}", parse_mathml(formula))]
    errors = constants_line(equation.constants)
    if errors:
        parts.append(paragraph(errors[:1].upper() + errors[1:]))
    if verdict is not None:
        badge = element("strong", verdict, class_=f"verdict {verdict.replace(' ', '-')}")
        parts.append(paragraph(badge, f" {equation.reason or ''}"))
    if equation.checks:
        parts += _checks(equation.checks)
    return element("div", *parts, class_="equation")


def _checks(checks: Sequence[Check]) -> list[Element]:
    """Return how many checks have passed, a list of those that have not, and the others behind it."""
    text = checks_text(checks).partition(";")[0]
    listed = [check for check in checks if check.outcome in ("failed", "not made")]
    others = [check for check in checks if check.outcome not in ("failed", "not made")]
    parts = [paragraph(text[:1].upper() + text[1:] + ("." if not listed else ":"))]
    parts += [element("ul", *_items(listed))] if listed else []
    if others:
        parts.append(element("details", element("summary", "The other checks"), element("ul", *_items(others))))
    return parts


def _items(checks: Sequence[Check]) -> list[Element]:
    """Return an item for each reason: checks that say the same stand together."""
    names: dict[tuple[str, str], list[str]] = {}
    for check in checks:
        names.setdefault((check.outcome, check.reason), []).append(check.name)
    return [
        element("li", element("b", f"{', '.join(named)}: {outcome}."), f" {reason}")
        for (outcome, reason), named in names.items()
    ]


def _facts(findings: Findings) -> list[tuple[str, str]]:
    result, system, data = findings.result, findings.result.columns, findings.result.data
    entries = [] if data is None else [("Data", f"{', '.join(data.files)}: {data.rows} rows")]
    if result.group is not None:
        entries.append(("Group", result.group))
    lists = (("States", system.states), ("Inputs", system.inputs))
    entries += [(name, ", ".join(map(findings.label, columns))) for name, columns in lists if columns]
    if system.target:
        entries.append(("Target", findings.label(system.target)))
    if system.time:
        entries.append(("Time", findings.label(system.time)))
    if system.ranges:
        ranges = (f"{name} {number(low)} to {number(high)}" for name, (low, high) in system.ranges.items())
        entries.append(("Range searched", ", ".join(ranges)))
    values = [value for part in result.simulated for value in part.r2.values() if value is not None]
    if values:
        on = f" on {len(result.simulated)} trajectories" if len(result.simulated) > 1 else ""
        entries.append(("Simulation", f"R² at least {r2_text(min(values))}{on}"))
    if result.state not in (None, "done"):
        entries.append(("Job", f"{result.state}: {result.reason or 'ended early'}"))
    return entries
