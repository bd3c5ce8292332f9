"""An analysis as plain data, which ``analyse --json`` prints, and as text."""

import math
from collections.abc import Iterable
from typing import Final

from atoll.analysis.analysis import Analysis
from atoll.analysis.continuation import Branch
from atoll.analysis.cycle_continuation import CycleBranch
from atoll.analysis.dynamics import Comparison, Motion
from atoll.analysis.fixed_points import FixedPoint
from atoll.analysis.limit_cycles import LimitCycle
from atoll.analysis.sentences import CODES, attractor_text, codes_of, describe, reached_text
from atoll_core.data.dataset import FloatArray

SCHEMA: Final = 1


def as_data(analysis: Analysis) -> dict[str, object]:
    """Return the analysis as dictionaries, lists, texts and numbers; null is not finite, or unknown."""
    names, box, constants = analysis.field.states, analysis.box, analysis.field.parameters
    return {
        "schema": SCHEMA,
        "caveat": analysis.caveat,
        "states": list(names),
        "inputs": dict(zip(analysis.field.inputs, _list(analysis.inputs), strict=True)),
        "box": {name: [low, high] for name, low, high in zip(names, box.lower, box.upper, strict=True)},
        "parameters": [
            {"name": constant.name, "variable": constant.variable, "value": constant.value} for constant in constants
        ],
        "unit_coefficients": list(analysis.coefficients.units),
        "fixed_points": [_fixed_point(point) for point in analysis.fixed_points.points],
        "fixed_points_search": {
            "starts": analysis.fixed_points.starts,
            "converged": analysis.fixed_points.converged,
            "tolerance": analysis.fixed_points.tolerance,
            "are_isolated": analysis.fixed_points.are_isolated,
            "reached_outside_box": [_fixed_point(point) for point in analysis.cycles.resting],
        },
        "nullclines": {
            name: [line.tolist() for line in lines] for name, lines in zip(names, analysis.nullclines, strict=False)
        },
        "limit_cycles": [_cycle(cycle) for cycle in analysis.cycles.cycles],
        "limit_cycles_search": {
            "starts": analysis.cycles.starts,
            "duration": analysis.cycles.duration,
            "has_family": analysis.cycles.has_family,
            "unsettled": len(analysis.cycles.unsettled),
        },
        "lyapunov": _lyapunov(analysis),
        "basins": _basins(analysis),
        "conserved": [quantity.text for quantity in analysis.conserved],
        "is_volume_preserving": analysis.is_volume_preserving,
        "dynamics": [_comparison(comparison, analysis) for comparison in analysis.comparisons],
        "not_compared": list(analysis.not_compared),
        "continuation": _continuation(analysis),
    }


def _list(values: FloatArray | Iterable[float]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def _complex(values: Iterable[complex]) -> list[list[float | None]]:
    return [_list((value.real, value.imag)) for value in values]


def _fixed_point(fixed: FixedPoint) -> dict[str, object]:
    return {
        "point": _list(fixed.point),
        "kind": fixed.kind,
        "is_stable": fixed.is_stable,
        "eigenvalues": _complex(fixed.eigenvalues),
    }


def _cycle(cycle: LimitCycle) -> dict[str, object]:
    return {
        "period": cycle.period,
        "is_stable": cycle.is_stable,
        "multipliers": _complex(cycle.multipliers),
        "log_multiplier_product": cycle.log_multiplier_product,
        "minimum": _list(cycle.points.min(axis=0)),
        "maximum": _list(cycle.points.max(axis=0)),
        "points": [_list(point) for point in cycle.points],
    }


def _lyapunov(analysis: Analysis) -> dict[str, object] | None:
    spectrum = analysis.lyapunov
    if spectrum is None:
        return None
    return {
        "exponents": _list(spectrum.exponents),
        "standard_errors": _list(spectrum.standard_errors),
        "is_chaotic": spectrum.is_chaotic,
        "starts": spectrum.starts,
        "duration": spectrum.duration,
    }


def _basins(analysis: Analysis) -> dict[str, object]:
    basins = analysis.basins
    data: dict[str, object] = {
        "attractors": [attractor_text(attractor) for attractor in basins.attractors],
        "starts": len(basins.reached),
        "duration": basins.duration,
        "fractions": [
            {
                "reaches": reached_text(which, analysis),
                "fraction": basins.fraction(which)[0],
                "std_error": basins.fraction(which)[1],
            }
            for which in codes_of(analysis)
        ],
        "codes": {str(code): text for code, text in CODES.items()},
    }
    if basins.grid is not None:
        data["grid"] = basins.reached.reshape(basins.grid, basins.grid).tolist()
    return data


def _motion(motion: Motion) -> dict[str, object]:
    return {
        "amplitudes": _list(motion.amplitudes),
        "period": motion.period,
        "phases": None if motion.phases is None else _list(motion.phases),
    }


def _comparison(comparison: Comparison, analysis: Analysis) -> dict[str, object]:
    return {
        "trajectory": comparison.name,
        "is_bounded": comparison.is_bounded,
        "measured": _motion(comparison.measured),
        "simulated": _motion(comparison.simulated),
        "has_same_period": comparison.has_same_period,
        "has_same_amplitudes": comparison.has_same_amplitudes,
        "has_same_phases": comparison.has_same_order,
        "reaches": reached_text(comparison.reaches, analysis),
        "orbit_period": comparison.orbit_period,
    }


def _continuation(analysis: Analysis) -> dict[str, object] | None:
    parameter = analysis.continuation_parameter
    if parameter is None:
        return None
    named = {constant.name: constant.variable for constant in analysis.field.parameters}
    return {
        "parameter": {
            "name": parameter.name,
            "variable": named.get(parameter.name),
            "value": parameter.value,
        },
        "branches": [_branch(branch) for branch in analysis.branches],
        "cycle_branches": [_cycle_branch(branch) for branch in analysis.cycle_branches],
    }


def _branch(branch: Branch) -> dict[str, object]:
    return {
        "values": _list(branch.values),
        "points": [_list(point) for point in branch.points],
        "unstable_eigenvalues": branch.unstable.tolist(),
        "special": [
            {"kind": point.kind, "value": point.value, "point": _list(point.point), "frequency": point.frequency}
            for point in branch.special
        ],
    }


def _cycle_branch(branch: CycleBranch) -> dict[str, object]:
    return {
        "values": _list(branch.values),
        "periods": [cycle.period for cycle in branch.cycles],
        "minima": [_list(cycle.points.min(axis=0)) for cycle in branch.cycles],
        "maxima": [_list(cycle.points.max(axis=0)) for cycle in branch.cycles],
        "multipliers": [_complex(cycle.multipliers) for cycle in branch.cycles],
        "is_stable": [cycle.is_stable for cycle in branch.cycles],
        "special": [
            {
                "kind": special.kind,
                "value": special.value,
                "period": special.cycle.period,
                "multipliers": _complex(special.cycle.multipliers),
            }
            for special in branch.special
        ],
        "ends": list(branch.ends),
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
