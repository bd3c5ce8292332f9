"""Sections about trajectories: measurements with simulations and residuals, stochastic processes, dynamics."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.analysis import TextTable, describe
from atoll.display.curves import SHOWN, residuals
from atoll.model.equations import differing_groups
from atoll.report.findings import Findings
from atoll.report.markup import (
    COLORS,
    Axis,
    Chart,
    Element,
    facts,
    figure,
    legend,
    number,
    paragraph,
    pictures,
    r2_cell,
    section,
    table,
)
from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.findings import Density, Errors, Noise, PathEnsemble
from atoll_coordinator.result.listed_trajectories import Simulated, Smoothed

if TYPE_CHECKING:
    from atoll.analysis.analysis import Analysis

ROWS: Final = 60
"""Largest number of rows in the table of a picture, approximately."""
_RESIDUALS: Final = (
    "Measured minus simulated values. The residuals of a correct model have no pattern and are as large as the "
    "measurement errors. Lines mark plus and minus twice the estimated error."
)


def trajectories(findings: Findings) -> list[Element]:
    """Return the sections about the fit, its residuals, and the errors of the measurements."""
    parts = [part for part, _ in findings.curves]
    sections = []
    if parts:
        states = [state for state in parts[0].values or {} if state not in findings.result.by_run]
        fits = pictures(_fit(state, findings) for state in states)
        residual_figures = pictures(
            _residuals(state, parts, findings) for state in states if state in parts[0].measured
        )
        sections.append(section("fit", "Measured and simulated", _which(findings), fits, _explanation(findings)))
        sections.append(section("residuals", "Residuals", paragraph(_RESIDUALS), residual_figures))
    elif findings.result.simulated:
        sections.append(section("fit", "Measured and simulated", paragraph("The model could not be simulated.")))
    if findings.result.noise:
        sections.append(_errors(findings))
    return sections


def fitted_values(findings: Findings) -> list[Element]:
    """Return the section about a regression: a plot over its variable; for several variables, fitted over measured
    values."""
    known = findings.result.regression
    if known is None:
        return []
    target, variables = str(findings.result.columns.target), known.variables
    fitted, measured = known.fitted, known.measured
    if len(variables) == 1:
        ((name, values),) = variables.items()
        fit = Chart(f"{target} over {name}", Axis(findings.label(name)), Axis(findings.label(target)))
        fit.add_points(values, measured, "c0")
        order = [row for _, row in sorted((value, row) for row, value in enumerate(values) if value is not None)]
        fit.add_line([values[row] for row in order], [fitted[row] for row in order], "c1")
    else:
        fit = Chart(f"{target} fitted over measured", Axis("measured"), Axis("fitted"))
        fit.add_points(measured, fitted, "c0")
        known_values = [value for value in measured if value is not None]
        ends = [min(known_values), max(known_values)] if known_values else []
        fit.add_line(ends, ends, "rule")
    over_fitted = Chart(f"residuals of {target} over its fitted values", Axis("fitted"), Axis("measured minus fitted"))
    over_fitted.add_points(fitted, residuals(measured, fitted), "c0")
    rows = list(zip(*variables.values(), measured, fitted, strict=True))
    some = [[number(value, 6) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]]
    numbers = table(f"{target}, measured and fitted", [*variables, "measured", "fitted"], some)
    drawn = [
        figure(fit.svg(), f"{target}: dots measured, line fitted", numbers),
        figure(over_fitted.svg(), "residuals", None),
    ]
    return [section("fit", "Measured and fitted", pictures(drawn))]


def _which(findings: Findings) -> Element:
    parts, curves = zip(*findings.curves, strict=True)
    text = f"Dots are measured. Lines are simulated by the model{_origin([each.pieces for each in curves])}."
    if any(part.lower for part in parts):
        text += " The 95 % bands contain the uncertainty of constants and initial states."
    if len(findings.result.simulated) > len(parts):
        drawn = f"{len(parts)} of {len(findings.result.simulated)} trajectories are drawn"
        text += f" {drawn}, from the worst to the best fit."
    return paragraph(text)


def _origin(pieces: Sequence[int | None]) -> str:
    """Return a phrase about the initial states of the simulations; "" if they are not known for all simulations."""
    known = [count for count in pieces if count is not None]
    if len(known) < len(pieces):
        return ""
    if max(known) == 1:
        return ", from one fitted initial state" if len(known) == 1 else ", each from one fitted initial state"
    return ", in pieces with separate fitted initial states"


def _fit(state: str, findings: Findings) -> Element:
    drawn, parts = findings.over_time(f"{state} over time, measured and simulated", state), findings.curves
    for index, (_, curves) in enumerate(parts):
        if curves.lower and curves.upper:
            drawn.add_band(curves.times, curves.lower[state], curves.upper[state], f"c{index}")
    for index, (part, curves) in enumerate(parts):
        if state in part.measured:
            drawn.add_points(part.times, part.measured[state], f"c{index}")
        drawn.add_line(curves.times, curves.values[state], f"c{index}")
    heads = ["trajectory", findings.result.time, "measured", "simulated", "lower", "upper"]
    listed = [(part.name, _curves(part, state)) for part, _ in parts]
    numbers = table(f"{state}, measured and simulated", heads, _some_rows(listed))
    names = [f"trajectory {part.name}" + (", held out" if part.held_out else "") for part, _ in parts]
    marks = [legend((f"c{index}", name) for index, name in enumerate(names))] if len(parts) > 1 else []
    hidden = " (hidden: it has no measured values)" if state in findings.result.unmeasured else ""
    return figure(drawn.svg(), findings.label(state) + hidden, numbers, *marks)


def _curves(part: Simulated, state: str) -> list[Curve]:
    """Return times, measured and simulated values and bounds; missing curves have None at all times."""
    curves = [(known or {}).get(state) for known in (part.measured, part.values, part.lower, part.upper)]
    return [part.times, *(curve or (None,) * len(part.times) for curve in curves)]


def _some_rows(curves: Sequence[tuple[str, Sequence[Curve]]]) -> Iterable[list[str]]:
    for name, columns in curves:
        rows = list(zip(*columns, strict=True))
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
    differences = [residuals(part.measured[state], (part.values or {})[state]) for part in parts]
    times = [time for part in parts for time in part.times if time is not None]
    noise = findings.result.noise.get(state)
    sd = None if noise is None else noise.error
    for level in (-2.0, 0.0, 2.0) if sd else (0.0,):
        drawn.add_line((min(times), max(times)), (level * (sd or 0.0),) * 2, "rule")
    for index, (part, values) in enumerate(zip(parts, differences, strict=True)):
        drawn.add_points(part.times, values, f"c{index}")
    rows = [
        [part.name, number(time, 6), number(value)]
        for part, values in zip(parts, differences, strict=True)
        for time, value in list(zip(part.times, values, strict=True))[:: max(1, len(times) // ROWS)]
    ]
    numbers = table(f"residuals of {state}", ["trajectory", findings.result.time, "residual"], rows)
    return figure(drawn.svg(), findings.label(state), numbers)


def _errors(findings: Findings) -> Element:
    heads = ["state", "error (sd)", "relative", "smoothing", "rounded to", "rows left out", "outliers", "kind"]
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
        if state not in findings.result.unmeasured
    ]
    smoothed = findings.result.smoothed
    measured = [name for name in (smoothed[0].measured if smoothed else ()) if name not in findings.result.unmeasured]
    drawn = [_smoothing(state, smoothed, findings) for state in measured]
    explained = (
        [paragraph("Dots are measured, lines are smoothed. The search uses the smoothed values.")] if drawn else []
    )
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
        descriptions.append(f"{100 * errors.correlated:.0f} % of the variance is correlated between rows")
    if errors.add_up:
        descriptions.append("errors accumulate along trajectories, like integration errors of a solver")
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


def process(findings: Findings) -> list[Element]:
    """Return the section about a stochastic process; empty without one."""
    fitted = findings.result.process
    if fitted is None:
        return []
    entries = [
        ("Time steps", f"{fitted.steps}, median {number(fitted.step)}"),
        ("Log-likelihood of a step", f"{number(fitted.log_likelihood)} nats"),
    ]
    ensemble, densities = fitted.ensemble, fitted.stationary or {}
    drawn = [] if ensemble is None else [_ensemble(ensemble, state, findings) for state in ensemble.mean]
    drawn += [_density(density, state, findings) for state, density in densities.items()]
    explained = paragraph(
        "Mean of the simulated paths, with the 5 % and 95 % quantiles; stationary densities, simulated and measured."
    )
    return [section("process", "Noise as part of the law", facts(entries), explained, pictures(drawn))]


def _ensemble(ensemble: PathEnsemble, state: str, findings: Findings) -> Element:
    drawn = findings.over_time(f"simulated paths of {state}", state)
    drawn.add_band(ensemble.times, ensemble.lower[state], ensemble.upper[state], "c0")
    drawn.add_line(ensemble.times, ensemble.mean[state], "c0")
    curves = (ensemble.mean, ensemble.lower, ensemble.upper)
    rows = list(zip(ensemble.times, *(curve[state] for curve in curves), strict=True))
    some = [[number(value, 5) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]]
    numbers = table(f"simulated paths of {state}", [findings.result.time, "mean", "5 %", "95 %"], some)
    return figure(drawn.svg(), f"{findings.label(state)}, {ensemble.finite_paths} paths", numbers)


def _density(density: Density, state: str, findings: Findings) -> Element:
    drawn = Chart(f"stationary density of {state}", Axis(findings.label(state)), Axis("density"))
    middles = [0.5 * ((low or 0.0) + (high or 0.0)) for low, high in pairwise(density.edges)]
    drawn.add_points(middles, density.measured, "c1")
    drawn.add_line(middles, density.density, "c0")
    curves = zip(middles, density.density, density.measured, strict=True)
    rows = [[number(value) for value in row] for row in curves]
    numbers = table(f"stationary density of {state}", [state, "simulated", "measured"], rows)
    overlap = f"; they overlap by {100 * density.overlap:.0f} %" if density.overlap is not None else ""
    return figure(drawn.svg(), f"{findings.label(state)}: line simulated, dots measured{overlap}", numbers)


def dynamics(findings: Findings) -> list[Element]:
    """Return the section about the dynamics of a model; empty for a regression."""
    if findings.model is not None and findings.model.is_regression:
        return []
    analysis = findings.analysis
    if analysis is None:
        groups = ", ".join(differing_groups(findings.result))
        with_groups = f"Constants differ between the groups {groups}; analyse one with coordinator report --group NAME."
        why = with_groups if groups else f"The model is not analysed: {findings.unanalysed}."
        return [section("dynamics", "Dynamics", paragraph(why))]
    parts = [_part(part) for part in describe(analysis)]
    if analysis.nullclines:
        parts.insert(1 if analysis.caveat else 0, pictures([_phase_plane(findings, analysis)]))
    bounded = paragraph("The search has a limited effort: it may have missed fixed points and cycles.")
    return [section("dynamics", "Dynamics", *parts, bounded)]


def _part(part: str | TextTable) -> Element:
    text = part.title if isinstance(part, TextTable) else part
    text = text[:1].upper() + text[1:]
    if isinstance(part, TextTable) and part.rows:
        return table(text, part.heads, [row.cells for row in part.rows])
    return paragraph(text if text.endswith(".") else f"{text}.")


def _phase_plane(findings: Findings, analysis: "Analysis") -> Element:
    first, second = analysis.field.states
    bounds = list(zip(analysis.box.lower.tolist(), analysis.box.upper.tolist(), strict=True))
    drawn = Chart(
        f"phase plane of {first} and {second} with nullclines and fixed points",
        Axis(first, bounds=bounds[0]),
        Axis(second, bounds=bounds[1]),
    )
    _add_basins(drawn, analysis)
    _add_arrows(drawn, analysis)
    for state, lines in enumerate(analysis.nullclines):
        for line in lines:
            drawn.add_line(line[:, 0].tolist(), line[:, 1].tolist(), f"nullcline n{state}")
    _add_trajectories(drawn, findings)
    for cycle in analysis.cycles.cycles:
        closed = np.vstack([cycle.points, cycle.points[:1]])
        drawn.add_line(closed[:, 0].tolist(), closed[:, 1].tolist(), "cycle" if cycle.is_stable else "cycle unstable")
    for point in analysis.fixed_points.points:
        drawn.add_points([point.point[0]], [point.point[1]], "fixed stable" if point.is_stable else "fixed unstable")
    marks = [
        ("line n0", f"d{first}/d{findings.result.time} = 0"),
        ("line n1", f"d{second}/d{findings.result.time} = 0"),
        ("dot fixed stable", "stable fixed point"),
        ("dot fixed unstable", "other fixed point"),
    ]
    if analysis.cycles.cycles:
        marks.append(("line cycle", "limit cycle"))
    marks += [(f"line c{index}", f"trajectory {part.name}") for index, (part, _) in enumerate(findings.curves)]
    return figure(
        drawn.svg(),
        "Phase plane" + ("; colours show the reached attractor" if len(analysis.basins.attractors) > 1 else ""),
        None,
        legend(marks),
    )


def _add_basins(drawn: Chart, analysis: "Analysis") -> None:
    """Add the cells of each basin; neighbouring cells in a column are one rectangle."""
    grid = analysis.basins.grid
    if grid is None or len(analysis.basins.attractors) < 2:
        return
    reached = analysis.basins.reached.reshape(grid, grid)
    (left, bottom), (width, height) = analysis.box.lower, analysis.box.widths / grid
    for which in range(len(analysis.basins.attractors)):
        corners = [
            (left + width * (column + side), bottom + height * end)
            for column in range(grid)
            for begin, finish in _runs(reached[column] == which)
            for side, end in ((0, begin), (1, finish))
        ]
        if corners:
            x, y = zip(*corners, strict=True)
            drawn.add_cells(x, y, f"basin c{which % COLORS}")


def _runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _add_arrows(drawn: Chart, analysis: "Analysis") -> None:
    cells = 14
    places = [
        low + (np.arange(cells) + 0.5) * width / cells
        for low, width in zip(analysis.box.lower, analysis.box.widths, strict=True)
    ]
    points = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 2)
    rates = analysis.field.values(points, np.tile(analysis.inputs, (len(points), 1)) if len(analysis.inputs) else None)
    scaled = rates / analysis.box.widths
    lengths = np.hypot(scaled[:, 0], scaled[:, 1])[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = 0.6 / cells * scaled / lengths * analysis.box.widths
    ends = points + steps
    x, y = ([value for row in zip(points[:, axis].tolist(), ends[:, axis].tolist(), strict=True)
             for value in (*row, None)] for axis in range(2))  # fmt: skip
    drawn.add_line(x, y, "flow")


def _add_trajectories(drawn: Chart, findings: Findings) -> None:
    columns = findings.result.columns.states
    if len(columns) != 2:
        return
    first, second = columns
    for index, (part, curves) in enumerate(findings.curves):
        if part.measured:
            drawn.add_points(part.measured[first], part.measured[second], f"small c{index}")
        drawn.add_line(curves.values[first], curves.values[second], f"c{index}")
