"""Measured beside smoothed and simulated states, and what is left between them."""

from collections.abc import Iterable, Sequence
from typing import Final

from atoll.display.series import residuals
from atoll.report.chart import COLORS, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, figure, legend, number, paragraph, r2_cell, section, table
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Simulated, Smoothed

SHOWN: Final = COLORS
"""Trajectories that are drawn, each in a colour of its own."""
ROWS: Final = 60
"""Rows of the numbers behind a picture."""


def trajectories(findings: Findings) -> list[Element]:
    """Return the sections of the fit, of its residuals, and of the errors of the measurements."""
    parts = chosen(findings.trajectories)
    sections = []
    if parts:
        explained = _which(parts, findings)
        states = list(parts[0].values or {})
        fits = [_fit(state, parts, findings) for state in states]
        left = [_residuals(state, parts, findings) for state in states if parts[0].measured]
        sections.append(section("fit", "Measured and simulated", explained, _pictures(fits), _explained(findings)))
        sections.append(section("residuals", "What the model leaves", _left_text(), _pictures(left)))
    elif findings.trajectories:
        sections.append(section("fit", "Measured and simulated", paragraph("The model could not be simulated.")))
    if findings.result.noise:
        sections.append(_errors(findings))
    return sections


def chosen(parts: Sequence[Simulated]) -> list[Simulated]:
    """Return the simulated trajectories; of more than `SHOWN` some, from the worst explained to the best."""
    known = [part for part in parts if part.values]
    if len(known) <= SHOWN:
        return known
    known.sort(key=_least)
    return [known[index * (len(known) - 1) // (SHOWN - 1)] for index in range(SHOWN)]


def _least(part: Simulated) -> float:
    return min((value for value in part.r2.values() if value is not None), default=0.0)


def _pictures(figures: Iterable[Element]) -> Element:
    return element("div", *figures, class_="pictures")


def _which(parts: Sequence[Simulated], findings: Findings) -> Element:
    text = (
        "Dots are measured. Lines are simulated, each from one fitted initial state, with 95 % bands of the errors of "
        "constants and initial states."
    )
    if len(findings.trajectories) > len(parts):
        text += (
            f" {len(parts)} trajectories of {len(findings.trajectories)} are drawn, from the worst explained to the "
            "best."
        )
    return paragraph(text)


def _legend(parts: Sequence[Simulated]) -> Element:
    def name(part: Simulated) -> str:
        return f"trajectory {part.name}" + (", held out" if part.held_out else "")

    return legend((f"c{index}", name(part)) for index, part in enumerate(parts))


def _fit(state: str, parts: Sequence[Simulated], findings: Findings) -> Element:
    drawn = Chart(f"{state} over time, measured and simulated", findings.axis(findings.time), findings.axis(state))
    for index, part in enumerate(parts):
        if part.lower and part.upper:
            drawn.add_band(part.times, part.lower[state], part.upper[state], f"c{index}")
    for index, part in enumerate(parts):
        if part.measured:
            drawn.add_points(part.times, part.measured[state], f"c{index}")
        drawn.add_line(part.times, (part.values or {})[state], f"c{index}")
    heads = ["trajectory", findings.time, "measured", "simulated", "lower", "upper"]
    numbers = table(f"{state}, measured and simulated", heads, _rows(parts, state))
    return figure(drawn.svg(), findings.labelled(state), numbers, *((_legend(parts),) if len(parts) > 1 else ()))


def _rows(parts: Sequence[Simulated], state: str) -> Iterable[list[str]]:
    for part in parts:
        empty = (None,) * len(part.times)
        curves = (part.measured, part.values, part.lower, part.upper)
        columns = [(known or {}).get(state, empty) for known in curves]
        rows = list(zip(part.times, *columns, strict=True))
        for row in rows[:: max(1, len(parts) * len(rows) // ROWS)]:
            yield [part.name, *(number(value, 6) for value in row)]


def _explained(findings: Findings) -> Element:
    states = list(findings.trajectories[0].r2)
    rows = [
        [
            part.name + (" (held out)" if part.held_out else ""),
            *(r2_cell(part.r2.get(state)) for state in states),
            ", ".join(f"{name} = {number(value)}" for name, value in (part.start or {}).items()),
        ]
        for part in findings.trajectories
    ]
    return table("R² of each trajectory", ["trajectory", *states, "fitted initial state"], rows)


def _left_text() -> Element:
    return paragraph(
        "Measured less simulated values. Without a pattern, and as large as the errors of the measurements, they are "
        "what a right model leaves; lines mark twice the estimated error on either side."
    )


def _residuals(state: str, parts: Sequence[Simulated], findings: Findings) -> Element:
    drawn = Chart(f"residuals of {state} over time", findings.axis(findings.time), findings.axis(state))
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
    numbers = table(f"residuals of {state}", ["trajectory", findings.time, "residual"], rows)
    return figure(drawn.svg(), findings.labelled(state), numbers)


def _errors(findings: Findings) -> Element:
    heads = ["state", "error (sd)", "of the deviation", "smoothing", "rounded to", "rows left out", "outliers", "kind"]
    rows = [
        [
            findings.labelled(state),
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
    pictures = [_smoothing(state, smoothed, findings) for state in (smoothed[0].measured if smoothed else ())]
    return section(
        "errors",
        "Errors of the measurements",
        table("Errors found", heads, rows),
        *((paragraph("Dots are measured, lines smoothed; the search sees these."),) if pictures else ()),
        _pictures(pictures),
    )


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
    drawn = Chart(f"{state} measured and smoothed", findings.axis(findings.time), findings.axis(state))
    some = parts[:SHOWN]
    for index, part in enumerate(some):
        drawn.add_points(part.times, part.measured[state], f"c{index}")
        drawn.add_line(part.times, part.smoothed[state], f"c{index}")
    rows = [
        [part.name, number(time, 6), number(measured, 6), number(value, 6)]
        for part in some
        for time, measured, value in list(zip(part.times, part.measured[state], part.smoothed[state], strict=True))[
            :: max(1, len(some) * len(part.times) // ROWS)
        ]
    ]
    numbers = table(f"{state} smoothed", ["trajectory", findings.time, "measured", "smoothed"], rows)
    return figure(drawn.svg(), findings.labelled(state), numbers)
