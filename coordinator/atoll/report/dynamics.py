"""How the model moves: the phase plane, fixed points, cycles, basins, and all of it beside the data."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from atoll.model.groups import differing_groups
from atoll.report.chart import COLORS, Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, figure, legend, number, paragraph, section, table
from atoll.report.trajectories import chosen

if TYPE_CHECKING:
    from atoll.analysis.analysis import Analysis


def dynamics(its: Findings) -> list[Element]:
    """Return the section, none of a regression."""
    if its.model is not None and its.model.is_regression:
        return []
    if its.analysis is None and (groups := differing_groups(its.result)):
        text = f"Constants differ between the groups {', '.join(groups)}; coordinator report --group NAME analyses one."
        return [section("dynamics", "Dynamics", paragraph(text))]
    if its.analysis is None:
        return [section("dynamics", "Dynamics", paragraph(f"The model is not analysed: {its.unanalysed}."))]
    found = its.analysis.as_dict()
    parts: list[Element] = [paragraph(its.analysis.caveat)] if its.analysis.caveat else []
    if len(found["states"]) == 2:
        parts.append(element("div", _phase_plane(its, its.analysis), class_="pictures"))
    parts.append(_searched(found))
    parts += [*_fixed_points(found), *_cycles(found), *_lyapunov(found), _basins(found), *_comparisons(found)]
    parts += [paragraph(f"Conserved along the flow (a hint): {text}") for text in found["conserved"]]
    if found["is_volume_preserving"]:
        parts.append(paragraph("Volumes of states are kept: the divergence is 0."))
    return [section("dynamics", "Dynamics", *parts)]


def _phase_plane(its: Findings, found: "Analysis") -> Element:
    first, second = found.field.states
    bounds = list(zip(found.box.lower.tolist(), found.box.upper.tolist(), strict=True))
    drawn = Chart(
        f"phase plane of {first} and {second} with nullclines and fixed points",
        Axis(first, bounds=bounds[0]),
        Axis(second, bounds=bounds[1]),
    )
    _add_basins(drawn, found)
    _add_arrows(drawn, found)
    for state, lines in enumerate(found.nullclines):
        for line in lines:
            drawn.add_line(line[:, 0].tolist(), line[:, 1].tolist(), f"nullcline n{state}")
    _add_trajectories(drawn, its)
    for cycle in found.cycles.cycles:
        closed = np.vstack([cycle.points, cycle.points[:1]])
        drawn.add_line(closed[:, 0].tolist(), closed[:, 1].tolist(), "cycle" if cycle.is_stable else "cycle unstable")
    for each in found.fixed_points.points:
        drawn.add_points([each.point[0]], [each.point[1]], "fixed stable" if each.is_stable else "fixed unstable")
    marks = [
        ("line n0", f"d{first}/dt = 0"),
        ("line n1", f"d{second}/dt = 0"),
        ("dot fixed stable", "stable fixed point"),
        ("dot fixed unstable", "other fixed point"),
    ]
    if found.cycles.cycles:
        marks.append(("line cycle", "limit cycle"))
    marks += [(f"line c{index}", f"trajectory {part.name}") for index, part in enumerate(chosen(its.trajectories))]
    return figure(
        drawn.svg(),
        "Phase plane" + ("; shades tell which attractor is reached" if len(found.basins.attractors) > 1 else ""),
        None,
        legend(marks),
    )


def _add_basins(drawn: Chart, found: "Analysis") -> None:
    """Add the cells of each basin, those of a column that are neighbours as one rectangle."""
    grid = found.basins.grid
    if grid is None or len(found.basins.attractors) < 2:
        return
    reached = found.basins.reached.reshape(grid, grid)
    (left, bottom), (width, height) = found.box.lower, found.box.widths / grid
    for which in range(len(found.basins.attractors)):
        corners = [
            (left + width * (column + side), bottom + height * end)
            for column in range(grid)
            for begin, finish in _runs(reached[column] == which)
            for side, end in ((0, begin), (1, finish))
        ]
        if corners:
            x, y = zip(*corners, strict=True)
            drawn.add_cells(x, y, f"basin c{which % COLORS}")


def _runs(flags: "np.ndarray[Any, np.dtype[np.bool_]]") -> list[tuple[int, int]]:
    """Return where runs of true flags begin and end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _add_arrows(drawn: Chart, found: "Analysis") -> None:
    """Add short lines along the flow, with a dot where they begin."""
    cells = 14
    places = [
        low + (np.arange(cells) + 0.5) * width / cells
        for low, width in zip(found.box.lower, found.box.widths, strict=True)
    ]
    points = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 2)
    rates = found.field.values(points, np.tile(found.inputs, (len(points), 1)) if len(found.inputs) else None)
    scaled = rates / found.box.widths
    lengths = np.hypot(scaled[:, 0], scaled[:, 1])[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = 0.6 / cells * scaled / lengths * found.box.widths
    ends = points + steps
    x, y = ([value for row in zip(points[:, axis].tolist(), ends[:, axis].tolist(), strict=True)
             for value in (*row, None)] for axis in range(2))  # fmt: skip
    drawn.add_line(x, y, "flow")


def _add_trajectories(drawn: Chart, its: Findings) -> None:
    columns = its.system.states
    if len(columns) != 2:
        return
    first, second = columns
    for index, part in enumerate(chosen(its.trajectories)):
        if part.measured:
            drawn.add_points(part.measured[first], part.measured[second], f"small c{index}")
        values = part.values or {}
        drawn.add_line(values[first], values[second], f"c{index}")


def _searched(found: Mapping[str, Any]) -> Element:
    box = ", ".join(f"{name} from {number(low)} to {number(high)}" for name, (low, high) in found["box"].items())
    held = ", ".join(f"{name} = {number(value)}" for name, value in found["inputs"].items())
    return paragraph(
        f"Searched for {box}" + (f", with {held}" if held else "") + ". A bounded search proves nothing of what it did "
        "not meet."
    )


def _point(point: Sequence[float | None]) -> str:
    return "(" + ", ".join(number(value) for value in point) + ")"


def _fixed_points(found: Mapping[str, Any]) -> list[Element]:
    points = [*found["fixed_points"], *found["fixed_points_search"]["reached_outside_box"]]
    if not points:
        return [paragraph("No fixed point was met.")]
    rows = [[_point(each["point"]), each["kind"], _numbers(each["eigenvalues"])] for each in points]
    heads = [f"({', '.join(found['states'])})", "kind", "eigenvalues"]
    listed = table("Fixed points", heads, rows)
    if found["fixed_points_search"]["are_isolated"]:
        return [listed]
    return [listed, paragraph("They form a curve or a surface, of which some points are shown.")]


def _numbers(values: Sequence[Sequence[float | None]]) -> str:
    """Return complex numbers as text, conjugate ones as a pair."""
    said = []
    for real, imaginary in values:
        if not imaginary:
            said.append(number(real))
        elif imaginary > 0.0:
            said.append(f"{number(real)} ± {number(imaginary)}i")
    return ", ".join(said)


def _cycles(found: Mapping[str, Any]) -> list[Element]:
    if not found["limit_cycles"]:
        return []
    rows = [
        [
            number(each["period"], 6),
            "stable" if each["is_stable"] else "unstable",
            _numbers(each["multipliers"]),
            _point(each["minimum"]),
            _point(each["maximum"]),
        ]
        for each in found["limit_cycles"]
    ]
    return [table("Limit cycles", ["period", "stability", "Floquet multipliers", "least", "greatest"], rows)]


def _lyapunov(found: Mapping[str, Any]) -> list[Element]:
    its = found["lyapunov"]
    if its is None:
        return []
    exponents = zip(its["exponents"], its["standard_errors"], strict=True)
    said = ", ".join(f"{number(value, 3)} ± {number(error, 1)}" for value, error in exponents)
    return [paragraph(f"Lyapunov exponents: {said}" + ("; the motion is chaotic." if its["is_chaotic"] else "."))]


def _basins(found: Mapping[str, Any]) -> Element:
    others = "undecided, or on closed orbits" if found["limit_cycles_search"]["has_family"] else "undecided"
    rows = [
        [
            others if each["reaches"] == "undecided" else each["reaches"],
            f"{100 * each['fraction']:.1f} ± {100 * each['std_error']:.1f} %",
        ]
        for each in found["basins"]["fractions"]
    ]
    return table(f"What {found['basins']['starts']} starts in the box reach", ["reached", "share"], rows)


def _comparisons(found: Mapping[str, Any]) -> list[Element]:
    names = ", ".join(found["not_compared"])
    text = f"The model is not compared with the data of trajectory {names}: the result has not its inputs."
    without = [paragraph(text)] if names else []
    if not found["dynamics"]:
        return without
    rows = [
        [
            element("span", str(each["trajectory"])),
            "bounded" if each["is_bounded"] else "not bounded",
            _same(each["has_same_period"], number(each["simulated"]["period"]), number(each["measured"]["period"])),
            "same" if each["has_same_amplitudes"] else "other",
            _same(each["has_same_phases"]),
            each["reaches"]
            if each["orbit_period"] is None
            else f"a closed orbit of period {number(each['orbit_period'])}",
        ]
        for each in found["dynamics"]
    ]
    heads = ["trajectory", "the model is", "period", "amplitudes", "phases", "reaches"]
    return [table("The model, simulated freely, beside the data", heads, rows), *without]


def _same(flag: bool | None, simulated: str = "", measured: str = "") -> str:
    if flag is None:
        return "none"
    numbers = f" ({simulated or 'none'}, measured {measured or 'none'})" if simulated or measured else ""
    return ("same" if flag else "other") + numbers
