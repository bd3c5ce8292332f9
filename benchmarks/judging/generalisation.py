"""Does a model foretell what was not measured? All its equations are solved together from fresh initial conditions."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression import operators
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.solving import DivergedError, solve
from benchmarks.noise.data import Path

GOOD_R2: Final = 0.9
"""A variable is foretold when its R² exceeds this."""

MAX_EVALUATIONS: Final = 50_000
LIMIT: Final = 1e8
"""States beyond this are a model that has run away."""

STEP: Final = 0.25
"""Largest step of the solver: a jump must not be stepped over."""

_FORMS: Final = {
    operators.ADD: "{0} + {1}",
    operators.SUBTRACT: "{0} - {1}",
    operators.MULTIPLY: "{0} * {1}",
    operators.DIVIDE: "{0} / {1}",
    operators.POW: "pow({0}, {1})",
    operators.SIN: "sin({0})",
    operators.COS: "cos({0})",
    operators.EXP: "exp({0})",
    operators.LOG: "log({0})",
    operators.SQRT: "sqrt({0})",
    operators.ABS: "abs({0})",
    operators.TANH: "tanh({0})",
    operators.INVERSE: "1.0 / {0}",
    operators.SQUARE: "{0} * {0}",
    operators.NEGATE: "-{0}",
}
_NAMES: Final = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "tanh", "pow")}


Field = Callable[[Sequence[float]], list[float]]


def field_of(expressions: Sequence[str], names: Sequence[str]) -> Field:
    """Return the function from the values of `names` to those of `expressions`, as plain Python: one row at a time.

    Raises UsageError where a text is no expression over `names`.
    """
    lines: list[str] = ["def slopes(values):"]
    results: list[str] = []
    for number, text in enumerate(expressions):
        program = from_infix(text, names)
        columns = (program.operators, program.left, program.right, program.constants)
        for index, (code, left, right, value) in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            arguments = (f"e{number}_{left}", f"e{number}_{right}")
            if code == operators.VARIABLE:
                form = f"values[{left}]"
            else:
                form = repr(value) if code == operators.CONSTANT else _FORMS[code].format(*arguments)
            lines.append(f"    e{number}_{index} = {form}")
        results.append(f"e{number}_{len(program) - 1}")
    lines.append(f"    return [{', '.join(results)}]")
    space: dict[str, Any] = {**_NAMES, "abs": abs, "inf": math.inf, "nan": math.nan}
    exec("\n".join(lines), space)  # made of operator codes and numbers only
    slopes: Field = space["slopes"]
    return slopes


def simulated(field: Field, path: Path, max_evaluations: int = MAX_EVALUATIONS) -> FloatArray | None:
    """Return the states (n, S) that `field` gives at the times of `path`, from where that begins.

    None when the solution does not reach the end: it runs away, or takes more than `max_evaluations`.
    """
    begin = float(path.times[0])
    try:
        return solve(
            lambda state: field(state.tolist()), path.states[0], path.times, limit=LIMIT, begin=begin,
            most_evaluations=max_evaluations, method="LSODA", rtol=1e-8, atol=1e-10, max_step=STEP,
        )  # fmt: skip
    except DivergedError:
        return None


def foretold(expressions: Mapping[str, str | None], paths: Sequence[Path]) -> dict[str, float]:
    """Return R² of each state over all `paths`: 1 - squared errors / squares about the mean of all rows.

    `expressions` are right-hand sides by state, in the order of the states, None where there is no equation; R² is -inf
    where a path cannot be solved.
    """
    texts = [text for text in expressions.values() if text]
    try:
        field = field_of(texts, tuple(expressions))
    except UsageError:  # too long to be read back
        return dict.fromkeys(expressions, -math.inf)
    solutions = [simulated(field, path) for path in paths] if len(texts) == len(expressions) else [None]
    if any(states is None for states in solutions):
        return dict.fromkeys(expressions, -math.inf)
    pairs = [(states, path.states) for states, path in zip(solutions, paths, strict=True) if states is not None]
    return dict(zip(expressions, r_squared(pairs), strict=True))


def r_squared(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> list[float]:
    """Return R² of each state over pairs (n, S) of predicted and true states: about the mean of all true rows."""
    mean = sum(true.sum(axis=0) for _, true in pairs) / sum(len(true) for _, true in pairs)
    errors = sum(((states - true) ** 2).sum(axis=0) for states, true in pairs)
    spread = sum(((true - mean) ** 2).sum(axis=0) for _, true in pairs)
    shares: list[float] = (1.0 - errors / np.maximum(spread, 1e-300)).tolist()
    return shares


def is_foretold(r2: float | None) -> bool:
    """Tell whether an R² counts as foretold."""
    return r2 is not None and r2 > GOOD_R2
