"""Results with measurements, as small as what is asked of experiments needs them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from atoll_core.data.dataset import FloatArray
from tests.unit.library.model.results import result

Course = tuple[FloatArray, Mapping[str, FloatArray]]
"""Times (n,), and columns (n,) by name."""


def measured(
    equations: dict[str, str], courses: Sequence[Course], noise: float, inputs: tuple[str, ...] = (), **changes: Any
) -> dict[str, Any]:
    """Return a result whose states were measured along `courses` with errors of standard deviation `noise`."""
    entries = [
        {
            "name": str(number),
            "held_out": False,
            "rows": len(times),
            "times": times.tolist(),
            "measured": {name: columns[name].tolist() for name in equations},
            "inputs": {name: columns[name].tolist() for name in inputs},
            "input_slopes": {name: np.gradient(columns[name], times).tolist() for name in inputs},
            "weights": None,
            "robustness_weights": None,
        }
        for number, (times, columns) in enumerate(courses, start=1)
    ]
    system = {
        "kind": "dynamics", "order": 1, "time": "t", "states": [*equations], "velocities": [], "inputs": [*inputs],
        "target": None, "units": {}, "ranges": {},
    }  # fmt: skip
    known = {name: {"sd": noise, "relative": noise, "method": "loess"} for name in equations}
    rows = sum(len(times) for times, _ in courses)
    data = {"digest": "ab", "files": ["a.csv"], "rows": rows, "trajectories": entries}
    return result(equations, inputs, system=system, noise=known, data=data, **changes)
