"""Summarise a result in plain sentences, for readers who do not know the terms of the field."""

from collections.abc import Sequence
from typing import Final

from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.result import Result
from atoll_core.quoting import enumerated

_MEANINGS: Final = {
    "exact": "The data exclude all other equations: {it} reproduce{s} all digits of the data",
    "good": "Within the measured range, predictions of {it} can be trusted",
    "doubtful": "Do not rely on predictions of {it} yet: another equation may be right",
    "no model": "Do not use {it}: no equation was found that describes the data",
}
_MOST_NAMES: Final = 4
_TIMES: Final = {
    "ms": "millisecond", "s": "second", "sec": "second", "min": "minute", "h": "hour", "hr": "hour", "d": "day",
    "wk": "week", "a": "year", "yr": "year",
}  # fmt: skip
_CALENDAR: Final = ("second", "minute", "hour", "day", "week", "month", "quarter", "year")


def conclusion(result: Result) -> str:
    """Return one paragraph about the data, the search, the equations that were found, and how far to trust them."""
    found = [equation for equation in result.equations if equation.expression is not None]
    if not found:
        return f"Atoll searched{_source(result)} for {_aim(result)}, and found none."
    meaning = _trust(result.equations)
    return f"Atoll searched{_source(result)} for {_aim(result)}. {_explain(result, found[0])}{meaning}"


def _aim(result: Result) -> str:
    variables = [equation.variable for equation in result.equations]
    if result.kind == "regression":
        return f"a formula that gives {variables[0]} from {enumerated(result.names, _MOST_NAMES)}"
    states = result.columns.states or variables
    noise = " and how large its noise is" if result.process else ""
    if len(states) == 1:
        return f"an equation that describes how fast {states[0]} changes{noise}"
    return f"equations that describe how fast {enumerated(states, _MOST_NAMES)} change{noise.replace('its', 'their')}"


def _source(result: Result) -> str:
    data = result.data
    if data is None or not data.rows:
        return ""
    files = f" of {enumerated(data.files, _MOST_NAMES)}" if data.files else ""
    return f" in {data.rows:,} rows{files}"


def _explain(result: Result, equation: Equation) -> str:
    """Explain a left-hand side; "" for a formula without time."""
    lhs, variable, time = equation.lhs, equation.variable, result.time
    if lhs == f"d{variable}/d{time}":
        return f"{lhs} is the change of {variable} per {_time_unit(result)}. "
    if lhs == f"d2{variable}/d{time}2":
        return f"{lhs} is the acceleration of {variable}: the change of its rate per {_time_unit(result)}. "
    return ""


def _time_unit(result: Result) -> str:
    """Return the unit of time in words: the unit of its column, or the name of the column."""
    unit = result.units.get(result.time)
    if unit:
        return _TIMES.get(unit, unit)
    name = result.time.lower().removesuffix("s")
    return name if name in _CALENDAR else f"unit of {result.time}"


def _trust(equations: Sequence[Equation]) -> str:
    """Return the meaning of the verdicts, the worst verdict first; "" without verdicts."""
    sentences = []
    for verdict in ("no model", "doubtful", "good", "exact"):
        named = [equation.lhs for equation in equations if equation.verdict == verdict]
        if named:
            is_one = len(named) == 1
            it = f"the equation of {named[0]}" if is_one else f"the equations of {enumerated(named, _MOST_NAMES)}"
            if len(named) == len(equations):
                it = "this equation" if is_one else "these equations"
            sentences.append(_MEANINGS[verdict].format(it=it, s="s" if is_one else ""))
    return "".join(f"{sentence}. " for sentence in sentences).rstrip()
