"""The dynamics of a model in one object, with its text, tables and plain data.

``analyse --json`` prints the plain data. The text output and the report render the sentences and tables.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from atoll.analysis.basins import Attractor, Basins
from atoll.analysis.conserved import ConservedQuantity
from atoll.analysis.continuation import Branch, Coefficients, ContinuationParameter
from atoll.analysis.cycle_continuation import CycleBranch
from atoll.analysis.dynamics import TrajectoryComparison
from atoll.analysis.fixed_points import FixedPoints
from atoll.analysis.flow import Box
from atoll.analysis.limit_cycles import LimitCycle, LimitCycles
from atoll.analysis.lyapunov import LyapunovSpectrum
from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.quoting import first_lines

if TYPE_CHECKING:
    import polars

import math
from collections.abc import Iterable, Iterator

from atoll.analysis.basins import NO_VALUE, RUNS_AWAY, UNDECIDED
from atoll.analysis.fixed_points import NON_HYPERBOLIC, TOLERANCE, Complexes, FixedPoint, FixedSet
from atoll.terminal.output import attributes, plain

SCHEMA: Final = 1

CODES: Final[Mapping[int, str]] = {UNDECIDED: "undecided", RUNS_AWAY: "runs away", NO_VALUE: "no value"}
"""The ends of simulations that reach no attractor, in the order of the text."""

_ENDINGS: Final = {
    UNDECIDED: "reach no attractor within the simulated time",
    RUNS_AWAY: "diverge",
    NO_VALUE: "reach a point where a rate is undefined",
}


@dataclass(frozen=True, eq=False)
class Analysis:
    """The dynamics of `field` in `box` with the inputs held at `inputs` (U,).

    For systems of two states, `nullclines` has the polylines (n, 2) for each state; for other systems it is empty.
    `lyapunov` belongs to trajectories that end at no known fixed point or cycle; it is None without such trajectories.
    Trajectories `not_compared` have inputs that are not known. `branches` (of fixed points) and `cycle_branches` follow
    the `continuation_parameter`, one of `coefficients`. `caveat` names the equations with the verdict `no model`; it is
    "" if there are none.
    """

    field: VectorField
    box: Box
    inputs: FloatArray
    fixed_points: FixedPoints
    nullclines: tuple[tuple[FloatArray, ...], ...]
    cycles: LimitCycles
    lyapunov: LyapunovSpectrum | None
    basins: Basins
    conserved: tuple[ConservedQuantity, ...]
    is_volume_preserving: bool
    comparisons: tuple[TrajectoryComparison, ...]
    coefficients: Coefficients
    continuation_parameter: ContinuationParameter | None = None
    branches: tuple[Branch, ...] = ()
    cycle_branches: tuple[CycleBranch, ...] = ()
    not_compared: tuple[str, ...] = ()
    caveat: str = ""

    def __str__(self) -> str:
        return as_text(self)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return a ``"polars"`` or ``"pandas"`` frame with a row for each isolated fixed point.

        Its columns are the states, `kind`, `is_stable` and `attracts_in_box`. Raises UsageError without that library.
        """
        points = self.fixed_points.points
        states = {name: [float(point.point[place]) for point in points] for place, name in enumerate(self.field.states)}
        kinds = {name: [getattr(point, name) for point in points] for name in ("kind", "is_stable", "attracts_in_box")}
        return frame_of(states | kinds, library)

    def as_dict(self) -> dict[str, object]:
        """Return the analysis as plain data, as ``coordinator analyse --json`` prints it."""
        return as_data(self)

    @property
    def attractors(self) -> tuple[Attractor, ...]:
        """The fixed points, sets of fixed points and limit cycles that attract from within the box."""
        return self.basins.attractors


@dataclass(frozen=True)
class TextRow:
    """One row of a table: its `cells` (an empty cell is ""), and the same content as one `line`."""

    cells: tuple[str, ...]
    line: str


@dataclass(frozen=True)
class TextTable:
    """Rows under a `title`, with a cell for each of `heads`; if `has_heading` is False, text shows only the rows."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[TextRow, ...]
    has_heading: bool = True


def as_text(analysis: Analysis) -> str:
    """Return the analysis as lines of text."""
    lines: list[str] = []
    for part in describe(analysis):
        if isinstance(part, str):
            lines.append(part)
        elif part.has_heading:
            lines += [part.title, *(f"  {row.line}" for row in part.rows)]
        else:
            lines += [row.line for row in part.rows]
    return "\n".join(lines)


def describe(analysis: Analysis) -> list[str | TextTable]:
    """Return the sentences and tables of an analysis, in order; sentences begin with a small letter."""
    return [*_describe_parts(analysis)]


def _describe_parts(analysis: Analysis) -> Iterator[str | TextTable]:
    box, field, spectrum = analysis.box, analysis.field, analysis.lyapunov
    if analysis.caveat:
        yield analysis.caveat
    sides = zip(field.states, box.lower, box.upper, strict=True)
    yield "box: " + ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, low, high in sides)
    if field.inputs:
        held = zip(field.inputs, analysis.inputs, strict=True)
        yield "inputs held: " + ", ".join(f"{name} = {value:g}" for name, value in held)
    yield _fixed_points(analysis)
    yield _cycles(analysis)
    if spectrum is not None:
        pairs = zip(spectrum.exponents, spectrum.standard_errors, strict=True)
        exponents = ", ".join(f"{value:.3g} ± {error:.1g}" for value, error in pairs)
        yield f"Lyapunov exponents: {exponents}" + (", chaotic" if spectrum.is_chaotic else "")
    yield _basins(analysis)
    if analysis.is_volume_preserving:
        yield "the flow preserves volume (the divergence is 0)"
    yield from (f"conserved (a hint): {quantity.text}" for quantity in analysis.conserved)
    if analysis.comparisons:
        heads = ("trajectory", "bounds", "period", "amplitudes", "phases", "end")
        rows = tuple(_comparison(comparison, analysis) for comparison in analysis.comparisons)
        yield TextTable("the model, simulated freely, compared with the data", heads, rows, has_heading=False)
    if analysis.not_compared:
        names = ", ".join(analysis.not_compared)
        yield f"the model is not compared with trajectory {names}: the result does not contain its inputs"
    parameter = analysis.continuation_parameter
    if parameter is not None:
        columns = ("branch", "special points")
        fixed = tuple(_branch(branch) for branch in analysis.branches)
        yield TextTable(f"fixed points as {parameter.name} (now {parameter.value:.6g}) varies:", columns, fixed)
        cycles = tuple(_cycle_branch(branch) for branch in analysis.cycle_branches)
        yield TextTable(f"limit cycles as {parameter.name} varies: {len(cycles)} branches", columns, cycles)


def _destinations(analysis: Analysis) -> list[int]:
    reached = analysis.basins.reached
    return [*range(len(analysis.attractors)), *(code for code in CODES if (reached == code).any())]


def _destination_text(which: int, analysis: Analysis) -> str:
    return CODES[which] if which < 0 else _attractor_text(analysis.attractors[which])


def _attractor_text(attractor: Attractor) -> str:
    if isinstance(attractor, LimitCycle):
        return f"limit cycle of period {attractor.period:.6g}"
    if isinstance(attractor, FixedSet):
        return _set_text(attractor)
    return f"{attractor.kind} {_point_text(attractor.point)}"


def _set_text(fixed: FixedSet) -> str:
    if fixed.dimension > 1:
        return f"surface of fixed points of {fixed.dimension} dimensions"
    name = "line" if fixed.is_straight else "curve"
    return f"{name} of fixed points from {_point_text(fixed.course[0])} to {_point_text(fixed.course[-1])}"


def _point_text(point: FloatArray) -> str:
    return f"({', '.join(f'{value:.6g}' for value in point)})"


def _complex_text(numbers: Iterable[complex]) -> str:
    texts = []
    for number in numbers:
        if number.imag < 0.0:
            texts.append(f"{number.real:.4g} ± {-number.imag:.4g}i")
        elif number.imag == 0.0 or not math.isfinite(number.imag):
            texts.append(f"{number.real:.4g}")
    return ", ".join(texts)


def _fixed_points(analysis: Analysis) -> TextTable:
    search, resting = analysis.fixed_points, analysis.cycles.resting
    curves = sum(fixed.dimension == 1 for fixed in search.sets)
    counts = ((curves, "curve"), (len(search.sets) - curves, "surface"))
    many = " and ".join(f"{count} {name}{'s' if count > 1 else ''}" for count, name in counts if count)
    more = f" and {many} of them" if many else ""
    title = f"fixed points: {len(search.points)}{more} (Newton steps from {search.starts} starts)"
    heads = (f"({', '.join(analysis.field.states)})", "kind", "eigenvalues")
    rows = [_fixed_point(point, analysis) for point in (*search.points, *resting)]
    for fixed in search.sets:
        attracts = {point.attracts_in_box for point in fixed.points}
        share = "attracts in parts" if len(attracts) > 1 else "attracts" if True in attracts else "does not attract"
        rows.append(TextRow((_set_text(fixed), share, ""), f"{_set_text(fixed)}, {share}; on it"))
        rows += [_fixed_point(point, analysis, across="across it ") for point in fixed.points[::2]]
    return TextTable(title, heads, tuple(rows))


def _fixed_point(fixed: FixedPoint, analysis: Analysis, across: str = "") -> TextRow:
    kind = fixed.kind
    if kind == NON_HYPERBOLIC and fixed.attracts_in_box:  # an eigenvalue is 0: simulations decide
        node = "attracts" if fixed.eigenvalues.imag.any() else "a stable node"
        kind += f", by simulations {node}{'' if fixed.is_stable else ' within the box'}"
    outside = "" if analysis.box.contains(fixed.point, 1e-6) else ", outside the box"
    cells = (_point_text(fixed.point), f"{across}{kind}{outside}", _complex_text(fixed.eigenvalues))
    return TextRow(cells, f"{cells[0]}  {cells[1]}, eigenvalues {cells[2]}")


def _cycles(analysis: Analysis) -> TextTable:
    search, states = analysis.cycles, analysis.field.states
    family = "; there are closed orbits that are not isolated" if search.has_family else ""
    rows = []
    for cycle in search.cycles:
        extents = zip(cycle.points.min(axis=0), cycle.points.max(axis=0), strict=True)
        ranges = [f"{low:.4g} to {high:.4g}" for low, high in extents]
        period, stability = f"{cycle.period:.6g}", "stable" if cycle.is_stable else "unstable"
        multipliers = _complex_text(cycle.multipliers)
        named = ", ".join(f"{name} {ends}" for name, ends in zip(states, ranges, strict=True))
        line = f"period {period}, {stability}, multipliers {multipliers}; {named}"
        rows.append(TextRow((period, stability, multipliers, *ranges), line))
    heads = ("period", "stability", "Floquet multipliers", *states)
    return TextTable(f"limit cycles: {len(search.cycles)} ({search.starts} simulations){family}", heads, tuple(rows))


def _basins(analysis: Analysis) -> TextTable:
    rows = []
    for which in _destinations(analysis):
        part, error = analysis.basins.fraction(which)
        without_error = {0.0: "none", 1.0: "all"}
        share = without_error.get(part, f"{100 * part:.1f} ± {100 * error:.1f} %")
        ending = _ENDINGS[which] if which < 0 else f"reach the {_destination_text(which, analysis)}"
        if which == UNDECIDED and analysis.cycles.has_family:
            ending = "follow closed orbits, or reach no attractor within the simulated time"
        rows.append(TextRow((share, ending), f"{share} {ending}"))
    title = f"basins: of {len(analysis.basins.reached)} initial states in the box"
    return TextTable(title, ("share", "of the initial states"), tuple(rows))


def _comparison(comparison: TrajectoryComparison, analysis: Analysis) -> TextRow:
    period, phases = "", ""
    if comparison.has_same_period is not None:
        periods = (comparison.simulated.period, comparison.measured.period)
        simulated, measured = (f"{value:.4g}" if value else "none" for value in periods)
        period = f"has period {simulated} (measured {measured})"
    if comparison.has_same_phases is not None:
        phases = "phases agree" if comparison.has_same_phases else "phases differ"
    is_same = comparison.has_same_amplitudes
    held = ", inputs held" if analysis.field.inputs else ""
    reached = analysis.attractors[comparison.reaches] if comparison.reaches >= 0 else None
    is_in_set = isinstance(reached, FixedSet) and comparison.end is not None
    at = f", at {_point_text(comparison.end)}" if is_in_set and comparison.end is not None else ""
    end = f"reaches{held}: {_destination_text(comparison.reaches, analysis)}{at}"
    if comparison.orbit_period is not None:
        end = f"follows a closed orbit of period {comparison.orbit_period:.4g}{held}"
    facts = (
        "is bounded" if comparison.is_bounded else "is not bounded",
        period,
        "has the amplitudes of the data" if is_same else "has different amplitudes than the data",
        phases,
        end,
    )
    line = f"from trajectory {comparison.name} the model {', '.join(filter(None, facts))}"
    return TextRow((comparison.name, *facts), line)


def _branch(branch: Branch) -> TextRow:
    unstable = sorted(set(branch.unstable.tolist()))
    counts = f"{unstable[0]} to {unstable[-1]}" if len(unstable) > 1 else f"{unstable[0]}"
    special = []
    for point in branch.special:
        frequency = f", frequency {point.frequency:.6g}" if point.frequency is not None else ""
        special.append(f"{point.kind} at {point.value:.8g} {_point_text(point.point)}{frequency}")
    return _branch_row(branch.values, f"unstable eigenvalues: {counts}", special)


def _cycle_branch(branch: CycleBranch) -> TextRow:
    first, last = branch.cycles[0].period, branch.cycles[-1].period
    stable = sum(cycle.is_stable for cycle in branch.cycles)
    stability = "stable" if stable == len(branch.cycles) else "unstable" if not stable else "stable in parts"
    ends = f"begins: {branch.ends[0]}; ends: {branch.ends[1]}"
    special = [f"{point.kind} at {point.value:.8g}, period {point.cycle.period:.6g}" for point in branch.special]
    return _branch_row(branch.values, f"period {first:.6g} to {last:.6g}, {stability}", [ends, *special])


def _branch_row(values: FloatArray, character: str, special: list[str]) -> TextRow:
    extent = f"from {values[0]:.4g} to {values[-1]:.4g}, least {np.min(values):.4g}, greatest {np.max(values):.4g}"
    branch = f"a branch {extent}; {character}"
    return TextRow((branch, "; ".join(special)), "\n".join([branch, *(f"    {text}" for text in special)]))


# --------------------------------------------------------------------------------------------------------- plain data


def as_data(analysis: Analysis) -> dict[str, object]:
    """Return the analysis as dictionaries, lists, texts and numbers; null stands for an infinite or unknown number."""
    field, box, fixed, cycles = analysis.field, analysis.box, analysis.fixed_points, analysis.cycles
    return plain(
        {
            "schema": SCHEMA,
            "caveat": analysis.caveat,
            "states": field.states,
            "inputs": dict(zip(field.inputs, analysis.inputs, strict=True)),
            "box": {name: ends for name, *ends in zip(field.states, box.lower, box.upper, strict=True)},
            "parameters": [
                attributes(constant, "name", "variable", "value") for constant in field.named_parameters.values()
            ],
            "unit_coefficients": analysis.coefficients.units,
            "fixed_points": [_fixed_point_data(point) for point in fixed.points],
            "fixed_sets": [
                attributes(fixed_set, "dimension", "is_straight", "attracts_in_box", "course")
                | {"points": [_fixed_point_data(point) for point in fixed_set.points]}
                for fixed_set in fixed.sets
            ],
            "fixed_points_search": {
                **attributes(fixed, "starts", "converged"),
                "tolerance": TOLERANCE,
                "are_isolated": fixed.are_isolated,
                "reached_outside_box": [_fixed_point_data(point) for point in cycles.resting],
            },
            "nullclines": dict(zip(field.states, analysis.nullclines, strict=False)),
            "limit_cycles": [_cycle_data(cycle) for cycle in cycles.cycles],
            "limit_cycles_search": {
                **attributes(cycles, "starts", "duration", "has_family"),
                "unsettled": len(cycles.unsettled),
            },
            "lyapunov": None
            if analysis.lyapunov is None
            else attributes(analysis.lyapunov, "exponents", "standard_errors", "is_chaotic", "starts", "duration"),
            "basins": _basins_data(analysis),
            "conserved": [quantity.text for quantity in analysis.conserved],
            "is_volume_preserving": analysis.is_volume_preserving,
            "dynamics": [
                {
                    "trajectory": comparison.name,
                    **attributes(comparison, "is_bounded", "measured", "simulated"),
                    **attributes(comparison, "has_same_period", "has_same_amplitudes", "has_same_phases"),
                    "reaches": _destination_text(comparison.reaches, analysis),
                    **attributes(comparison, "orbit_period", "end"),
                }
                for comparison in analysis.comparisons
            ],
            "not_compared": analysis.not_compared,
            "continuation": _continuation_data(analysis),
        }
    )


def _fixed_point_data(fixed: FixedPoint) -> dict[str, object]:
    known = attributes(fixed, "point", "kind", "is_stable", "attracts_in_box")
    return {**known, "eigenvalues": _pairs(fixed.eigenvalues)}


def _pairs(values: Complexes) -> FloatArray:
    """Return the real and imaginary parts (n, 2) of complex numbers (n,)."""
    return np.stack([values.real, values.imag], axis=-1)


def _cycle_data(cycle: LimitCycle) -> dict[str, object]:
    return {
        **attributes(cycle, "period", "is_stable"),
        "multipliers": _pairs(cycle.multipliers),
        "log_multiplier_product": cycle.log_multiplier_product,
        "minimum": cycle.points.min(axis=0),
        "maximum": cycle.points.max(axis=0),
        "points": cycle.points,
    }


def _basins_data(analysis: Analysis) -> dict[str, object]:
    basins = analysis.basins
    fractions = []
    for which in _destinations(analysis):
        share, error = basins.fraction(which)
        fractions.append({"reaches": _destination_text(which, analysis), "fraction": share, "std_error": error})
    data: dict[str, object] = {
        "attractors": [_attractor_text(attractor) for attractor in basins.attractors],
        "starts": len(basins.reached),
        "duration": basins.duration,
        "fractions": fractions,
        "codes": {str(code): text for code, text in CODES.items()},
    }
    return data if basins.grid is None else data | {"grid": basins.reached.reshape(basins.grid, basins.grid)}


def _continuation_data(analysis: Analysis) -> dict[str, object] | None:
    parameter = analysis.continuation_parameter
    if parameter is None:
        return None
    named = {constant.name: constant.variable for constant in analysis.field.named_parameters.values()}
    return {
        "parameter": {"name": parameter.name, "variable": named.get(parameter.name), "value": parameter.value},
        "branches": [
            {
                **attributes(branch, "values", "points"),
                "unstable_eigenvalues": branch.unstable,
                "special": branch.special,
            }
            for branch in analysis.branches
        ],
        "cycle_branches": [_cycle_branch_data(branch) for branch in analysis.cycle_branches],
    }


def _cycle_branch_data(branch: CycleBranch) -> dict[str, object]:
    cycles = branch.cycles
    return {
        "values": branch.values,
        "periods": [cycle.period for cycle in cycles],
        "minima": [cycle.points.min(axis=0) for cycle in cycles],
        "maxima": [cycle.points.max(axis=0) for cycle in cycles],
        "multipliers": [_pairs(cycle.multipliers) for cycle in cycles],
        "is_stable": [cycle.is_stable for cycle in cycles],
        "special": [
            attributes(special, "kind", "value")
            | {"period": special.cycle.period, "multipliers": _pairs(special.cycle.multipliers)}
            for special in branch.special
        ],
        "ends": branch.ends,
    }
