"""A result for people and for other programs: text, CSV, sympy, LaTeX."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll.export.formats import as_csv, as_latex, as_sympy
from atoll.model.equations import DIGITS, constant_names, number_text, rounded
from atoll.text import tables
from atoll.text.process import process_lines
from atoll_coordinator.result.equations import Equation, Member
from atoll_coordinator.result.result import Result
from atoll_core.data.notes import with_kind
from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

FORMATS: Final = ("text", "json", "csv", "sympy", "latex")

_NUMBER: Final = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?")
_ENDS: Final = {
    "target": "the target error was met",
    "law": "laws by regression describe the data up to noise",
    "stagnation": "no better equation was found for long",
    "max-epochs": "the number of epochs was used up",
    "max-time": "the time was used up",
    "cancelled": "it was cancelled",
}


def render(result: Result, how: str) -> str:
    """Return `result` in one of `FORMATS` but json, which needs nothing from here.

    Raises:
        UsageError: `how` is no such format.
    """
    renderers: dict[str, Callable[[Result], str]] = {
        "text": render_text,
        "csv": as_csv,
        "sympy": as_sympy,
        "latex": as_latex,
    }
    if how not in renderers:
        raise UsageError(f"{how!r} is no format of a result; choose one of {', '.join(FORMATS)}")
    return renderers[how](result)


def pick(result: Result, picks: Mapping[str, int]) -> Result:
    """Return `result` with other members of the fronts selected: by variable, the number that the front table shows.

    What belongs to the selected equation is taken from the front; when and at what cost the search ended stays. What
    refining found out of the model as a whole does not belong to the one picked, and goes.

    Raises:
        UsageError: a variable or number does not exist.
    """
    known = [equation.variable for equation in result.equations]
    for variable in picks:
        if variable not in known:
            raise UsageError(f"--pick names the equation {variable!r}, but there are only {', '.join(known)}")
    is_of_group = result.group is not None
    equations = [
        _picked(equation, picks[equation.variable], is_of_group) if equation.variable in picks else equation
        for equation in result.equations
    ]
    groups = tuple(group.model_copy(update={"covariance": None}) for group in result.groups)
    unknown = {"correlations": (), "covariance": None, "shared_terms": (), "simulation": None, "chaos": None}
    return result.model_copy(update={"equations": tuple(equations), "groups": groups, **unknown})


def parse_picks(texts: Sequence[str]) -> dict[str, int]:
    """Return picks from options such as ``x=2``; raises UsageError."""
    picks: dict[str, int] = {}
    for text in texts:
        variable, _, number = text.rpartition("=")
        if not variable or not number.isdecimal():
            raise UsageError(f"--pick wants VARIABLE=NUMBER such as x=2, but got {text!r}")
        if variable in picks:
            raise UsageError(f"--pick names the equation {variable!r} twice; pick one member of its front")
        picks[variable] = int(number)
    return picks


def render_text(result: Result, *, fronts: bool = False) -> str:
    """Return the equations for people, one after another; with `fronts`, all tables: the fronts, with numbers to pick,
    constants, candidates, noise and simulations.
    """
    names = result.names
    called = constant_names(result)
    blocks = [_equation_text(equation, names, called[equation.variable], fronts) for equation in result.equations]
    if fronts:
        blocks += [*tables.noise_lines(result), *tables.simulation_table(result), *tables.correlation_lines(result)]
    else:
        blocks += tables.summary(result)
    blocks += _shared_lines(result)
    blocks += process_lines(result)
    blocks += [with_kind(warning, result.notes) for warning in result.warnings]
    cost = f"{_count(result.point_evaluations or 0)} point evaluations in {number_text(result.search_seconds)} s"
    blocks.append(f"{cost} of search, seed {result.seed}")
    return "\n".join(blocks)


def _picked(equation: Equation, number: int, is_of_group: bool) -> Equation:
    front = equation.front
    if not 0 <= number < len(front):
        there = f"from 0 to {len(front) - 1}" if front else "there are none yet"
        raise UsageError(f"--pick {equation.variable}={number} is not on the front; choose a number {there}")
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
            **dict.fromkeys(("program", "simple_together", "units", "verdict", "reason", "prediction", "nats")),
            **dict.fromkeys(("groups", "implied", "bounds", "candidates", "checks"), ()),
        }
    )


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


def _equation_text(equation: Equation, names: Sequence[str], called: Sequence[str], with_tables: bool) -> str:
    if equation.expression is None:
        return f"{equation.lhs} = ?\n    nothing found yet"
    lines = [f"{equation.lhs} = {rounded(equation.expression, names)}"]
    constants = None if with_tables else tables.constants_line(equation.constants)
    if with_tables or constants:
        lines += _written_out(equation, names)
    lines += [f"    {constants}"] if constants else []
    lines += ["    its constants are of all groups together"] if equation.is_of_all_groups else []
    lines += tables.units_line(equation.units)
    texts = [rounded(group.expression or "", names) for group in equation.groups]
    lines += tables.groups_table(equation, texts, called)
    if equation.verdict is not None:
        lines.append(f"    {equation.verdict}: {equation.reason}")
        lines += tables.checks_lines(equation.checks, is_listed=with_tables)
    lines.append(f"    {_standing(equation)}")
    most = None if with_tables else tables.NEAREST
    if with_tables:
        lines += tables.constants_table(equation.constants)
        lines += tables.together_line(equation.simple_together)
    if with_tables or equation.verdict != "exact":
        listed = tables.candidates_table(equation.candidates, lambda text: rounded(text, names), most)
        lines += listed
        lines += ["    constants of candidates are of all groups together"] if listed and texts else []
    if with_tables:
        lines += [*_front_lines(equation.front, names), ""]
    return "\n".join(lines)


def _written_out(equation: Equation, names: Sequence[str]) -> list[str]:
    """Return the expression with its constants where they are, if the display has other numbers, such as 1/4 for 4."""
    text = equation.expression or ""
    program = from_infix(text, names)
    as_shown = replace(program, constants=np.array([float(f"{value:.{DIGITS}g}") for value in program.constants]))
    seen = {float(number) for number in _NUMBER.findall(rounded(text, names))}
    values = [constant.value for constant in equation.constants if constant.value is not None]
    known = {abs(float(f"{value:.{DIGITS}g}")) for value in values}
    return [] if known <= seen | {1.0} else [f"    written out: {to_infix(as_shown, names)}"]


def _standing(equation: Equation) -> str:
    if equation.why == "known":
        return f"known: error {number_text(equation.normalized_error)} of the target's deviation"
    outcome = "converged: " if equation.converged else "not converged: "
    if equation.converged and equation.verdict == "no model":  # the derivative is met, the measurements not
        outcome = ""
    text = f"{outcome}error {number_text(equation.normalized_error)} of the target's deviation"
    text += f", size {equation.complexity}, epoch {equation.epoch}"
    if not equation.converged and equation.why not in (None, "target"):  # "target": another member met it
        text += f"; {_ENDS.get(equation.why, equation.why)}"
    return text


def _front_lines(front: Sequence[Member], names: Sequence[str]) -> list[str]:
    is_held_out = any(member.holdout_error is not None for member in front)
    beside = f" {'held out':>10}" if is_held_out else ""
    lines = [f"    {'pick':>4}   {'size':>4} {'error':>10}{beside} {'R2':>9}  expression"]
    for number, member in enumerate(front):
        mark = "*" if member.selected else " "
        unseen = f" {number_text(_unseen(member)):>10}" if is_held_out else ""
        figures = f"{member.complexity:>4} {number_text(member.normalized_error):>10}{unseen}"
        r2 = None if member.r2 is None else round(member.r2, 6)
        figures += f" {number_text(r2, 6):>9}"
        lines.append(f"    {number:>4} {mark} {figures}  {rounded(member.expression, names)}")
    return lines


def _unseen(member: Member) -> float | None:
    """Return the error on held-out rows, over the deviation of the target on the rows of the search."""
    unseen, error, normalized = member.holdout_error, member.error, member.normalized_error
    return unseen * normalized / error if unseen is not None and error and normalized else None


def _count(value: int) -> str:
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.3g}{unit}"
    return str(value)
