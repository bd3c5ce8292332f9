"""What Operon makes of our estimates of the derivatives, as equations that the same judges read.

Operon (B. Burlacu, G. Kronberger, M. Kommenda, *Operon C++*, GECCO 2020) is used by the regressor that pyoperon brings
along, with two objectives (R2 and length), our default operators and those that the truth needs, five
Levenberg-Marquardt steps for each offspring, two threads, and its other settings as they are; each equation has
`EVALUATIONS`, about ten processor seconds. Of its front the model with the least description length is taken, by
Operon's own criterion with the uncertainty of our derivatives as the error. The offset that its scaling always adds is
left out where it is smaller than two standard errors or than single precision, in which Operon computes. It needs the
extra ``bench``.
"""

import ast
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS, JobConfig
from atoll_core.data.dataset import FloatArray, Target
from atoll_core.data.table import Table
from benchmarks.peers.operon import FIT_STEPS, THREADS

OPERON: Final = "operon"
EVALUATIONS: Final = 500_000
"""Of residuals and Jacobians over all rows; a number rather than seconds, of which a busy machine gives it few."""

SYMBOLS: Final = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "sin": "sin", "cos": "cos", "exp": "exp", "log": "log",
    "sqrt": "sqrt", "pow": "pow",
}  # fmt: skip
"""Our operators in Operon's words."""

LEAST_ERROR: Final = float(np.finfo(np.float32).eps)
"""Of a derivative over its deviation: Operon computes in single precision."""

_DIGITS: Final = 9
_ENDLESS: Final = 10**9


def solve(table: Table, operators: Sequence[str], seed: int, config: JobConfig = PRESETS["default"]) -> dict[str, Any]:
    """Return Operon's equations in the form of a result.json; ``front`` has the others of its front.

    Raises DataError where the derivatives of `table` cannot be estimated.
    """
    begun = time.perf_counter()
    dataset = prepare(table, config).dataset
    symbols = ",".join(("constant", "variable", *(SYMBOLS[operator] for operator in operators)))
    equations = [_equation(dataset.inputs.T, target, dataset.names, symbols, seed) for target in dataset.targets]
    return {"equations": equations, "seconds": time.perf_counter() - begun, "warnings": []}


def _equation(inputs: FloatArray, target: Target, names: Sequence[str], symbols: str, seed: int) -> dict[str, Any]:
    from pyoperon.sklearn import SymbolicRegressor

    deviation = float(target.standard_deviation)
    regressor = SymbolicRegressor(
        allowed_symbols=symbols,
        objectives=["r2", "length"],
        optimizer_iterations=FIT_STEPS,
        generations=_ENDLESS,
        max_evaluations=EVALUATIONS,
        epsilon=0.0,
        uncertainty=[deviation * max(target.uncertainty, LEAST_ERROR)],
        n_threads=THREADS,
        random_state=seed,
    )
    regressor.fit(inputs, target.values)
    front = sorted(regressor.pareto_front_, key=_length)
    texts = [
        _without_offset(regressor.get_model_string(model["tree"], _DIGITS, list(names)), model, deviation, len(inputs))
        for model in front
        if math.isfinite(_length(model))
    ]
    return {
        "variable": target.variable,
        "lhs": target.lhs,
        "expression": texts[0] if texts else None,
        "front": [{"expression": text} for text in texts],
    }


def _length(model: Mapping[str, Any]) -> float:
    length = float(model["minimum_description_length"])
    return length if math.isfinite(length) else math.inf


def _without_offset(text: str, model: Mapping[str, Any], deviation: float, rows: int) -> str:
    least = max(2.0 * math.sqrt(model["mean_squared_error"] / rows), LEAST_ERROR * deviation)
    return without_small_offset(text.replace("^", "**"), least)


def without_small_offset(text: str, least: float) -> str:
    """Return an expression without the number in front of a sum if that is below `least` in size."""
    match ast.parse(text, mode="eval").body:
        case ast.BinOp(offset, ast.Add(), rest) if _is_below(offset, least):
            return ast.unparse(rest)
    return text


def _is_below(node: ast.expr, least: float) -> bool:
    match node:
        case ast.UnaryOp(ast.USub(), operand):
            return _is_below(operand, least)
        case ast.Constant(float(value)):
            return abs(value) < least
    return False
