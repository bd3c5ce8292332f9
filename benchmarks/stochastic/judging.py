"""What was found of a process beside the truth: form and error of each equation, intervals of its constants."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import constant_places, with_constants
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import make_coefficients_explicit
from benchmarks.judging.coverage import covered
from benchmarks.judging.forms import compare
from benchmarks.stochastic.processes import Process

ANY_CONSTANT: Final = 0.99
"""Relative difference of coefficients within one form: the form is asked for, the constants by their intervals."""


@dataclass(frozen=True)
class Judged:
    """One equation of one search.

    `is_right` tells whether it has the truth's terms and no others; `error` is the root mean square difference of both
    on the measured rows over the root mean square of the truth. `is_covered` tells of each constant, factors of one
    that are not written among them, whether its interval holds the truth; empty where the form is not the truth's.
    """

    case: str
    seed: int
    equation: str
    found: str | None
    verdict: str | None
    is_right: bool
    error: float
    is_covered: tuple[bool, ...]


def judge(
    case: str, process: Process, seed: int, states: FloatArray, equations: Sequence[Mapping[str, Any]]
) -> list[Judged]:
    """Return what is to be said of each component of the truth, and of each one that it does not have.

    Errors are measured at `states` (S, R); `equations` are those of a result, by paths of this `seed`.
    """
    shown = {equation["variable"]: equation for equation in equations}
    columns = dict(zip(process.names, states, strict=True))
    judged = []
    for name in dict.fromkeys([*process.truth, *shown]):
        truth = process.truth.get(name, "0")
        equation = shown.get(name)
        if equation is None or equation["expression"] is None:
            judged.append(Judged(case, seed, name, None, None, False, 1.0, ()))
            continue
        text, verdict = equation["expression"], equation["verdict"]
        if truth == "0":
            is_right = not process.values(text, states).any()
            judged.append(Judged(case, seed, name, text, verdict, is_right, 0.0, ()))
            continue
        values = process.values(truth, states)
        rms = float(np.sqrt(np.mean(values * values)))
        away = process.values(text, states) - values
        is_right = compare(text, truth, columns, ANY_CONSTANT).is_right
        is_covered = _covered(equation, process.names, columns, values) if is_right else ()
        error = float(np.sqrt(np.mean(away * away))) / rms
        judged.append(Judged(case, seed, name, text, verdict, is_right, error, is_covered))
    return judged


def _covered(
    equation: Mapping[str, Any], names: Sequence[str], columns: Mapping[str, FloatArray], truth: FloatArray
) -> tuple[bool, ...]:
    """Return of each constant whether its interval holds the truth; factors of one that are not written count as well.

    All constants are written out with their estimates, so that each is told from the others by its value.
    """
    explicit = make_coefficients_explicit(from_infix(equation["expression"], names))
    implied, known = iter(equation["implied"]), equation["constants"]
    constants = [next(implied) if origin is None else known[origin] for origin in explicit.origins]
    fitted = [{**constant, "value": constant["fitted"]} for constant in constants]
    values = {
        place: constant["value"] for place, constant in zip(constant_places(explicit.program), fitted, strict=True)
    }
    text = to_infix(with_constants(explicit.program, values), names)
    judged = covered(text, fitted, columns, truth)
    return () if judged is None else tuple(constant.is_covered for constant in judged)
