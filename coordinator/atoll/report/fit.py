"""Measured beside smoothed, simulated and fitted values, and the residuals."""

from collections.abc import Iterable, Sequence
from typing import Final

from atoll.display.curves import SHOWN
from atoll.display.series import residuals
from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, figure, legend, number, paragraph, pictures, r2_cell, section, table
from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Simulated, Smoothed

ROWS: Final = 60
"""Rows of the numbers behind a picture."""
_RESIDUALS: Final = (
    "Measured minus simulated values. Those of a right model have no pattern and are as large as the errors of the "
    "measurements; lines mark twice the estimated error on either side."
)


def trajectories(findings: Findings) -> list[Element]:
    """Return the sections of the fit, of its residuals, and of the errors of the measurements."""
    parts = [part for part, _ in findings.curves]
    sections = []
    if parts:
        states = list(parts[0].values or {})
        fits = pictures(_fit(state, findings) for state in states)
        left = pictures(_residuals(state, parts, findings) for state in states if parts[0].measured)
        sections.append(section("fit", "Measured and simulated", _which(findings), fits, _explanation(findings)))
        sections.append(section("residuals", "Residuals", paragraph(_RESIDUALS), left))
    elif findings.result.simulated:
        sections.append(section("fit", "Measured and simulated", paragraph("The model could not be simulated.")))
    if findings.result.noise:
        sections.append(_errors(findings))
    return sections


def fitted_values(findings: Findings) -> list[Element]:
    """Return the section, none of a model of dynamics: over the variable, of several fitted over measured values."""
    known = findings.result.regression
    if known is None:
        return []
    target, variables = str(findings.result.columns.target), known.variables
    fitted, measured = known.fitted, known.measured
    if len(variables) == 1:
        ((name, values),) = variables.items()
        fit = Chart(f"{target} over {name}", findings.axis(name), findings.axis(target))
        fit.add_points(values, measured, "c0")
        order = [row for _, row in sorted((value, row) for row, value in enumerate(values) if value is not None)]
        fit.add_line([values[row] for row in order], [fitted[row] for row in order], "c1")
    else:
        fit = Chart(f"{target} fitted over measured", Axis("measured"), Axis("fitted"))
        fit.add_points(measured, fitted, "c0")
        known_values = [value for value in measured if value is not None]
        ends = [min(known_values), max(known_values)] if known_values else []
        fit.add_line(ends, ends, "rule")
    left = Chart(f"residuals of {target} over its fitted values", Axis("fitted"), Axis("measured minus fitted"))
    left.add_points(fitted, residuals(measured, fitted), "c0")
    rows = list(zip(*variables.values(), measured, fitted, strict=True))
    some = [[number(value, 6) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]]
    numbers = table(f"{target}, measured and fitted", [*variables, "measured", "fitted"], some)
    drawn = [
        figure(fit.svg(), f"{target}: dots measured, line fitted", numbers),
        figure(left.svg(), "residuals", None),
    ]
    return [section("fit", "Measured and fitted", pictures(drawn))]


def _which(findings: Findings) -> Element:
    parts, curves = zip(*findings.curves, strict=True)
    text = f"Dots are measured. Lines are simulated by the model{_origin([each.pieces for each in curves])}"
    text += "." if not any(part.lower for part in parts) else (
        "; bands hold 95 % of the uncertainty that constants and initial states have."
    )  # fmt: skip
    if len(findings.result.simulated) > len(parts):
        drawn = f"{len(parts)} trajectories of {len(findings.result.simulated)} are drawn"
        text += f" {drawn}, from the worst explained to the best."
    return paragraph(text)


def _origin(pieces: Sequence[int | None]) -> str:
    """Return from what the trajectories are simulated; "" where that is not known of all."""
    known = [count for count in pieces if count is not None]
    if len(known) < len(pieces):
        return ""
    if max(known) == 1:
        return ", from one fitted initial state" if len(known) == 1 else ", each from one fitted initial state"
    return ", in pieces that each have a fitted initial state of their own"


def _fit(state: str, findings: Findings) -> Element:
    drawn, parts = findings.over_time(f"{state} over time, measured and simulated", state), findings.curves
    for index, (_, curves) in enumerate(parts):
        if curves.lower and curves.upper:
            drawn.add_band(curves.times, curves.lower[state], curves.upper[state], f"c{index}")
    for index, (part, curves) in enumerate(parts):
        if part.measured:
            drawn.add_points(part.times, part.measured[state], f"c{index}")
        drawn.add_line(curves.times, curves.values[state], f"c{index}")
    heads = ["trajectory", findings.result.time, "measured", "simulated", "lower", "upper"]
    listed = [(part.name, _curves(part, state)) for part, _ in parts]
    numbers = table(f"{state}, measured and simulated", heads, _some_rows(listed))
    names = [f"trajectory {part.name}" + (", held out" if part.held_out else "") for part, _ in parts]
    marks = [legend((f"c{index}", name) for index, name in enumerate(names))] if len(parts) > 1 else []
    return figure(drawn.svg(), findings.label(state), numbers, *marks)


def _curves(part: Simulated, state: str) -> list[Curve]:
    """Return times, measured and simulated values and bounds; of curves that are not there nothing but None."""
    curves = [(known or {}).get(state) for known in (part.measured, part.values, part.lower, part.upper)]
    return [part.times, *(curve or (None,) * len(part.times) for curve in curves)]


def _some_rows(curves: Sequence[tuple[str, Sequence[Curve]]]) -> Iterable[list[str]]:
    """Return some rows of the curves of each trajectory, behind its name."""
    for name, its in curves:
        rows = list(zip(*its, strict=True))
        for row in rows[:: max(1, len(curves) * len(rows) // ROWS)]:
            yield [name, *(number(value, 6) for value in row)]


def _explanation(findings: Findings) -> Element:
    states = list(findings.result.simulated[0].r2)
    rows = [
        [
            part.name + (" (held out)" if part.held_out else ""),
            *(r2_cell(part.r2.get(state)) for state in states),
            ", ".join(f"{name} = {number(value)}" for name, value in (part.start or {}).items()),
        ]
        for part in findings.result.simulated
    ]
    return table("R² of each trajectory", ["trajectory", *states, "fitted initial state"], rows)


def _residuals(state: str, parts: Sequence[Simulated], findings: Findings) -> Element:
    drawn = findings.over_time(f"residuals of {state} over time", state)
    left = [residuals(part.measured[state], (part.values or {})[state]) for part in parts]
    times = [time for part in parts for time in part.times if time is not None]
    noise = findings.result.noise.get(state)
    sd = None if noise is None else noise.error
    for level in (-2.0, 0.0, 2.0) if sd else (0.0,):
        drawn.add_line((min(times), max(times)), (level * (sd or 0.0),) * 2, "rule")
    for index, (part, values) in enumerate(zip(parts, left, strict=True)):
        drawn.add_points(part.times, values, f"c{index}")
    rows = [
        [part.name, number(time, 6), number(value)]
        for part, values in zip(parts, left, strict=True)
        for time, value in list(zip(part.times, values, strict=True))[:: max(1, len(times) // ROWS)]
    ]
    numbers = table(f"residuals of {state}", ["trajectory", findings.result.time, "residual"], rows)
    return figure(drawn.svg(), findings.label(state), numbers)


def _errors(findings: Findings) -> Element:
    heads = ["state", "error (sd)", "of the deviation", "smoothing", "rounded to", "rows left out", "outliers", "kind"]
    rows = [
        [
            findings.label(state),
            number(noise.error, 3),
            f"{100 * noise.relative:.3g} %" if noise.relative is not None else "",
            _method(noise),
            number(None if noise.quantisation is None else noise.quantisation.step),
            str(noise.doubtful_rows or 0),
            str(noise.outliers or 0),
            _kind(noise.errors or Errors()),
        ]
        for state, noise in findings.result.noise.items()
    ]
    smoothed = findings.result.smoothed
    drawn = [_smoothing(state, smoothed, findings) for state in (smoothed[0].measured if smoothed else ())]
    explained = [paragraph("Dots are measured, lines smoothed; the search sees these.")] if drawn else []
    found = table("Errors found", heads, rows)
    return section("errors", "Errors of the measurements", found, *explained, pictures(drawn))


def _method(noise: Noise) -> str:
    if noise.method == "interpolation":
        return "none, interpolated"
    return f"{noise.method}, {noise.span} rows, degree {noise.degree}"


def _kind(errors: Errors) -> str:
    descriptions = []
    if errors.proportional:
        descriptions.append(f"{100 * errors.proportional:.0f} % of the variance grows with the value squared")
    if errors.correlated:
        descriptions.append(f"{100 * errors.correlated:.0f} % goes together between rows")
    if errors.add_up:
        descriptions.append("adds up along trajectories, as errors of a solver do")
    return "; ".join(descriptions)


def _smoothing(state: str, parts: Sequence[Smoothed], findings: Findings) -> Element:
    drawn = findings.over_time(f"{state} measured and smoothed", state)
    some = parts[:SHOWN]
    for index, part in enumerate(some):
        drawn.add_points(part.times, part.measured[state], f"c{index}")
        drawn.add_line(part.times, part.smoothed[state], f"c{index}")
    rows = _some_rows([(part.name, (part.times, part.measured[state], part.smoothed[state])) for part in some])
    numbers = table(f"{state} smoothed", ["trajectory", findings.result.time, "measured", "smoothed"], rows)
    return figure(drawn.svg(), findings.label(state), numbers)
