"""Render a result as text, CSV, SymPy or LaTeX."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll.export.formats import as_csv, as_latex, as_sympy
from atoll.model.equations import (
    DIGITS,
    ConstantWords,
    GivenWords,
    constant_names,
    constant_words,
    fitted_text,
    given_words,
    interval_text,
    number_text,
    observation_text,
    plus_minus,
    r2_text,
    rounded,
    run_names,
    side_text,
    unit_text,
    with_errors,
    words_of,
    words_of_run,
)
from atoll.model.given_sides import GivenSides, searched_parts
from atoll_coordinator.result.equations import (
    Candidate,
    Check,
    Constant,
    Equation,
    Member,
    Observation,
    SimpleTogether,
    Units,
)
from atoll_coordinator.result.findings import Errors, Noise, PathEnsemble, Place
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.data.notes import with_kind
from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

MOST_LINES: Final = 12
"""Largest number of listed trajectories and of listed pairs of constants; if there are more, the worst are listed."""
NEAREST: Final = 2
"""Number of alternative equations in a short output."""
_PLACES: Final = {
    "end": "near ends",
    "gap": "near gaps",
    "jump": "at jumps",
    "outlier": "outliers",
    "missing": "missing",
}
_ROUNDINGS: Final = {
    "decimals": "values rounded to multiples of {:.3g}",
    "digits": "values rounded to significant digits, in steps of {:.3g} at the largest value",
    "single precision": "values in single precision, in steps of {:.3g} at the largest value",
    "steps": "values in steps of {:.3g}, like the values of an encoder",
}


def columns(heads: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "") -> list[str]:
    """Return rows under their heads; all columns are right-aligned except the last one, which is not padded."""
    lines = [tuple(heads), *map(tuple, rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(heads) - 1)]
    padded = (
        "  ".join([*(cell.rjust(width) for cell, width in zip(line, widths, strict=False)), line[-1]]) for line in lines
    )
    return [f"{indent}{line}".rstrip() for line in padded]


def percent(share: float | None) -> str:
    """Return a share such as 0.0512 as ``5.1 %``; ``?`` for None."""
    return "?" if share is None else f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


# ---------------------------------------------------------------------------------------------------- checks


def checks_text(checks: Sequence[Check]) -> str:
    """Return the numbers of passed and applicable checks, and the names of checks that failed or were not made."""
    passed = sum(check.outcome == "passed" for check in checks)
    parts = [f"{passed} of {sum(check.outcome != 'not applicable' for check in checks)} passed"]
    for outcome in ("failed", "not made"):
        names = [check.name for check in checks if check.outcome == outcome]
        parts += [f"{outcome}: {', '.join(names)}"] if names else []
    return f"checks: {'; '.join(parts)}"


def checks_lines(checks: Sequence[Check], *, is_listed: bool) -> list[str]:
    """Return a line about all checks of an equation and, if `is_listed`, a line for each check."""
    if not checks:
        return []
    listed = [f"        {check.name}: {check.outcome}: {check.reason}" for check in checks] if is_listed else []
    return [f"    {checks_text(checks)}", *listed]


# ------------------------------------------------------------------------------------------------- constants


def constants_line(constants: Sequence[Constant]) -> str | None:
    """Return all constants with their standard errors in one line; None if the errors are unknown or only rounding."""
    known = constant_words(constants)
    return "constants: " + ", ".join(map(_words_text, known)) if known else None


def _words_text(words: ConstantWords) -> str:
    return words.number + (f" ({', '.join(words.notes)})" if words.notes else "") + unit_text(words.unit)


def constants_table(constants: Sequence[Constant], names: Sequence[str] = ()) -> list[str]:
    """Return a table of the constants whose standard errors are known or infinite; empty without such constants.

    `names` are the names of all constants; if there are none, the constants have no names in the table.
    """
    known = with_errors(constants)
    called = {id(constant): f"{name} = " for constant, name in zip(constants, names, strict=False)}
    has_intervals = any(constant.interval is not None for constant in known)
    heads = ("constant", "fitted ± std error", *(("95 % interval",) if has_intervals else ()), "")
    rows = [
        (
            called.get(id(constant), "") + number_text(constant.value, 6) + unit_text(constant.unit),
            fitted_text(constant),
            *((interval_text(constant.interval),) if has_intervals else ()),
            _remark(constant),
        )
        for constant in known
    ]
    return columns(heads, rows, "    ") if rows else []


def _remark(constant: Constant) -> str:
    """Return the odds of the displayed simple number, the distance to the nearest one, or why the constant has none."""
    simple = constant.simple
    if constant.at_bound:
        return "at its bound"
    if not constant.identifiable:
        return "not determined by the data"
    if simple is None or simple.odds is None:
        return ""
    if simple.value is None or simple.value == constant.value:
        return f"odds {simple.odds:.2g} against other numbers"
    return f"{simple.value:.6g} is {simple.standard_errors or 0.0:.1f} standard errors away, odds {simple.odds:.2g}"


def together_line(together: SimpleTogether | None) -> list[str]:
    """Return a line about simple numbers of several constants together; empty if other numbers are more likely."""
    if not together or together.odds is None:
        return []
    chi = "" if together.chi_square is None else f" (chi-square {together.chi_square:.2g})"
    numbers = " and ".join(f"{value:.6g}" for value in together.values if value is not None)
    return [f"    {numbers} together{chi}: odds {together.odds:.2g} against other numbers"]


def units_line(units: Units | None) -> list[str]:
    """Return a line about coefficients of 1 that are not written but have a unit; empty if there are none."""
    if not units or not units.implied:
        return []
    factors = ", ".join(f"1 {factor.unit} before {factor.of}" for factor in units.implied)
    return [f"    units: coefficients that are not written: {factors}"]


def groups_table(equation: Equation, texts: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return a line for each group of trajectories with its own constants; empty if all groups share the constants.

    `texts` are the displayed expressions of the groups, `names` the names of the constants.
    """
    own = [place for place, constant in enumerate(equation.constants) if constant.shared is False]
    if not equation.groups or not own:
        return []
    heads = ("group", *(f"{names[place]} = {number_text(equation.constants[place].value, 6)}" for place in own), "")
    rows = [
        (group.group, *(_words_text(words_of(group.constants[place])) for place in own), text)
        for group, text in zip(equation.groups, texts, strict=True)
    ]
    return columns(heads, rows, "    ")


# ------------------------------------------------------------------------------------------------ candidates


def candidates_table(
    candidates: Sequence[Candidate], display: Callable[[str], str], most: int | None = None
) -> list[str]:
    """Return the candidates with their Δ description length, the displayed one first; empty for a single candidate.

    At most `most` other candidates and all guesses are listed. A last line has the number of the remaining candidates.
    """
    if len(candidates) < 2:
        return []
    displayed = [one for place, one in enumerate(candidates) if most is None or place <= most or one.origin == "guess"]
    is_held_out = any(candidate.held_out_r2 is not None for candidate in displayed)
    unseen = "cross-validated" if any(candidate.cross_validated for candidate in displayed) else "held out"
    heads = (
        "candidate",
        "Δ description length",
        "R2",
        *((unseen,) if is_held_out else ()),
        "size",
        "origin",
        "expression",
    )
    rows = [
        (
            "*" if candidate.selected else "",
            "?" if candidate.nats is None else f"{candidate.nats:.1f}",
            r2_text(candidate.r2),
            *((r2_text(candidate.held_out_r2),) if is_held_out else ()),
            str(candidate.complexity),
            candidate.origin or "-",
            display(candidate.expression),
        )
        for candidate in displayed
    ]
    rest = len(candidates) - len(displayed)
    return [*columns(heads, rows, "    "), *([f"    {rest} more: coordinator result"] if rest else [])]


# ---------------------------------------------------------------------------------------- the model as a whole


def summary(result: Result) -> list[str]:
    """Return lines about noise and simulations; empty if the data have no noise and all equations are exact."""
    noisy = [
        f"{state} {percent(noise.relative)}"
        for state, noise in result.noise.items()
        if noise.method not in ("interpolation", "hidden")
    ]
    lines = [f"noise: {', '.join(noisy)} of the standard deviation"] if noisy else []
    errors = {state: "; ".join(_error_texts(noise.errors)) for state, noise in result.noise.items()}
    lines += [f"errors of {state}: {text}" for state, text in errors.items() if text]
    if any(equation.verdict != "exact" for equation in result.equations):
        lines += _simulation_line(result.simulated)
    return lines


def _simulation_line(trajectories: Sequence[Simulated]) -> list[str]:
    whole = [part for part in trajectories if part.values or None not in part.r2.values()]
    parts: list[str] = []
    for held_out in (False, True):
        chosen = [part for part in whole if part.held_out is held_out]
        least = min((r2 for part in chosen for r2 in part.r2.values() if r2 is not None), default=None)
        if least is not None:
            what = "held out" if held_out else "trajectory" if len(chosen) == 1 else "trajectories"
            parts.append(f"{'' if parts else 'R2 at least '}{r2_text(least)} on {len(chosen)} {what}")
    if len(whole) < len(trajectories):
        parts.append(f"{len(trajectories) - len(whole)} ended early")
    return [f"simulation: {', '.join(parts)}"] if parts else []


def noise_lines(result: Result) -> list[str]:
    """Return a line for each state: its noise, and how the state was smoothed."""
    measured = {state: noise for state, noise in result.noise.items() if state not in result.unmeasured}
    return [f"noise of {state}: {_noise_text(noise)}" for state, noise in measured.items()]


def _error_texts(errors: Errors | None) -> list[str]:
    """Return in words how errors differ from independent errors of constant size."""
    if errors is None:
        return []
    texts = []
    if errors.proportional:
        texts.append(f"{percent(errors.proportional)} of their variance grows with the value squared")
    if errors.add_up:
        size = f"{errors.sd or 0.0:.2g} within {errors.piece} rows"
        texts.append(f"errors accumulate along trajectories, like integration errors of a solver: {size}")
    elif errors.correlated:
        rows = max(2, round(errors.correlation_rows or 0.0))
        share = f"{percent(errors.correlated)} of the error variance is"
        what = "errors are" if errors.correlated == 1.0 else share
        texts.append(f"{what} correlated over about {rows} rows")
    return texts


def _noise_text(noise: Noise) -> str:
    relative, rounding = f"{percent(noise.relative)} of the standard deviation", noise.quantisation
    if noise.method == "interpolation":
        texts = ["negligible" if rounding is None else f"{relative} at most", "interpolated"]
    else:
        smoothed = f"{noise.method} of degree {noise.degree} over {noise.span} rows"
        texts = [f"{number_text(noise.sd)}, {relative}", smoothed, *_residual_texts(noise)]
    texts += _error_texts(noise.errors)
    if rounding is not None:
        words = _ROUNDINGS.get(rounding.kind or "", "values rounded in steps of {:.3g}")
        texts.append(words.format(rounding.step or 0.0))
    if noise.doubtful_rows:
        texts.append(f"derivatives doubtful on {noise.doubtful_rows} rows")
    if noise.outliers:
        texts.append("1 outlier" if noise.outliers == 1 else f"{noise.outliers} outliers")
    counts = {reason: sum(len(rows.times) for rows in noise.doubtful if rows.reason == reason) for reason in _PLACES}
    reasons = ", ".join(f"{count} {_PLACES[reason]}" for reason, count in counts.items() if count)
    return "; ".join([*texts, f"not used: {reasons}"] if reasons else texts)


def _residual_texts(noise: Noise) -> list[str]:
    """Return the largest residual of the smoothed curve, if it is known."""
    largest = noise.largest_residual
    if largest is None or largest.value is None:
        return []
    where = f"t = {largest.time or 0.0:.6g} of trajectory {largest.trajectory}"
    return [f"residuals {noise.residual_rms or 0.0:.3g}, the largest {largest.value:.3g} at {where}"]


def simulation_table(result: Result) -> list[str]:
    """Return R2 of every simulated trajectory and state; if there are many trajectories, only the worst."""
    trajectories = result.simulated
    if not trajectories:
        return []
    displayed = sorted(trajectories, key=_worst)[:MOST_LINES] if len(trajectories) > MOST_LINES else trajectories
    states = [*trajectories[0].r2]
    rows = [
        (part.name, *(r2_text(part.r2[state]) for state in states), "held out" if part.held_out else "")
        for part in displayed
    ]
    rest = [f"    the {MOST_LINES} worst of {len(trajectories)}"] if len(displayed) < len(trajectories) else []
    head = "R2 of simulations from fitted initial values"
    return [head, *columns(("trajectory", *states, ""), rows, "    "), *rest]


def _worst(trajectory: Simulated) -> float:
    return min((-math.inf if value is None else value for value in trajectory.r2.values()), default=math.inf)


def correlation_lines(result: Result) -> list[str]:
    """Return a line for each pair of strongly correlated constants, the strongest first."""
    constants = {equation.variable: equation.constants for equation in result.equations}
    names = constant_names(result) if result.correlations else {}

    def name_of(place: Place) -> str:
        variable, number = place.variable, place.constant or 0
        name, value = names[variable][number], number_text(constants[variable][number].value, 6)
        return f"{value} of {variable}" + (f" ({name})" if name != value else "")

    pairs = sorted(result.correlations, key=lambda pair: -abs(pair.value or 0.0))
    return [
        f"strongly correlated: {name_of(pair.first)} and {name_of(pair.second)}, correlation {pair.value:.3f}"
        for pair in pairs[:MOST_LINES]
        if pair.value is not None
    ]


_EULER_MARUYAMA: Final = "rows are the steps of an Euler-Maruyama simulation rather than samples of a process in time"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def process_lines(result: Result) -> list[str]:
    """Return lines about the process of a result; none without a process."""
    process = result.process
    if process is None:
        return []
    lines = []
    if process.discretisation == "Euler-Maruyama":
        difference = number_text(process.discretisation_nats)
        lines.append(f"{_EULER_MARUYAMA} (this description is {difference} nats shorter)")
    for state, noise in process.measurement_noise.items():
        lines.append(f"measurement errors of {state}: {plus_minus(noise.sd or 0.0, noise.std_error or 0.0)}")
    if process.ensemble is not None:
        lines.append(_ensemble_line(process.ensemble))
    if process.stationary is None:
        reason = (
            "not computed: there are inputs" if result.columns.inputs else "none: simulations do not become stationary"
        )
        lines.append(f"stationary density: {reason}")
    for state, density in (process.stationary or {}).items():
        sizes = f"{number_text(density.mean)} ± {number_text(density.sd)}"
        overlap = f"overlap with the measured density {percent(density.overlap)}"
        bars = f"    {number_text(density.edges[0])} {_bars(density.density)} {number_text(density.edges[-1])}"
        lines += [f"stationary density of {state}: {sizes}, {overlap}", bars]
    return lines


def _ensemble_line(ensemble: PathEnsemble) -> str:
    ranges = [
        f"{state} from {number_text(ensemble.lower[state][-1])} to {number_text(ensemble.upper[state][-1])}"
        for state in ensemble.mean
    ]
    start = f"{ensemble.finite_paths} paths from the initial state of trajectory {ensemble.trajectory}"
    return f"ensemble: {start}; at t = {number_text(ensemble.times[-1], 6)}, 90 % of the paths have {', '.join(ranges)}"


def _bars(values: Sequence[float | None]) -> str:
    heights = [value or 0.0 for value in values]
    most = max(heights, default=0.0) or 1.0
    return "".join(_BLOCKS[round((len(_BLOCKS) - 1) * height / most)] for height in heights)


FORMATS: Final = ("text", "json", "csv", "sympy", "latex")

_NUMBER: Final = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?")
ENDS: Final = {
    "target": "the target error was met",
    "law": "equations from sparse regression describe the data up to noise",
    "stagnation": "no better equation was found for a long time",
    "max-epochs": "the number of epochs was used up",
    "max-time": "the time limit was reached",
    "cancelled": "it was cancelled",
    "known": "the equation was given",
}


def render(result: Result, how: str) -> str:
    """Return `result` in a format of `FORMATS` except json, which `Result.to_json` writes.

    Raises:
        UsageError: `how` is not such a format.
    """
    renderers: dict[str, Callable[[Result], str]] = {
        "text": render_text,
        "csv": as_csv,
        "sympy": as_sympy,
        "latex": as_latex,
    }
    if how not in renderers:
        raise UsageError(f"{how!r} is not a format of a result; choose one of {', '.join(FORMATS)}")
    return renderers[how](result)


def pick(result: Result, picks: Mapping[str, int]) -> Result:
    """Return `result` with other members of the fronts selected: by variable, their numbers in the front table.

    The properties of the selected equation come from the front. The reason for the end of the search and its cost
    stay the same. Refinement results for the whole model do not apply to the selected equation and are removed.

    Raises:
        UsageError: a variable or number does not exist.
    """
    known = [equation.variable for equation in result.equations]
    for variable in picks:
        if variable not in known:
            raise UsageError(f"--pick has the equation {variable!r}, but the equations are {', '.join(known)}")
    is_of_group = result.group is not None
    equations = [
        _pick_member(equation, picks[equation.variable], is_of_group) if equation.variable in picks else equation
        for equation in result.equations
    ]
    equations = _complete_given_sides(result, equations, picks)
    groups = tuple(group.model_copy(update={"covariance": None}) for group in result.groups)
    unknown = {"correlations": (), "covariance": None, "shared_terms": (), "simulation": None, "chaos": None}
    return result.model_copy(update={"equations": tuple(equations), "groups": groups, **unknown})


def parse_picks(texts: Sequence[str]) -> dict[str, int]:
    """Return picks from options such as ``x=2``; raises UsageError."""
    picks: dict[str, int] = {}
    for text in texts:
        variable, _, number = text.rpartition("=")
        if not variable or not number.isdecimal():
            raise UsageError(f"--pick must be VARIABLE=NUMBER, such as x=2, but {text!r} was given")
        if variable in picks:
            raise UsageError(f"--pick has the equation {variable!r} twice; pick one member of its front")
        picks[variable] = int(number)
    return picks


def render_text(result: Result, *, fronts: bool = False) -> str:
    """Return the equations as text; with `fronts`, all tables: fronts with numbers to pick, constants, candidates,
    noise and simulations.
    """
    names = result.names
    called = constant_names(result)
    parts = searched_parts(result)
    blocks = [
        _equation_text(
            equation, names, called[equation.variable], fronts, equation.variable in result.hidden,
            parts.get(equation.variable),
        )
        for equation in result.equations
    ]  # fmt: skip
    blocks += [line for one in result.observations for line in observation_lines(one, names)]
    if fronts:
        blocks += [*noise_lines(result), *simulation_table(result), *correlation_lines(result)]
    else:
        blocks += summary(result)
    blocks += _shared_lines(result)
    blocks += process_lines(result)
    blocks += [with_kind(warning, result.notes) for warning in result.warnings]
    cost = f"{_count(result.point_evaluations or 0)} point evaluations in {number_text(result.search_seconds)} s"
    blocks.append(f"{cost} of search, seed {result.seed}")
    return "\n".join(blocks)


_OF_FIT_ONLY: Final = ("program", "simple_together", "units", "verdict", "reason", "prediction", "nats")
_LISTS_OF_FIT_ONLY: Final = ("groups", "implied", "bounds", "candidates", "checks")
"""Fields that belong to the fitted equation, and not to a member of its front."""


def _pick_member(equation: Equation, number: int, is_of_group: bool) -> Equation:
    front = equation.front
    if not 0 <= number < len(front):
        advice = f"choose a number from 0 to {len(front) - 1}" if front else "the front is empty"
        raise UsageError(f"--pick {equation.variable}={number} is not on the front; {advice}")
    member = front[number]
    error, most = member.normalized_error, equation.target_error
    taken = ("expression", "complexity", "error", "normalized_error", "r2", "constants")
    return equation.model_copy(
        update={
            **{key: getattr(member, key) for key in taken},
            "origin": "known" if equation.why == "known" else "front",
            "converged": error is not None and most is not None and error <= most,
            "front": tuple(candidate.model_copy(update={"selected": candidate is member}) for candidate in front),
            "is_of_all_groups": is_of_group or bool(equation.groups) or equation.is_of_all_groups,
            **dict.fromkeys(_OF_FIT_ONLY),
            **dict.fromkeys(_LISTS_OF_FIT_ONLY, ()),
        }
    )


def _complete_given_sides(result: Result, equations: Sequence[Equation], picks: Mapping[str, int]) -> list[Equation]:
    """Return equations in which the picked members of given sides, which are unknown parts, stand in their sides.

    An unknown part that occurs in several sides changes in all of them. Parameters keep their values. A side without an
    unknown part of its own has nothing to pick.
    """
    sides = GivenSides.of(result)
    slots, homes = [*sides.slots], set[int]()
    for place, equation in enumerate(equations):
        unknown = sides.template.unknown_of(equation.variable) if equation.variable in picks else None
        if unknown is not None:
            slots[place] = from_infix(equation.expression or "", result.names)
            homes.add(place)
    picked = sides.with_slots(slots)
    changed = []
    for place, (equation, before) in enumerate(zip(equations, result.equations, strict=True)):
        if not sides.is_given(place):
            changed.append(equation)
        elif any(source.home in homes for source in sides.composition.sources(place)) or place in homes:
            emptied = equation.model_copy(update=dict.fromkeys(_OF_FIT_ONLY) | dict.fromkeys(_LISTS_OF_FIT_ONLY, ()))
            changed.append(picked.describe(emptied, place, before.constants))
        else:
            changed.append(before)
    return changed


def _shared_lines(result: Result) -> list[str]:
    """Return a line for each flux, and for each other term with a function that several equations have in common."""
    names = result.names
    sides = {equation.variable: equation.lhs for equation in result.equations}
    lines = []
    for shared in result.shared_terms:
        multiples = {variable: count for variable, count in (shared.multiples or {}).items() if count is not None}
        if multiples:
            variable = next(iter(multiples))
            rate = abs((shared.factors[variable] or 0.0) / multiples[variable])
            times = ", ".join(f"{multiples[name]:+.6g} in {sides[name]}" for name in multiples)
            flux = rounded(f"{rate!r}*({shared.term})", names)
            lines.append(f"flux: {flux}, {times}")
        elif shared.has_function:
            within = ", ".join(sides[variable] for variable in shared.factors)
            lines.append(f"shared: {rounded(shared.term, names)} in {within}")
    return lines


def _equation_text(
    equation: Equation, names: Sequence[str], called: Sequence[str], with_tables: bool, is_hidden: bool,
    unknown: str | None,
) -> str:  # fmt: skip
    if equation.expression is None:
        return f"{equation.lhs} = ?\n    no equation found yet"
    lines = [f"{equation.lhs} = {side_text(equation, names)}" + ("  (hidden state)" if is_hidden else "")]
    if equation.runs:
        lines = [f"{equation.variable}: a parameter by run", *(f"    {line}" for line in run_lines(equation))]
    given = given_words(equation, names)
    constants = None if with_tables else constants_line(given.constants)
    lines += [f"    {line}" for line in given_lines(given)]
    if not given.text and (with_tables or constants):
        lines += _written_out(equation, names)
    lines += [f"    {constants}"] if constants else []
    lines += ["    its constants are fitted to all groups together"] if equation.is_of_all_groups else []
    lines += units_line(equation.units)
    texts = [side_text(group, names, is_given=bool(given.text)) for group in equation.groups]
    lines += groups_table(equation, texts, called)
    if equation.verdict is not None:
        lines.append(f"    {equation.verdict}: {equation.reason}")
        lines += checks_lines(equation.checks, is_listed=with_tables)
    if not (equation.runs or (is_hidden and equation.why == "known")):  # a hidden state has no target
        lines.append(f"    {_standing(equation)}")
    most = None if with_tables else NEAREST
    if with_tables:
        lines += constants_table(equation.constants, called if given.text else [])
        lines += together_line(equation.simple_together)
    if with_tables or equation.verdict != "exact":
        listed = candidates_table(
            equation.candidates, lambda text: rounded(text, names, is_given=bool(given.text)), most
        )
        lines += listed
        lines += ["    constants of candidates are fitted to all groups together"] if listed and texts else []
    if with_tables:
        lines += [*_front_lines(equation.front, names, f"expression of {unknown}" if unknown else "expression"), ""]
    return "\n".join(lines)


def observation_lines(one: Observation, names: Sequence[str]) -> list[str]:
    """Return a measured column that is computed from states, as the user wrote it too, and its parameters."""
    parameters = given_words(one, names).parameters
    return [observation_text(one, names), *(f"    {name} = {_words_text(words)}" for name, words in parameters.items())]


def run_lines(equation: Equation) -> list[str]:
    """Return a line for each value of a parameter that differs by run."""
    pairs = zip(run_names(equation), equation.runs, strict=True)
    remarks = {True: " (held out, fitted to this run)", False: ""}
    return [f"{name} = {_words_text(words_of_run(one))}{remarks[bool(one.held_out)]}" for name, one in pairs]


def given_lines(given: GivenWords) -> list[str]:
    """Return the side as the user wrote it, the values of its parameters, and its unknown parts.

    Nothing is returned for a side that was found.
    """
    values = [f"{name} = {_words_text(words)}" for name, words in given.parameters.items()]
    parts = [f"{label} = {text}" for label, text in given.unknowns.items()]
    return [f"given: {given.text}", *values, *parts] if given.text else []


def _written_out(equation: Equation, names: Sequence[str]) -> list[str]:
    """Return the expression with its constants as numbers, if the displayed one has others, such as 1/4 for 4."""
    text = equation.expression or ""
    program = from_infix(text, names)
    as_shown = replace(program, constants=np.array([float(f"{value:.{DIGITS}g}") for value in program.constants]))
    seen = {float(number) for number in _NUMBER.findall(rounded(text, names))}
    values = [constant.value for constant in equation.constants if constant.value is not None]
    known = {abs(float(f"{value:.{DIGITS}g}")) for value in values}
    return [] if known <= seen | {1.0} else [f"    written out: {to_infix(as_shown, names)}"]


def _standing(equation: Equation) -> str:
    if equation.why == "known":
        return f"known: error {number_text(equation.normalized_error)} of the target's standard deviation"
    outcome = "converged: " if equation.converged else "not converged: "
    if (
        equation.converged and equation.verdict == "no model"
    ):  # the fit to derivatives has converged, but the equation does not describe the measurements
        outcome = ""
    text = f"{outcome}error {number_text(equation.normalized_error)} of the target's standard deviation"
    text += f", size {equation.complexity}, epoch {equation.epoch}"
    if not equation.converged and equation.why not in (None, "target"):  # "target": another member met it
        text += f"; {ENDS.get(equation.why, equation.why)}"
    return text


def _front_lines(front: Sequence[Member], names: Sequence[str], head: str) -> list[str]:
    is_held_out = any(member.holdout_error is not None for member in front)
    held_out = f" {'held out':>10}" if is_held_out else ""
    lines = [f"    {'pick':>4}   {'size':>4} {'error':>10}{held_out} {'R2':>9}  {head}"]
    for number, member in enumerate(front):
        mark = "*" if member.selected else " "
        unseen = f" {number_text(_held_out_error(member)):>10}" if is_held_out else ""
        figures = f"{member.complexity:>4} {number_text(member.normalized_error):>10}{unseen}"
        r2 = None if member.r2 is None else round(member.r2, 6)
        figures += f" {number_text(r2, 6):>9}"
        lines.append(f"    {number:>4} {mark} {figures}  {rounded(member.expression, names)}")
    return lines


def _held_out_error(member: Member) -> float | None:
    """Return the error on held-out rows, relative to the standard deviation of the target on the rows of the search."""
    unseen, error, normalized = member.holdout_error, member.error, member.normalized_error
    return unseen * normalized / error if unseen is not None and error and normalized else None


def _count(value: int) -> str:
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.3g}{unit}"
    return str(value)
