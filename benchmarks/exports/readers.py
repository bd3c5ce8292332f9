"""Little readers of text formats: initial values, constants and rates, to be integrated here.

They know what the exports write, comments aside, and no more of each language.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.data.dataset import FloatArray

TOLERANCE: Final = 1e-12

_FUNCTIONS: Final = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "cot": lambda x: 1.0 / np.tan(x),
    "exp": np.exp,
    "log": np.log,
    "ln": np.log,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "tanh": np.tanh,
}


@dataclass(frozen=True)
class Reading:
    """What a file says: numbers by name, the state that it begins with, and rates as expressions by state."""

    numbers: Mapping[str, float]
    start: Mapping[str, float]
    rates: Mapping[str, str]
    time: str

    def simulate(self, times: FloatArray) -> FloatArray:
        """Return the states (N, D) at `times` (N,), in the order of the rates."""
        compiled = [compile(text.replace("^", "**"), name, "eval") for name, text in self.rates.items()]
        start = np.array([self.start[name] for name in self.rates])
        return integrated(lambda t, x: [eval(code, {}, self._names(t, x)) for code in compiled], start, times)

    def _names(self, t: float, x: FloatArray) -> dict[str, Any]:
        return {**_FUNCTIONS, **self.numbers, self.time: t, **dict(zip(self.rates, x, strict=True))}


def integrated(rates: Callable[[float, FloatArray], Any], start: FloatArray, times: FloatArray) -> FloatArray:
    """Return the solution (N, D) of dx/dt = rates(t, x) at `times` (N,), far more accurate than what is compared."""
    least = TOLERANCE * np.where(start == 0.0, np.abs(start).max(), np.abs(start))
    solution = solve_ivp(
        rates, (float(times[0]), float(times[-1])), start, "DOP853", t_eval=times, rtol=TOLERANCE, atol=least
    )
    assert solution.success, solution.message
    return np.ascontiguousarray(solution.y.T)


def read_xppaut(text: str) -> Reading:
    """Read an .ode file."""
    lines = _lines(text, "#")
    return Reading(
        _numbers(lines, r"par (\w+)=(\S+)"), _numbers(lines, r"init (\w+)=(\S+)"), _texts(lines, r"(\w+)'=(.+)"), "t"
    )


def read_modelica(text: str) -> Reading:
    """Read a model without tables."""
    lines = _lines(text, "//")
    return Reading(
        _numbers(lines, r'parameter Real (\w+) = ([^ ;]+)(?: ".*")?;'),
        _numbers(lines, r'Real (\w+)\(start = ([^,]+), fixed = true, nominal = [^)]+\)(?: ".*")?;'),
        _texts(lines, r"der\((\w+)\) = (.+);"),
        "time",
    )


def read_julia(text: str) -> Reading:
    """Read a system without tables and noise."""
    lines = _lines(text, "#")
    return Reading(
        _numbers(lines, r"@parameters (\w+) = (\S+)"),
        _numbers(lines, r"@variables (\w+)\(t\) = (\S+)"),
        _texts(lines, r"D\((\w+)\) ~ (.+?),?"),
        "t",
    )


def _lines(text: str, comment: str) -> list[str]:
    return [line.split(comment)[0].strip() for line in text.splitlines()]


def _texts(lines: list[str], pattern: str) -> dict[str, str]:
    return {match[1]: match[2] for match in (re.fullmatch(pattern, line) for line in lines) if match}


def _numbers(lines: list[str], pattern: str) -> dict[str, float]:
    return {name: float(text) for name, text in _texts(lines, pattern).items()}
