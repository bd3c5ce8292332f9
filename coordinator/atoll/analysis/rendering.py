"""An analysis as plain data, which ``analyse --json`` prints, and as text."""

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from atoll.analysis.analysis import Analysis
from atoll.analysis.basins import NO_VALUE, RUNS_AWAY, UNDECIDED, Attractor
from atoll.analysis.continuation import Branch
from atoll.analysis.cycle_continuation import CycleBranch
from atoll.analysis.dynamics import Comparison, Motion
from atoll.analysis.fixed_points import FixedPoint
from atoll.analysis.limit_cycles import LimitCycle
from atoll_core.data.dataset import FloatArray

SCHEMA: Final = 1
_CODES: Final = {UNDECIDED: "undecided", RUNS_AWAY: "runs away", NO_VALUE: "no value"}
_ENDINGS: Final = {
    UNDECIDED: "reach none of these within the time that was simulated",
    RUNS_AWAY: "run away",
    NO_VALUE: "meet a point where a rate has no value",
}


def as_data(its: Analysis) -> dict[str, Any]:
    """Return the analysis as dictionaries, lists, texts and numbers; null is not finite, or unknown."""
    names = its.field.states
    return {
        "schema": SCHEMA,
        "caveat": its.caveat,
        "states": list(names),
        "inputs": dict(zip(its.field.inputs, _list(its.inputs), strict=True)),
        "box": {name: [low, high] for name, low, high in zip(names, its.box.lower, its.box.upper, strict=True)},
        "parameters": [
            {"name": each.name, "variable": each.variable, "value": each.value} for each in its.field.parameters
        ],
        "unit_coefficients": list(its.coefficients.units),
        "fixed_points": [_fixed_point(each) for each in its.fixed_points.points],
        "fixed_points_search": {
            "starts": its.fixed_points.starts,
            "converged": its.fixed_points.converged,
            "tolerance": its.fixed_points.tolerance,
            "are_isolated": its.fixed_points.are_isolated,
            "reached_outside_box": [_fixed_point(each) for each in its.cycles.resting],
        },
        "nullclines": {
            name: [line.tolist() for line in lines] for name, lines in zip(names, its.nullclines, strict=False)
        },
        "limit_cycles": [_cycle(each) for each in its.cycles.cycles],
        "limit_cycles_search": {
            "starts": its.cycles.starts,
            "duration": its.cycles.duration,
            "has_family": its.cycles.has_family,
            "unsettled": len(its.cycles.unsettled),
        },
        "lyapunov": _lyapunov(its),
        "basins": _basins(its),
        "conserved": [each.text for each in its.conserved],
        "is_volume_preserving": its.is_volume_preserving,
        "dynamics": [_comparison(each, its) for each in its.comparisons],
        "not_compared": list(its.not_compared),
        "continuation": _continuation(its),
    }


def _list(values: FloatArray | Iterable[float]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def _complex(values: Iterable[complex]) -> list[list[float | None]]:
    return [_list((each.real, each.imag)) for each in values]


def _fixed_point(each: FixedPoint) -> dict[str, Any]:
    return {
        "point": _list(each.point),
        "kind": each.kind,
        "is_stable": each.is_stable,
        "eigenvalues": _complex(each.eigenvalues),
    }


def _cycle(each: LimitCycle) -> dict[str, Any]:
    return {
        "period": each.period,
        "is_stable": each.is_stable,
        "multipliers": _complex(each.multipliers),
        "log_multiplier_product": each.log_multiplier_product,
        "minimum": _list(each.points.min(axis=0)),
        "maximum": _list(each.points.max(axis=0)),
        "points": [_list(point) for point in each.points],
    }


def _lyapunov(its: Analysis) -> dict[str, Any] | None:
    found = its.lyapunov
    if found is None:
        return None
    return {
        "exponents": _list(found.exponents),
        "standard_errors": _list(found.standard_errors),
        "is_chaotic": found.is_chaotic,
        "starts": found.starts,
        "duration": found.duration,
    }


def _basins(its: Analysis) -> dict[str, Any]:
    found = its.basins
    data: dict[str, Any] = {
        "attractors": [_name(each, its) for each in found.attractors],
        "starts": len(found.reached),
        "duration": found.duration,
        "fractions": [
            {
                "reaches": _reached(which, its),
                "fraction": found.fraction(which)[0],
                "std_error": found.fraction(which)[1],
            }
            for which in _codes(its)
        ],
        "codes": {str(code): text for code, text in _CODES.items()},
    }
    if found.grid is not None:
        data["grid"] = found.reached.reshape(found.grid, found.grid).tolist()
    return data


def _codes(its: Analysis) -> list[int]:
    """Return the attractors, and the codes that some start has."""
    return [*range(len(its.attractors)), *(code for code in _CODES if (its.basins.reached == code).any())]


def _reached(which: int, its: Analysis) -> str:
    return _CODES[which] if which < 0 else _name(its.attractors[which], its)


def _name(each: Attractor, its: Analysis) -> str:
    if isinstance(each, LimitCycle):
        return f"limit cycle of period {each.period:.6g}"
    return f"{each.kind} ({_point(each.point)})"


def _point(point: FloatArray) -> str:
    return ", ".join(f"{value:.6g}" for value in point)


def _motion(its: Motion) -> dict[str, Any]:
    return {
        "amplitudes": _list(its.amplitudes),
        "period": its.period,
        "phases": None if its.phases is None else _list(its.phases),
    }


def _comparison(each: Comparison, its: Analysis) -> dict[str, Any]:
    return {
        "trajectory": each.name,
        "is_bounded": each.is_bounded,
        "measured": _motion(each.measured),
        "simulated": _motion(each.simulated),
        "has_same_period": each.has_same_period,
        "has_same_amplitudes": each.has_same_amplitudes,
        "has_same_phases": each.has_same_order,
        "reaches": _reached(each.reaches, its),
        "orbit_period": each.orbit_period,
    }


def _continuation(its: Analysis) -> dict[str, Any] | None:
    parameter = its.continuation_parameter
    if parameter is None:
        return None
    named = {each.name: each.variable for each in its.field.parameters}
    return {
        "parameter": {
            "name": parameter.name,
            "variable": named.get(parameter.name),
            "value": parameter.value,
        },
        "branches": [_branch(each) for each in its.branches],
        "cycle_branches": [_cycle_branch(each) for each in its.cycle_branches],
    }


def _branch(its: Branch) -> dict[str, Any]:
    return {
        "values": _list(its.values),
        "points": [_list(point) for point in its.points],
        "unstable_eigenvalues": its.unstable.tolist(),
        "special": [
            {"kind": each.kind, "value": each.value, "point": _list(each.point), "frequency": each.frequency}
            for each in its.special
        ],
    }


def _cycle_branch(its: CycleBranch) -> dict[str, Any]:
    return {
        "values": _list(its.values),
        "periods": [each.period for each in its.cycles],
        "minima": [_list(each.points.min(axis=0)) for each in its.cycles],
        "maxima": [_list(each.points.max(axis=0)) for each in its.cycles],
        "multipliers": [_complex(each.multipliers) for each in its.cycles],
        "is_stable": [each.is_stable for each in its.cycles],
        "special": [
            {
                "kind": each.kind,
                "value": each.value,
                "period": each.cycle.period,
                "multipliers": _complex(each.cycle.multipliers),
            }
            for each in its.special
        ],
        "ends": list(its.ends),
    }


def as_text(its: Analysis) -> str:
    """Return the analysis as lines for a person."""
    return "\n".join(
        [*filter(None, [its.caveat]), *_box_lines(its),
         *_fixed_lines(its), *_cycle_lines(its), *_basin_lines(its), *_other_lines(its),
         *_comparison_lines(its), *_branch_lines(its)]
    )  # fmt: skip


def _box_lines(its: Analysis) -> list[str]:
    sides = zip(its.field.states, its.box.lower, its.box.upper, strict=True)
    lines = ["box: " + ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, low, high in sides)]
    held = ", ".join(f"{name} = {value:g}" for name, value in zip(its.field.inputs, its.inputs, strict=True))
    return [*lines, f"inputs held: {held}"] if held else lines


def _fixed_lines(its: Analysis) -> list[str]:
    found = its.fixed_points
    if not found.are_isolated:
        return [f"fixed points: more than {len(found.points)}, so that they form a curve or a surface"]
    lines = [f"fixed points: {len(found.points)} (Newton steps from {found.starts} starts)"]
    for each in (*found.points, *its.cycles.resting):
        outside = "" if its.box.contains(each.point, 1e-6) else ", outside the box"
        attracts = ", attracts" if each.is_stable and each.kind == "non-hyperbolic" else ""
        lines.append(
            f"  ({_point(each.point)})  {each.kind}{attracts}{outside}, eigenvalues {_numbers(each.eigenvalues)}"
        )
    return lines


def _numbers(values: Iterable[complex]) -> str:
    texts = []
    for each in values:
        if each.imag < 0.0:
            texts.append(f"{each.real:.4g} ± {-each.imag:.4g}i")
        elif each.imag == 0.0 or not math.isfinite(each.imag):
            texts.append(f"{each.real:.4g}")
    return ", ".join(texts)


def _cycle_lines(its: Analysis) -> list[str]:
    found = its.cycles
    lines = [f"limit cycles: {len(found.cycles)} ({found.starts} simulations)"]
    if found.has_family:
        lines[0] += "; there are closed orbits that are not isolated"
    for each in found.cycles:
        extents = zip(its.field.states, each.points.min(axis=0), each.points.max(axis=0), strict=True)
        ranges = ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, low, high in extents)
        how = "stable" if each.is_stable else "unstable"
        lines.append(f"  period {each.period:.6g}, {how}, multipliers {_numbers(each.multipliers)}; {ranges}")
    if its.lyapunov is not None:
        pairs = zip(its.lyapunov.exponents, its.lyapunov.standard_errors, strict=True)
        exponents = ", ".join(f"{value:.3g} ± {error:.1g}" for value, error in pairs)
        lines.append(f"Lyapunov exponents: {exponents}" + (", chaotic" if its.lyapunov.is_chaotic else ""))
    return lines


def _basin_lines(its: Analysis) -> list[str]:
    lines = [f"basins: of {len(its.basins.reached)} starts in the box"]
    for which in _codes(its):
        share, error = its.basins.fraction(which)
        ending = _ENDINGS[which] if which < 0 else f"reach the {_reached(which, its)}"
        if which == UNDECIDED and its.cycles.has_family:
            ending = "go round closed orbits, or reach none of these within the time that was simulated"
        lines.append(f"  {_share(share, error)} {ending}")
    return lines


def _share(share: float, error: float) -> str:
    """Return a share in per cent; its error says nothing where all starts, or none, end alike."""
    if share in (0.0, 1.0):
        return "all" if share else "none"
    return f"{100 * share:.1f} ± {100 * error:.1f} %"


def _other_lines(its: Analysis) -> list[str]:
    lines = ["volumes of states are kept (the divergence is 0)"] if its.is_volume_preserving else []
    return [*lines, *(f"conserved (a hint): {each.text}" for each in its.conserved)]


def _comparison_lines(its: Analysis) -> list[str]:
    lines = [line for each in its.comparisons for line in _beside(each, its)]
    if its.not_compared:
        names = ", ".join(its.not_compared)
        lines.append(f"the model is not compared with the data of trajectory {names}: the result has not its inputs")
    return lines


def _beside(each: Comparison, its: Analysis) -> list[str]:
    facts = ["is bounded" if each.is_bounded else "is not bounded"]
    if each.has_same_period is not None:
        periods = [f"{value:.4g}" if value else "none" for value in (each.simulated.period, each.measured.period)]
        facts.append(f"has period {periods[0]} (measured {periods[1]})")
    facts.append("has " + ("the" if each.has_same_amplitudes else "other") + " amplitudes of the data")
    if not each.has_same_amplitudes:
        facts[-1] = "has other amplitudes than the data"
    if each.has_same_order is not None:
        facts.append("phases agree" if each.has_same_order else "phases differ")
    held = ", inputs held" if its.field.inputs else ""
    if each.orbit_period is None:
        facts.append(f"reaches{held}: {_reached(each.reaches, its)}")
    else:
        facts.append(f"goes round a closed orbit of period {each.orbit_period:.4g}{held}")
    return [f"from trajectory {each.name} the model " + ", ".join(facts)]


def _branch_lines(its: Analysis) -> list[str]:
    if its.continuation_parameter is None:
        return []
    lines = [f"fixed points as {its.continuation_parameter.name} (now {its.continuation_parameter.value:.6g}) varies:"]
    lines += [line for branch in its.branches for line in _fixed_point_branch(branch)]
    lines.append(f"limit cycles as {its.continuation_parameter.name} varies: {len(its.cycle_branches)} branches")
    return [*lines, *(line for branch in its.cycle_branches for line in _cycle_branch_lines(branch))]


def _fixed_point_branch(branch: Branch) -> list[str]:
    unstable = sorted(set(branch.unstable.tolist()))
    counts = f"{unstable[0]} to {unstable[-1]}" if len(unstable) > 1 else f"{unstable[0]}"
    lines = [f"  a branch {_extent(branch.values)}; unstable eigenvalues: {counts}"]
    for each in branch.special:
        turning = f", frequency {each.frequency:.6g}" if each.frequency is not None else ""
        lines.append(f"    {each.kind} at {each.value:.8g} ({_point(each.point)}){turning}")
    return lines


def _cycle_branch_lines(branch: CycleBranch) -> list[str]:
    first, last = branch.cycles[0].period, branch.cycles[-1].period
    stable = sum(each.is_stable for each in branch.cycles)
    how = "stable" if stable == len(branch.cycles) else "unstable" if not stable else "stable in parts"
    lines = [f"  a branch {_extent(branch.values)}; period {first:.6g} to {last:.6g}, {how}"]
    lines.append(f"    begins: {branch.ends[0]}; ends: {branch.ends[1]}")
    lines += [f"    {each.kind} at {each.value:.8g}, period {each.cycle.period:.6g}" for each in branch.special]
    return lines


def _extent(values: FloatArray) -> str:
    return f"from {values[0]:.4g} to {values[-1]:.4g}, least {np.min(values):.4g}, greatest {np.max(values):.4g}"
