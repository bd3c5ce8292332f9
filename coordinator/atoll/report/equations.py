"""Sections about the equations: verdicts, constants, candidates, fronts, searches, and how to repeat the run."""

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from atoll.display.curves import front
from atoll.display.notation import equation_mathml
from atoll.experiments.suggestion import equations_text
from atoll.model.equations import (
    GivenWords,
    constant_names,
    differing_groups,
    given_words,
    interval_text,
    r2_text,
    remark_on_groups,
    rounded,
    run_names,
    side_text,
)
from atoll.model.given_sides import searched_parts
from atoll.report.findings import MOST_PROFILES, Findings, count_constants
from atoll.report.markup import (
    COLORS,
    Axis,
    Chart,
    Child,
    Element,
    element,
    facts,
    figure,
    number,
    paragraph,
    parse_mathml,
    pictures,
    r2_cell,
    scrolling,
    section,
    table,
)
from atoll.text.conclusion import conclusion
from atoll.text.render import ENDS, checks_text, constants_line, given_lines, run_lines
from atoll_coordinator.result.equations import Check, Equation, Estimate, Observation, SimpleNumber
from atoll_coordinator.result.findings import Correlation
from atoll_core.redaction import without_secrets

if TYPE_CHECKING:
    from atoll.experiments.identifiability import Identifiability, ProfiledConstant
    from atoll.experiments.suggestion import Suggestions

MEANINGS: Final = {
    "exact": "this is the only equation that agrees with all digits of the data",
    "good": "within the measured range, predictions of this equation can be trusted",
    "doubtful": "another equation may be right, or a test was not possible; the reason says why",
    "no model": "no equation was found that describes the data",
}


def overview(findings: Findings) -> Element:
    """Return the section "Found": equations with verdicts, then data and options."""
    result = findings.result
    equations = [_equation(equation, findings) for equation in result.equations]
    warned = _list("Warnings", result.proper_warnings)
    noted = _list("Notes", result.notes)
    of_noise = "d[x]/dt is the variance that noise adds to the state x per unit of time." if result.process else ""
    remarks = map(paragraph, filter(None, [remark_on_groups(result), of_noise]))
    verdicts = dict.fromkeys(equation.verdict or "" for equation in result.equations)
    meanings = [f"{verdict.capitalize()}: {MEANINGS[verdict]}." for verdict in verdicts if verdict in MEANINGS]
    explained = paragraph(element("small", " ".join(meanings)))
    opening = paragraph(conclusion(result))
    equations += [_observation(one, findings) for one in result.observations]
    return section("found", "Found", opening, *equations, explained, *remarks, *warned, facts(_facts(findings)), *noted)


def _list(title: str, texts: Sequence[str]) -> list[Element]:
    return [element("h3", title), element("ul", *(element("li", text) for text in texts))] if texts else []


def _equation(equation: Equation, findings: Findings) -> Element:
    lhs, verdict = equation.lhs, equation.verdict
    if equation.expression is None:
        parts = [paragraph(f"{lhs}: no equation")]
    else:
        formula = equation_mathml(equation, findings.result.names)
        parts = [scrolling(f"equation {lhs}", parse_mathml(formula))]
    if equation.runs:
        values = [element("li", element("code", line)) for line in run_lines(equation)]
        parts = [paragraph(f"{equation.variable}, a parameter by run:"), element("ul", *values)]
    given = given_words(equation, findings.result.names)
    parts += _given(given)
    errors = constants_line(given.constants)
    if errors:
        parts.append(paragraph(errors[:1].upper() + errors[1:]))
    if verdict is not None:
        badge = element("strong", verdict, class_=f"verdict {verdict.replace(' ', '-')}")
        parts.append(paragraph(badge, f" {equation.reason or ''}"))
    if equation.checks:
        parts += _checks(equation.checks)
    return element("div", *parts, class_="equation")


def _observation(one: Observation, findings: Findings) -> Element:
    """Return a measured column that is computed from states, with its parameters."""
    names = findings.result.names
    formula = paragraph(element("code", f"{one.column} = {side_text(one, names)}"), " (measured)")
    return element("div", formula, *_given(given_words(one, names)), class_="equation")


def _given(given: GivenWords) -> list[Element]:
    """Return the side as the user wrote it, the values of its parameters, and its unknown parts.

    Nothing is returned for a side that was found.
    """
    if not given.text:
        return []
    text, *values = given_lines(given)
    lead, _, side = text.partition(": ")
    items = [element("li", element("code", value)) for value in values]
    return [paragraph(f"{lead.capitalize()}: ", element("code", side)), *([element("ul", *items)] if items else [])]


def _checks(checks: Sequence[Check]) -> list[Element]:
    text = checks_text(checks).partition(";")[0]
    listed = [check for check in checks if check.outcome in ("failed", "not made")]
    others = [check for check in checks if check.outcome not in ("failed", "not made")]
    parts = [paragraph(text[:1].upper() + text[1:] + ("." if not listed else ":"))]
    parts += [element("ul", *_items(listed))] if listed else []
    if others:
        parts.append(element("details", element("summary", "The other checks"), element("ul", *_items(others))))
    return parts


def _items(checks: Sequence[Check]) -> list[Element]:
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


def constants(findings: Findings) -> list[Element]:
    """Return the section "Constants"; empty if no equation has a constant."""
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
        profiles.append(
            paragraph("There are too many constants to draw profiles; run coordinator analyse --identifiability.")
        )
    listed = table("Constants", [*heads, "determined"], rows, is_stacked=True)
    return [section("constants", "Constants", listed, *_groups(findings, names), *notes, *profiles)]


def _groups(findings: Findings, names: Mapping[str, Sequence[str]]) -> list[Element]:
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
    return [table("Constants that differ between groups; the table above has their means", heads, rows)]


def _profiles(identifiability: "Identifiability") -> list[Element]:
    text = paragraph(
        "Each constant is fixed at several values while all other constants are fitted again. The data allow the "
        "values whose deviance is below the line."
    )
    listed = [element("li", f"{constant.name} = {constant.sentence}") for constant in identifiability.constants]
    listed += [element("li", direction.words) for direction in identifiability.sloppy]
    drawn = [_profile(constant, identifiability.quantile**2) for constant in identifiability.constants]
    return [element("h3", "Identifiability"), text, element("ul", *listed), pictures(drawn)]


def _profile(constant: "ProfiledConstant", most: float) -> Element:
    values, deviances = constant.values.tolist(), constant.deviances.tolist()
    drawn = Chart(f"profile of {constant.name}", Axis(constant.name), Axis("deviance", bounds=(0.0, 2.0 * most)))
    drawn.add_line([min(values), max(values)], [most, most], "rule")
    drawn.add_line(values, deviances, "c0")
    drawn.add_points([constant.estimate], [0.0], "c0")
    rows = [[number(value, 6), number(deviance)] for value, deviance in zip(values, deviances, strict=True)]
    return figure(drawn.svg(), constant.name, table(f"profile of {constant.name}", ["value", "deviance"], rows))


def _rows(equation: Equation, names: Sequence[str]) -> list[list[Child]]:
    known = zip(names, equation.constants, strict=True)
    is_given = equation.given is not None  # numbers of the user's text were not fitted
    listed: list[tuple[str, Estimate]] = [pair for pair in known if not is_given or pair[1].fitted is not None]
    listed += [(f"1 of {factor.of}", factor) for factor in equation.implied]
    if equation.runs:
        listed = [*zip(run_names(equation), equation.runs, strict=True)]
    return [
        [
            "" if equation.runs else equation.lhs,
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
    distance = f"{number(simple.standard_errors, 2)} standard errors away"
    return f"{number(simple.value, 6)}, odds {number(simple.odds, 2)}, {distance}"


def _together(equation: Equation, names: Sequence[str]) -> list[str]:
    """Return a sentence about simple numbers for several constants; empty if other numbers are more probable."""
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
    return f"{first} and {second} are strongly correlated: correlation {number(correlation.value, 3)}."


def choice(findings: Findings) -> list[Element]:
    """Return the sections of fronts and of candidates."""
    equations = findings.result.equations
    fronts = [_front(equation, findings) for equation in equations if front(equation.front)[0]]
    compared = [part for equation in equations for part in _candidates(equation, findings)]
    sections = []
    if compared:
        text = paragraph(
            "Δ description length: the description length with another equation minus the description length with the "
            "displayed equation, in nats. Below about 3 nats, the data hardly decide."
        )
        if findings.result.groups or findings.result.group is not None:
            compared.append(paragraph("Constants of candidates belong to all groups of trajectories together."))
        following = () if findings.suggestions is None else _next_experiment(findings.suggestions)
        sections.append(section("candidates", "Candidates", text, *compared, *following))
    if fronts:
        text = paragraph(
            "The best expression of each complexity in the search, with its error relative to the standard deviation "
            "of the target. A ring marks the displayed equation if it comes from the front. The line is the "
            "uncertainty of the target."
        )
        sections.append(section("front", "Accuracy and complexity", text, pictures(fronts)))
    return sections


def _next_experiment(suggestions: "Suggestions") -> list[Element]:
    is_discrimination = suggestions.purpose == "discrimination"
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
            experiment.certainty_text if is_discrimination else f"{number(experiment.information, 3)} nats",
            experiment.remark,
        ]
        for experiment in suggestions.experiments
    ]
    heads = ["initial state", "samples", "expected result" if is_discrimination else "about the constants", "warning"]
    if not any(experiment.remark for experiment in suggestions.experiments):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return [
        element("h3", "The next experiment"),
        paragraph(" ".join(filter(None, [f"Purpose: {suggestions.purpose_text}.", suggestions.verdict]))),
        table("Systems, with constants fitted again", ["weight", "origin", "equations"], systems),
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
    unknown = searched_parts(findings.result).get(equation.variable)
    name = f"{unknown} in {equation.lhs}" if unknown else equation.lhs
    numbers = table(f"front of {name}", ["complexity", "error", "chosen", "expression"], rows)
    return figure(drawn.svg(), name, numbers)


def _candidates(equation: Equation, findings: Findings) -> list[Element]:
    if not equation.candidates:
        return []
    rows: list[list[Child]] = [
        [
            element("code", rounded(candidate.expression, findings.result.names, is_given=equation.given is not None)),
            "shown" if candidate.selected else number(candidate.nats, 3),
            r2_cell(candidate.r2),
            r2_cell(candidate.held_out_r2) + (" (cross-validated)" if candidate.cross_validated else ""),
            str(candidate.complexity),
            candidate.origin or "",
        ]
        for candidate in equation.candidates
    ]
    heads = ["expression", "Δ description length", "R²", "held-out R²", "complexity", "origin"]
    return [table(f"Candidates of {equation.lhs}", heads, rows), *_decision(equation)]


def _decision(equation: Equation) -> list[Element]:
    prediction = equation.prediction
    if prediction is None or not prediction.measure_from:
        return []
    start = ", ".join(f"{name} = {number(value)}" for name, value in prediction.measure_from.items())
    disputed = (
        "The candidates predict different trajectories from other initial states. " if prediction.is_disputed else ""
    )
    return [paragraph(f"{disputed}A measurement from the initial state {start} would distinguish them best.")]


def search(findings: Findings) -> list[Element]:
    """Return the section "Search"."""
    equations = findings.result.equations
    rows = [
        [equation.lhs, ENDS.get(equation.why or "", equation.why or ""), str(equation.epoch),
         f"{equation.point_evaluations or 0:.3g}",
         number(equation.seconds, 3), equation.origin or ""]
        for equation in equations
    ]  # fmt: skip
    heads = ["equation", "the search ended because", "epochs", "point evaluations", "seconds", "shown comes from"]
    drawn = [_convergence(equation) for equation in equations if equation.convergence]
    text = paragraph(
        "The best error of each island over generations, relative to the standard deviation of the target."
    )
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


def origin(findings: Findings) -> Element:
    """Return the section "How to repeat this"."""
    result = findings.result
    entries: list[tuple[str, Child]] = [("Job", str(result.job)), ("Seed", str(result.seed))]
    if result.command:
        entries.append(("Command", element("code", without_secrets(result.command))))
    entries.append(("Digest of the search", element("code", result.digest or "")))
    if result.data is not None:
        entries.append(("Digest of the data (sha256)", element("code", result.data.digest or "")))
    if result.config:
        entries.append(("Settings", element("code", json.dumps(result.config, ensure_ascii=False))))
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    entries.append(("Versions", versions))
    promise = "The same data, settings and seed give the same digest on any number of workers and machines."
    by_clock = [equation for equation in result.equations if equation.why in ("max-time", "cancelled")]
    if by_clock:
        epochs = ",".join(f"{equation.variable}={equation.epoch}" for equation in by_clock)
        promise = (
            "A search was cancelled or reached its time limit, so another run may end at another epoch. The same data, "
            f"settings and seed with --max-epochs {epochs} instead of --max-time give the same digest on any number of "
            "workers and machines."
        )
    return section("origin", "How to repeat this", paragraph(promise), facts(entries))
