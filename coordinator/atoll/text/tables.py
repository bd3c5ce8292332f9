"""What people are shown beside the equations: constants, contenders, noise, simulations. Lines of text.

Works on the dictionary of ``result.json``; what a result does not have is not shown.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from atoll.model.parameters import constant_names, interval_text, r2_text

MOST_LINES: Final = 12
"""Trajectories and pairs of constants listed one by one; of more, the worst are."""
NEAREST: Final = 2
"""Contenders shown beside the chosen equation where there is room for a few lines only."""
_PLACES: Final = {
    "end": "near ends",
    "gap": "near gaps",
    "jump": "at jumps",
    "outlier": "outliers",
    "missing": "missing",
}

_EXACT_SHARE: Final = 1e-6
"""Standard errors below this share of their constants are those of rounding, and not worth a line."""


def columns(heads: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "") -> list[str]:
    """Return rows under their heads, right-aligned but for the last column, which is not padded."""
    lines = [tuple(heads), *map(tuple, rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(heads) - 1)]
    padded = (
        "  ".join([*(cell.rjust(width) for cell, width in zip(line, widths, strict=False)), line[-1]]) for line in lines
    )
    return [f"{indent}{line}".rstrip() for line in padded]


def percent(share: float | None) -> str:
    """Return a share such as 0.0512 as ``5.1 %``; ``?`` for None."""
    return "?" if share is None else f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


# ------------------------------------------------------------------------------------------------- constants


def plus_minus(value: float, error: float) -> str:
    """Return ``2.981 ± 0.018``, or ``1.21e-07 ± 3.0e-09``: an error in two digits, the value with as many decimals."""
    if not error > 0.0:
        return f"{value:.6g}"
    size = math.floor(math.log10(max(abs(value), error)))
    decimals = 1 - math.floor(math.log10(error))
    if -4 <= size < 6:
        return f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"
    return f"{value:.{max(decimals + size, 0)}e} ± {error:.1e}"


def _has_errors(constant: Mapping[str, Any]) -> bool:
    """Tell whether the error of a constant is known; where it is infinite, it is null, and nothing is determined."""
    return constant["std_error"] is not None or not _is_told(constant) or bool(constant.get("at_bound"))


def _is_told(constant: Mapping[str, Any]) -> bool:
    return bool(constant.get("identifiable", True))


def constants_line(constants: Sequence[Mapping[str, Any]]) -> str | None:
    """Return all constants with their standard errors in a line; None when these are not known, or are rounding."""
    known = [each for each in constants if _has_errors(each)]
    if all(_is_exact(each) for each in known):
        return None
    return "constants: " + ", ".join(_constant_text(each) for each in known)


def _is_exact(constant: Mapping[str, Any]) -> bool:
    is_small = (constant["std_error"] or 0.0) <= _EXACT_SHARE * abs(constant["value"])
    return is_small and _is_told(constant) and not constant.get("at_bound")


def _constant_text(constant: Mapping[str, Any]) -> str:
    return _number_text(constant) + _unit_text(constant)


def _unit_text(constant: Mapping[str, Any]) -> str:
    unit = constant.get("unit")
    return f" {unit}" if unit not in (None, "1") else ""


def _remark(constant: Mapping[str, Any]) -> str:
    if constant.get("at_bound"):
        return "on its bound"
    return _simple_text(constant) if _is_told(constant) else "not determined by the data"


def _number_text(constant: Mapping[str, Any]) -> str:
    fitted = constant["value"] if constant["fitted"] is None else constant["fitted"]
    text = plus_minus(fitted, constant["std_error"] or 0.0)
    shown = f"{constant['value']:.6g}"
    remark = "" if _is_told(constant) else "not determined"
    if constant.get("at_bound"):
        return f"{shown} (at its bound, {interval_text(constant.get('interval'))})"
    if constant["std_error"] is None:
        return f"{shown} ({remark})" if remark else shown
    if text.startswith(f"{shown} "):
        return f"{text} ({remark})" if remark else text
    return f"{shown} ({', '.join([text, remark] if remark else [text])})"


def constants_table(constants: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line for each constant whose standard error is known, or infinite, with a head; nothing for none."""
    known = [each for each in constants if _has_errors(each)]
    has_intervals = any(each.get("interval") is not None for each in known)
    heads = ("constant", "fitted ± std error", *(("95 % interval",) if has_intervals else ()), "")
    rows = [
        (
            f"{each['value']:.6g}{_unit_text(each)}",
            plus_minus(each["value"] if each["fitted"] is None else each["fitted"], each["std_error"] or 0.0),
            *((interval_text(each.get("interval")),) if has_intervals else ()),
            _remark(each),
        )
        for each in known
    ]
    return columns(heads, rows, "    ") if rows else []


def together_line(together: Mapping[str, Any] | None) -> list[str]:
    """Return a line on simple numbers of several constants, judged together; nothing where others are likelier."""
    if not together or together["odds"] is None:
        return []
    chi = "" if together["chi_square"] is None else f" (chi-square {together['chi_square']:.2g})"
    numbers = " and ".join(f"{value:.6g}" for value in together["values"])
    return [f"    {numbers} together{chi}: odds {together['odds']:.2g} against other numbers"]


def units_line(units: Mapping[str, Any] | None) -> list[str]:
    """Return a line on factors of one that are not written but have a unit; nothing without any."""
    if not units or not units["implied"]:
        return []
    factors = ", ".join(f"1 {each['unit']} before {each['of']}" for each in units["implied"])
    return [f"    units: not written is {factors}"]


def groups_table(
    constants: Sequence[Mapping[str, Any]], groups: Sequence[Mapping[str, Any]], names: Sequence[str]
) -> list[str]:
    """Return a line for each group of trajectories with the constants of its own; nothing where all share them.

    `names` are those of the constants.
    """
    own = [place for place, each in enumerate(constants) if each.get("shared") is False]
    if not groups or not own:
        return []
    heads = ("group", *(f"{names[place]} = {constants[place]['value']:.6g}" for place in own), "")
    rows = [(its["group"], *(_constant_text(its["constants"][place]) for place in own), its["text"]) for its in groups]
    return columns(heads, rows, "    ")


def _simple_text(constant: Mapping[str, Any]) -> str:
    """Return the odds of the simple number that is shown, or how far the nearest one is from the estimate."""
    simple = constant.get("simple")
    if simple is None or simple["odds"] is None:
        return ""
    if simple["value"] == constant["value"]:
        return f"odds {simple['odds']:.2g} against other numbers"
    return f"{simple['value']:.6g} is {simple['standard_errors']:.1f} standard errors off, odds {simple['odds']:.2g}"


# ------------------------------------------------------------------------------------------------ contenders


def contenders_table(
    candidates: Sequence[Mapping[str, Any]], display: Callable[[str], str], most: int | None = None
) -> list[str]:
    """Return the contenders, the one shown first, by how much longer a description they are; nothing for one alone.

    At most `most` others are listed; of the rest their number.
    """
    if len(candidates) < 2:
        return []
    shown = candidates if most is None else candidates[: most + 1]
    is_held_out = any(each["held_out_r2"] is not None for each in shown)
    is_crossed = any(each.get("cross_validated") for each in shown)
    unseen = "cross-validated" if is_crossed else "held out"
    heads = ("contender", "nats", "R2", *((unseen,) if is_held_out else ()), "size", "origin", "expression")
    rows = [
        (
            "*" if each["selected"] else "",
            "?" if each["nats"] is None else f"{each['nats']:.1f}",
            r2_text(each["r2"]),
            *((r2_text(each["held_out_r2"]),) if is_held_out else ()),
            str(each["complexity"]),
            each.get("origin") or "-",
            display(each["expression"]),
        )
        for each in shown
    ]
    rest = len(candidates) - len(shown)
    return [*columns(heads, rows, "    "), *([f"    {rest} more: coordinator result"] if rest else [])]


# ---------------------------------------------------------------------------------------- the model as a whole


def summary(result: Mapping[str, Any]) -> list[str]:
    """Return the noise in a line and the simulations in another; nothing for what is exact or not known."""
    noisy = {state: its for state, its in result.get("noise", {}).items() if its["method"] != "interpolation"}
    lines = []
    if noisy:
        parts = ", ".join(f"{state} {percent(its['relative'])}" for state, its in noisy.items())
        lines.append(f"noise: {parts} of the deviation")
    texts = {state: _error_text(its.get("errors")) for state, its in result.get("noise", {}).items()}
    lines += [f"errors of {state}{text.replace(';', ':', 1)}" for state, text in texts.items() if text]
    if any(equation.get("verdict") != "exact" for equation in result["equations"]):
        lines += _simulation_line(_trajectories(result))
    return lines


def _simulation_line(trajectories: Sequence[Mapping[str, Any]]) -> list[str]:
    whole = [each for each in trajectories if each.get("values") or None not in each["r2"].values()]
    parts: list[str] = []
    for held_out in (False, True):
        chosen = [each for each in whole if each["held_out"] is held_out]
        if chosen:
            what = "held out" if held_out else "trajectory" if len(chosen) == 1 else "trajectories"
            least = min(value for each in chosen for value in each["r2"].values() if value is not None)
            parts.append(f"{'' if parts else 'R2 at least '}{r2_text(least)} on {len(chosen)} {what}")
    if len(whole) < len(trajectories):
        parts.append(f"{len(trajectories) - len(whole)} not to the end")
    return [f"simulation: {', '.join(parts)}"] if parts else []


def noise_lines(result: Mapping[str, Any]) -> list[str]:
    """Return a line for each state: how noisy it is, and how it was smoothed."""
    return [f"noise of {state}: {_noise_text(its)}" for state, its in result.get("noise", {}).items()]


_ROUNDINGS: Final = {
    "decimals": "values rounded to multiples of {:.3g}",
    "digits": "values rounded to significant digits, to {:.3g} where they are largest",
    "single precision": "values in single precision, in steps of {:.3g} where they are largest",
    "steps": "values in steps of {:.3g}, as of an encoder",
}


def _error_text(errors: Mapping[str, Any] | None) -> str:
    """Return in words how errors differ from independent ones of one size, nothing where they do not."""
    if errors is None:
        return ""
    parts = []
    if errors["proportional"]:
        parts.append(f"{percent(errors['proportional'])} of their variance grows with the value squared")
    if errors["add_up"]:
        size = f"{errors['sd']:.2g} within {errors['piece']} rows"
        parts.append(f"errors add up along trajectories, as those of a solver do: {size}")
    elif errors["correlated"]:
        rows = max(2, round(errors["correlation_rows"]))
        what = "errors" if errors["correlated"] == 1.0 else f"{percent(errors['correlated'])} of the errors' variance"
        verb = "go" if what == "errors" else "goes"
        parts.append(f"{what} of neighbouring rows {verb} together over about {rows} rows")
    return "".join(f"; {part}" for part in parts)


def _noise_text(its: Mapping[str, Any]) -> str:
    rounding = its.get("quantisation")
    if its["method"] == "interpolation":
        text = "none to speak of" if rounding is None else f"{percent(its['relative'])} of its deviation at most"
        text += "; interpolated"
    else:
        size = "?" if its["sd"] is None else f"{its['sd']:.3g}"
        text = f"{size}, {percent(its['relative'])} of its deviation; {its['method']}"
        text += f" of degree {its['degree']} over {its['span']} rows"
        text += _residual_text(its)
    text += _error_text(its.get("errors"))
    if rounding is not None:
        text += f"; {_ROUNDINGS[rounding['kind']].format(rounding['step'])}"
    if its["doubtful_rows"]:
        text += f"; derivatives doubtful on {its['doubtful_rows']} rows"
    many = "1 outlier" if its["outliers"] == 1 else f"{its['outliers']} outliers"
    text = f"{text}; {many}" if its["outliers"] else text
    reasons = _reasons(its.get("doubtful", ()))
    return f"{text}; not used: {reasons}" if reasons else text


def _residual_text(its: Mapping[str, Any]) -> str:
    """Return how far measurements lie from the smoothed curve at most; nothing where that is not known."""
    largest = its.get("largest_residual")
    if largest is None or largest["value"] is None:
        return ""
    where = f"t = {largest['time']:.6g} of trajectory {largest['trajectory']}"
    return f"; residuals {its['residual_rms']:.3g}, the largest {largest['value']:.3g} at {where}"


def _reasons(doubtful: Sequence[Mapping[str, Any]]) -> str:
    """Return how many rows are not used for each reason, such as ``8 rows near ends, 3 outliers``."""
    counts = {reason: sum(len(each["times"]) for each in doubtful if each["reason"] == reason) for reason in _PLACES}
    return ", ".join(f"{count} {_PLACES[reason]}" for reason, count in counts.items() if count)


def simulation_table(result: Mapping[str, Any]) -> list[str]:
    """Return R2 of every simulated trajectory and state; of many trajectories the worst."""
    trajectories = _trajectories(result)
    if not trajectories:
        return []
    shown = sorted(trajectories, key=_worst)[:MOST_LINES] if len(trajectories) > MOST_LINES else trajectories
    states = [*trajectories[0]["r2"]]
    rows = [
        (each["name"], *(r2_text(each["r2"][state]) for state in states), "held out" if each["held_out"] else "")
        for each in shown
    ]
    head = "R2 of simulations from fitted initial values"
    rest = [f"the {MOST_LINES} worst of {len(trajectories)}"] if len(shown) < len(trajectories) else []
    return [head, *columns(("trajectory", *states, ""), rows, "    "), *(f"    {line}" for line in rest)]


def _worst(trajectory: Mapping[str, Any]) -> float:
    return min((-math.inf if value is None else value for value in trajectory["r2"].values()), default=math.inf)


def _trajectories(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    simulation = result.get("simulation")
    return [] if simulation is None else list(simulation["trajectories"])


def correlation_lines(result: Mapping[str, Any]) -> list[str]:
    """Return a line for each pair of constants that the data hardly tell apart, the closest first."""
    constants = {equation["variable"]: equation["constants"] for equation in result["equations"]}
    names = constant_names(result) if result.get("correlations") else {}

    def named(place: Mapping[str, Any]) -> str:
        variable, number = place["variable"], place["constant"]
        name, value = names[variable][number], f"{constants[variable][number]['value']:.6g}"
        return f"{value} of {variable}" + (f" ({name})" if name != value else "")

    pairs = sorted(result.get("correlations", ()), key=lambda each: -abs(each["value"] or 0.0))
    return [
        f"hardly told apart: {named(pair['first'])} and {named(pair['second'])}, correlation {pair['value']:.3f}"
        for pair in pairs[:MOST_LINES]
        if pair["value"] is not None
    ]
