"""Measured beside smoothed and simulated states, and what is left between them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from atoll.report.chart import COLORS, Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, figure, legend, number, paragraph, r2_cell, section, table

SHOWN: Final = COLORS
"""Trajectories that are drawn, each in a colour of its own."""
ROWS: Final = 60
"""Rows of the numbers behind a picture."""


def trajectories(its: Findings) -> list[Element]:
    """Return the sections of the fit, of its residuals, and of the errors of the measurements."""
    parts = chosen(its.trajectories)
    sections = []
    if parts:
        said = _which(parts, its)
        states = list(parts[0]["values"])
        fits = [_fit(state, parts, its) for state in states]
        left = [_residuals(state, parts, its) for state in states if parts[0].get("measured")]
        sections.append(section("fit", "Measured and simulated", said, _pictures(fits), _explained(its)))
        sections.append(section("residuals", "What the model leaves", _left_text(), _pictures(left)))
    elif its.trajectories:
        sections.append(section("fit", "Measured and simulated", paragraph("The model could not be simulated.")))
    if its.result.get("noise"):
        sections.append(_errors(its))
    return sections


def chosen(parts: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the simulated trajectories; of more than `SHOWN` some, from the worst explained to the best."""
    known = [each for each in parts if each.get("values")]
    if len(known) <= SHOWN:
        return known
    known.sort(key=_least)
    return [known[index * (len(known) - 1) // (SHOWN - 1)] for index in range(SHOWN)]


def _least(part: Mapping[str, Any]) -> float:
    return min((value for value in part["r2"].values() if value is not None), default=0.0)


def _pictures(figures: Iterable[Element]) -> Element:
    return element("div", *figures, class_="pictures")


def _which(parts: Sequence[Mapping[str, Any]], its: Findings) -> Element:
    text = (
        "Dots are measured. Lines are simulated, each from one fitted initial state, with 95 % bands of the errors of "
        "constants and initial states."
    )
    if len(its.trajectories) > len(parts):
        text += (
            f" {len(parts)} trajectories of {len(its.trajectories)} are drawn, from the worst explained to the best."
        )
    return paragraph(text)


def _legend(parts: Sequence[Mapping[str, Any]]) -> Element:
    def name(part: Mapping[str, Any]) -> str:
        return f"trajectory {part['name']}" + (", held out" if part.get("held_out") else "")

    return legend((f"c{index}", name(part)) for index, part in enumerate(parts))


def _fit(state: str, parts: Sequence[Mapping[str, Any]], its: Findings) -> Element:
    drawn = Chart(f"{state} over time, measured and simulated", Axis(its.labelled(its.time)), Axis(its.labelled(state)))
    for index, part in enumerate(parts):
        if part.get("lower"):
            drawn.add_band(part["times"], part["lower"][state], part["upper"][state], f"c{index}")
    for index, part in enumerate(parts):
        if part.get("measured"):
            drawn.add_points(part["times"], part["measured"][state], f"c{index}")
        drawn.add_line(part["times"], part["values"][state], f"c{index}")
    heads = ["trajectory", its.time, "measured", "simulated", "lower", "upper"]
    numbers = table(f"{state}, measured and simulated", heads, _rows(parts, state))
    return figure(drawn.svg(), its.labelled(state), numbers, *((_legend(parts),) if len(parts) > 1 else ()))


def _rows(parts: Sequence[Mapping[str, Any]], state: str) -> Iterable[list[str]]:
    for part in parts:
        empty = [None] * len(part["times"])
        columns = [(part.get(key) or {}).get(state, empty) for key in ("measured", "values", "lower", "upper")]
        rows = list(zip(part["times"], *columns, strict=True))
        for row in rows[:: max(1, len(parts) * len(rows) // ROWS)]:
            yield [str(part["name"]), *(number(value, 6) for value in row)]


def _explained(its: Findings) -> Element:
    states = list(its.trajectories[0]["r2"])
    rows = [
        [
            str(each["name"]) + (" (held out)" if each.get("held_out") else ""),
            *(r2_cell(each["r2"].get(state)) for state in states),
            ", ".join(f"{name} = {number(value)}" for name, value in (each.get("start") or {}).items()),
        ]
        for each in its.trajectories
    ]
    return table("R² of each trajectory", ["trajectory", *states, "fitted initial state"], rows)


def _left_text() -> Element:
    return paragraph(
        "Measured less simulated values. Without a pattern, and as large as the errors of the measurements, they are "
        "what a right model leaves; lines mark twice the estimated error on either side."
    )


def _residuals(state: str, parts: Sequence[Mapping[str, Any]], its: Findings) -> Element:
    drawn = Chart(f"residuals of {state} over time", Axis(its.labelled(its.time)), Axis(its.labelled(state)))
    lists = [_difference(part["measured"][state], part["values"][state]) for part in parts]
    times = [time for part in parts for time in part["times"]]
    sd = error_of(its.result.get("noise") or {}, state)
    for level in (-2.0, 0.0, 2.0) if sd else (0.0,):
        drawn.add_line((min(times), max(times)), (level * (sd or 0.0),) * 2, "rule")
    for index, (part, residuals) in enumerate(zip(parts, lists, strict=True)):
        drawn.add_points(part["times"], residuals, f"c{index}")
    rows = [
        [str(part["name"]), number(time, 6), number(value)]
        for part, residuals in zip(parts, lists, strict=True)
        for time, value in list(zip(part["times"], residuals, strict=True))[:: max(1, len(times) // ROWS)]
    ]
    numbers = table(f"residuals of {state}", ["trajectory", its.time, "residual"], rows)
    return figure(drawn.svg(), its.labelled(state), numbers)


def _difference(measured: Sequence[float | None], values: Sequence[float | None]) -> list[float | None]:
    pairs = zip(measured, values, strict=True)
    return [one - other if one is not None and other is not None else None for one, other in pairs]


def error_of(noise: Mapping[str, Any], state: str) -> float | None:
    """Return the standard deviation of errors of a state: what residuals of the model say, else the first estimate."""
    its = noise.get(state) or {}
    sd = (its.get("errors") or {}).get("sd", its.get("sd"))
    return float(sd) if sd is not None else None


def _errors(its: Findings) -> Element:
    noise = its.result["noise"]
    heads = ["state", "error (sd)", "of the deviation", "smoothing", "rounded to", "rows left out", "outliers", "kind"]
    rows = [
        [
            its.labelled(state),
            number(error_of(noise, state), 3),
            f"{100 * each['relative']:.3g} %" if each.get("relative") is not None else "",
            _method(each),
            number((each.get("quantisation") or {}).get("step")),
            str(each.get("doubtful_rows") or 0),
            str(each.get("outliers") or 0),
            _kind(each.get("errors") or {}),
        ]
        for state, each in noise.items()
    ]
    smoothed = (its.result.get("smoothing") or {}).get("trajectories") or []
    pictures = [_smoothing(state, smoothed, its) for state in (smoothed[0]["measured"] if smoothed else ())]
    return section(
        "errors",
        "Errors of the measurements",
        table("Errors found", heads, rows),
        *((paragraph("Dots are measured, lines smoothed; the search sees these."),) if pictures else ()),
        _pictures(pictures),
    )


def _method(each: Mapping[str, Any]) -> str:
    if each.get("method") == "interpolation":
        return "none, interpolated"
    return f"{each.get('method')}, {each.get('span')} rows, degree {each.get('degree')}"


def _kind(errors: Mapping[str, Any]) -> str:
    said = []
    if errors.get("proportional"):
        said.append(f"{100 * errors['proportional']:.0f} % of the variance grows with the value squared")
    if errors.get("correlated"):
        said.append(f"{100 * errors['correlated']:.0f} % goes together between rows")
    if errors.get("add_up"):
        said.append("adds up along trajectories, as errors of a solver do")
    return "; ".join(said)


def _smoothing(state: str, parts: Sequence[Mapping[str, Any]], its: Findings) -> Element:
    drawn = Chart(f"{state} measured and smoothed", Axis(its.labelled(its.time)), Axis(its.labelled(state)))
    some = parts[:SHOWN]
    for index, part in enumerate(some):
        drawn.add_points(part["times"], part["measured"][state], f"c{index}")
        drawn.add_line(part["times"], part["smoothed"][state], f"c{index}")
    rows = [
        [str(part["name"]), number(time, 6), number(measured, 6), number(value, 6)]
        for part in some
        for time, measured, value in list(
            zip(part["times"], part["measured"][state], part["smoothed"][state], strict=True)
        )[:: max(1, len(some) * len(part["times"]) // ROWS)]
    ]
    numbers = table(f"{state} smoothed", ["trajectory", its.time, "measured", "smoothed"], rows)
    return figure(drawn.svg(), its.labelled(state), numbers)
