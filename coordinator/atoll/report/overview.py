"""What was asked and what was found, in one screen."""

from collections.abc import Mapping
from typing import Any, Final

from atoll.model.display import equation_mathml
from atoll.model.parameters import r2_text, remark_on_groups
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, facts, number, paragraph, parse_mathml, scrolling, section

MEANINGS: Final = {
    "exact": "the data single this equation out, to all of their digits",
    "good": "what this equation foretells can be relied on within what was measured",
    "doubtful": "another equation may be the right one; the reason says why",
    "no model": "nothing was found that describes the data",
}


def overview(its: Findings) -> Element:
    """Return the section: equations with verdicts, then what was asked."""
    found = its.result
    equations = [_equation(each, its) for each in found["equations"]]
    warnings = [element("li", text) for text in found.get("warnings") or ()]
    noted = (element("h3", "Warnings"), element("ul", *warnings)) if warnings else ()
    remark = remark_on_groups(found)
    said = [remark] if remark else []
    if found.get("process"):
        said.append("Of a state x, d[x]/dt is the variance that noise adds in a unit of time.")
    verdicts = dict.fromkeys(each["verdict"] for each in found["equations"] if each.get("verdict") is not None)
    meanings = element(
        "small", " ".join(f"{each.capitalize()}: {MEANINGS[each]}." for each in verdicts if each in MEANINGS)
    )
    said_of_all = [paragraph(meanings), *map(paragraph, said)]
    return section("found", "Found", *equations, *said_of_all, facts(_facts(its)), *noted)


def _equation(each: Mapping[str, Any], its: Findings) -> Element:
    verdict, reason = each.get("verdict"), each.get("reason")
    parts = []
    if each.get("expression") is not None:
        names = list(its.result["symbols"].values())
        formula = parse_mathml(equation_mathml(each["lhs"], each["variable"], each["expression"], names))
        parts.append(scrolling(f"equation {each['lhs']}", formula))
    else:
        parts.append(paragraph(f"{each['lhs']}: no equation"))
    if verdict is not None:
        badge = element("strong", verdict, class_=f"verdict {verdict.replace(' ', '-')}")
        parts.append(paragraph(badge, f" {reason or ''}"))
    return element("div", *parts, class_="equation")


def _facts(its: Findings) -> list[tuple[str, str]]:
    found, system = its.result, its.system
    data = found.get("data") or {}
    said = [("Data", f"{', '.join(data['files'])}: {data['rows']} rows")] if data else []
    if found.get("group") is not None:
        said.append(("Group", str(found["group"])))
    names = {"states": "States", "inputs": "Inputs"}
    said += [(names[key], ", ".join(map(its.labelled, system[key]))) for key in names if system.get(key)]
    if system.get("target"):
        said.append(("Target", its.labelled(system["target"])))
    if system.get("time"):
        said.append(("Time", its.labelled(system["time"])))
    if system.get("ranges"):
        ranges = (f"{name} {number(low)} to {number(high)}" for name, (low, high) in system["ranges"].items())
        said.append(("Range searched", ", ".join(ranges)))
    said += _simulation(its)
    if found.get("state") not in (None, "done"):
        said.append(("Job", f"{found['state']}: {found.get('reason') or 'ended early'}"))
    return said


def _simulation(its: Findings) -> list[tuple[str, str]]:
    values = [value for each in its.trajectories for value in (each.get("r2") or {}).values() if value is not None]
    if not values:
        return []
    on = f" on {len(its.trajectories)} trajectories" if len(its.trajectories) > 1 else ""
    return [("Simulation", f"R² at least {r2_text(min(values))}{on}")]
