"""How the model moves: the phase plane, fixed points, cycles, basins, and all of it beside the data."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from atoll.analysis.sentences import Listing, describe
from atoll.model.groups import differing_groups
from atoll.report.chart import COLORS, Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, figure, legend, paragraph, pictures, section, table

if TYPE_CHECKING:
    from atoll.analysis.analysis import Analysis


def dynamics(findings: Findings) -> list[Element]:
    """Return the section, none of a regression."""
    if findings.model is not None and findings.model.is_regression:
        return []
    analysis = findings.analysis
    if analysis is None:
        groups = ", ".join(differing_groups(findings.result))
        told_apart = f"Constants differ between the groups {groups}; coordinator report --group NAME analyses one."
        why = told_apart if groups else f"The model is not analysed: {findings.unanalysed}."
        return [section("dynamics", "Dynamics", paragraph(why))]
    parts = [_part(part) for part in describe(analysis)]
    if analysis.nullclines:
        parts.insert(1 if analysis.caveat else 0, pictures([_phase_plane(findings, analysis)]))
    bounded = paragraph("A bounded search proves nothing of what it did not meet.")
    return [section("dynamics", "Dynamics", *parts, bounded)]


def _part(part: str | Listing) -> Element:
    """Return a sentence as a paragraph, and a listing as a table; of nothing its title alone."""
    text = part.title if isinstance(part, Listing) else part
    text = text[:1].upper() + text[1:]
    if isinstance(part, Listing) and part.rows:
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
        "Phase plane" + ("; shades tell which attractor is reached" if len(analysis.basins.attractors) > 1 else ""),
        None,
        legend(marks),
    )


def _add_basins(drawn: Chart, analysis: "Analysis") -> None:
    """Add the cells of each basin, those of a column that are neighbours as one rectangle."""
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
    """Return where runs of true flags begin and end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _add_arrows(drawn: Chart, analysis: "Analysis") -> None:
    """Add short lines along the flow, with a dot where they begin."""
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
