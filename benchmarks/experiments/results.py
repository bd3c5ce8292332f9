"""Results as a job would give them, of equations that are known and measurements that are simulated: no search."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from atoll_coordinator.result.result import Result
from atoll_core.expression.text.parsing import from_infix

FloatArray = npt.NDArray[np.float64]
Course = tuple[FloatArray, FloatArray]
"""Times (n,) and measured states (n, D)."""


def result_of(
    equations: Mapping[str, str],
    courses: Sequence[Course],
    errors: Sequence[float],
    starts: Sequence[Sequence[float]] = (),
) -> Result:
    """Return the result that shows these equations (right-hand sides by state), measured with errors of known size.

    `starts` are initial states that fits begin with; the measured ones unless given.
    """
    states = [*equations]
    begun = [
        {"name": str(number), "start": dict(zip(states, map(float, start), strict=True))}
        for number, start in enumerate(starts, start=1)
    ]
    content = {
        "schema": 1,
        "equations": [_equation(name, text, states) for name, text in equations.items()],
        "symbols": {name: name for name in states},
        "system": {"kind": "dynamics", "order": 1, "time": "t", "states": states, "velocities": [], "inputs": []},
        "simulation": {"trajectories": begun},
        "noise": {
            name: {"sd": error, "relative": error, "method": "loess"}
            for name, error in zip(states, errors, strict=True)
        },
        "data": {"trajectories": [_trajectory(number, *each, states) for number, each in enumerate(courses, start=1)]},
    }
    return Result.of(content)


def _equation(name: str, text: str, states: Sequence[str]) -> dict[str, Any]:
    program = from_infix(text, states).to_bytes().hex()
    return {"variable": name, "lhs": f"d{name}/dt", "expression": text, "program": program, "candidates": []}


def _trajectory(number: int, times: FloatArray, values: FloatArray, states: Sequence[str]) -> dict[str, Any]:
    return {
        "name": str(number),
        "held_out": False,
        "rows": len(times),
        "times": times.tolist(),
        "measured": {name: column.tolist() for name, column in zip(states, values.T, strict=True)},
        "inputs": {},
        "input_slopes": {},
        "weights": None,
        "robustness_weights": None,
    }
