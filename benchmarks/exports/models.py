"""The published equations as models with an initial state, times, and constants that have errors."""

from typing import Any

import numpy as np

from atoll.api.model import Model
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import SYSTEMS, drawn


def published(system: str, seed: int = 1, until: float = 10.0, rows: int = 101) -> Model:
    """Return the model of one of `SYSTEMS`, beginning where a solution stays finite for so long."""
    chosen = SYSTEMS[system]
    times = np.linspace(0.0, until, rows)
    start = drawn(chosen, np.random.default_rng(seed), times)[0]
    simulated = {"name": "1", "start": dict(zip(chosen.states, start.tolist(), strict=True)), "times": times.tolist()}
    return Model(
        {
            "schema": 1,
            "job": system,
            "seed": seed,
            "digest": "",
            "equations": [_equation(name, text, chosen.states) for name, text in chosen.truth.items()],
            "symbols": {name: name for name in chosen.states},
            "system": {"time": "t", "units": {}, "ranges": {}},
            "simulation": {"trajectories": [simulated]},
        }
    )


def _equation(name: str, text: str, names: tuple[str, ...]) -> dict[str, Any]:
    program = from_infix(text, names)
    values = program.constants[constant_places(program)].tolist()
    shown = {"variable": name, "lhs": f"d{name}/dt", "expression": text, "candidates": [], "front": []}
    return {**shown, "constants": [_constant(value) for value in values], "verdict": "exact", "reason": "As published."}


def _constant(value: float) -> dict[str, Any]:
    """Return a constant known to a hundredth, so that it is a parameter in every format."""
    error = 0.01 * abs(value)
    bounds = [value - 2.0 * error, value + 2.0 * error]
    return {"value": value, "fitted": value, "std_error": error, "interval": bounds, "identifiable": True}
