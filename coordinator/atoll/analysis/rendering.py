"""An analysis as plain data, which ``analyse --json`` prints, and as text."""

from typing import Final

from atoll.analysis.analysis import Analysis
from atoll.analysis.continuation import Branch
from atoll.analysis.cycle_continuation import CycleBranch
from atoll.analysis.fixed_sets import FixedSet
from atoll.analysis.limit_cycles import LimitCycle
from atoll.analysis.newton import TOLERANCE
from atoll.analysis.plain_data import attributes, plain
from atoll.analysis.sentences import CODES, attractor_text, codes_of, describe, reached_text
from atoll.analysis.stability import FixedPoint

SCHEMA: Final = 1


def as_data(analysis: Analysis) -> dict[str, object]:
    """Return the analysis as dictionaries, lists, texts and numbers; null is not finite, or unknown."""
    field, box, fixed, cycles = analysis.field, analysis.box, analysis.fixed_points, analysis.cycles
    return plain(
        {
            "schema": SCHEMA,
            "caveat": analysis.caveat,
            "states": field.states,
            "inputs": dict(zip(field.inputs, analysis.inputs, strict=True)),
            "box": {name: ends for name, *ends in zip(field.states, box.lower, box.upper, strict=True)},
            "parameters": [attributes(constant, "name", "variable", "value") for constant in field.parameters],
            "unit_coefficients": analysis.coefficients.units,
            "fixed_points": [_fixed_point(point) for point in fixed.points],
            "fixed_sets": [_fixed_set(fixed_set) for fixed_set in fixed.sets],
            "fixed_points_search": {
                **attributes(fixed, "starts", "converged"),
                "tolerance": TOLERANCE,
                "are_isolated": fixed.are_isolated,
                "reached_outside_box": [_fixed_point(point) for point in cycles.resting],
            },
            "nullclines": dict(zip(field.states, analysis.nullclines, strict=False)),
            "limit_cycles": [_cycle(cycle) for cycle in cycles.cycles],
            "limit_cycles_search": {
                **attributes(cycles, "starts", "duration", "has_family"),
                "unsettled": len(cycles.unsettled),
            },
            "lyapunov": None
            if analysis.lyapunov is None
            else attributes(analysis.lyapunov, "exponents", "standard_errors", "is_chaotic", "starts", "duration"),
            "basins": _basins(analysis),
            "conserved": [quantity.text for quantity in analysis.conserved],
            "is_volume_preserving": analysis.is_volume_preserving,
            "dynamics": [
                {
                    "trajectory": comparison.name,
                    "is_bounded": comparison.is_bounded,
                    "measured": vars(comparison.measured),
                    "simulated": vars(comparison.simulated),
                    **attributes(comparison, "has_same_period", "has_same_amplitudes"),
                    "has_same_phases": comparison.has_same_order,
                    "reaches": reached_text(comparison.reaches, analysis),
                    "orbit_period": comparison.orbit_period,
                    "end": comparison.end,
                }
                for comparison in analysis.comparisons
            ],
            "not_compared": analysis.not_compared,
            "continuation": _continuation(analysis),
        }
    )


def _fixed_point(fixed: FixedPoint) -> dict[str, object]:
    return attributes(fixed, "point", "kind", "is_stable", "attracts_in_box", "eigenvalues")


def _fixed_set(fixed: FixedSet) -> dict[str, object]:
    points = [_fixed_point(point) for point in fixed.points]
    return attributes(fixed, "dimension", "is_straight", "attracts_in_box", "course") | {"points": points}


def _cycle(cycle: LimitCycle) -> dict[str, object]:
    return {
        **attributes(cycle, "period", "is_stable", "multipliers", "log_multiplier_product"),
        "minimum": cycle.points.min(axis=0),
        "maximum": cycle.points.max(axis=0),
        "points": cycle.points,
    }


def _basins(analysis: Analysis) -> dict[str, object]:
    basins = analysis.basins
    fractions = []
    for which in codes_of(analysis):
        share, error = basins.fraction(which)
        fractions.append({"reaches": reached_text(which, analysis), "fraction": share, "std_error": error})
    data: dict[str, object] = {
        "attractors": [attractor_text(attractor) for attractor in basins.attractors],
        "starts": len(basins.reached),
        "duration": basins.duration,
        "fractions": fractions,
        "codes": {str(code): text for code, text in CODES.items()},
    }
    return data if basins.grid is None else data | {"grid": basins.reached.reshape(basins.grid, basins.grid)}


def _continuation(analysis: Analysis) -> dict[str, object] | None:
    parameter = analysis.continuation_parameter
    if parameter is None:
        return None
    named = {constant.name: constant.variable for constant in analysis.field.parameters}
    return {
        "parameter": {"name": parameter.name, "variable": named.get(parameter.name), "value": parameter.value},
        "branches": [_branch(branch) for branch in analysis.branches],
        "cycle_branches": [_cycle_branch(branch) for branch in analysis.cycle_branches],
    }


def _branch(branch: Branch) -> dict[str, object]:
    return {
        "values": branch.values,
        "points": branch.points,
        "unstable_eigenvalues": branch.unstable,
        "special": [vars(point) for point in branch.special],
    }


def _cycle_branch(branch: CycleBranch) -> dict[str, object]:
    cycles = branch.cycles
    return {
        "values": branch.values,
        "periods": [cycle.period for cycle in cycles],
        "minima": [cycle.points.min(axis=0) for cycle in cycles],
        "maxima": [cycle.points.max(axis=0) for cycle in cycles],
        "multipliers": [cycle.multipliers for cycle in cycles],
        "is_stable": [cycle.is_stable for cycle in cycles],
        "special": [
            attributes(special, "kind", "value") | attributes(special.cycle, "period", "multipliers")
            for special in branch.special
        ],
        "ends": branch.ends,
    }


def as_text(analysis: Analysis) -> str:
    """Return the analysis as lines for a person."""
    lines: list[str] = []
    for part in describe(analysis):
        if isinstance(part, str):
            lines.append(part)
        elif part.has_heading:
            lines += [part.title, *(f"  {row.line}" for row in part.rows)]
        else:
            lines += [row.line for row in part.rows]
    return "\n".join(lines)
