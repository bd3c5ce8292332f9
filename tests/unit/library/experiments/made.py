"""Results with measurements, as small as what is asked of experiments needs them."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.unit.library.model.results import constant, given_entries, result, with_given

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


COMPARTMENTS: Final = {"c": "-k10*c - k12*c + k21*p", "p": "k12*c - k21*p"}
"""A drug that is eliminated from the first of two compartments; both amounts are hidden."""
RATES: Final = {"k10": 0.3, "k12": 0.5, "k21": 0.25}
VOLUME: Final = 2.0


def drug_course(times: FloatArray, dose: float = 10.0) -> FloatArray:
    """Return the amounts c and p (2, n) of the two compartments, from a dose at the first time."""
    rates = np.array([[-0.8, 0.25], [0.5, -0.25]])
    values, vectors = np.linalg.eig(rates)
    shares = np.linalg.solve(vectors, [dose, 0.0])
    return np.asarray((vectors * shares) @ np.exp(np.outer(values, times - times[0])))


def two_compartments(
    sides: Mapping[str, str] = MappingProxyType(COMPARTMENTS), values: Mapping[str, float] = MappingProxyType(RATES), *,
    noise: float = 0.02, bounds: Mapping[str, Any] = MappingProxyType({}),
    dose: Mapping[str, float] = MappingProxyType({"start": 10.0}),
) -> dict[str, Any]:  # fmt: skip
    """Return a result whose states are hidden; the column y = c/V was measured, with V = 2.

    Args:
        sides: the given sides, of c and perhaps of other hidden states.
        values: values of their parameters.
        noise: standard deviation of the errors of y.
        bounds: bounds of parameters.
        dose: the initial value of c, as in the configuration of a job.
    """
    times = np.linspace(0.5, 20.0, 60)
    states = drug_course(times)
    measured_y = states[0] / VOLUME + np.random.default_rng(4).normal(0.0, noise, len(times))
    entries = given_entries(dict(sides), {}, dict(values), dict(bounds))
    contents = with_given(measured(dict.fromkeys(sides, "1"), [(times, dict.fromkeys(sides, times))], noise), entries)
    (recorded,) = contents["data"]["trajectories"]
    recorded["measured"] = {"y": measured_y.tolist()}
    contents["system"] |= {"states": ["y"]}
    contents["noise"] = {"y": {"sd": noise, "relative": noise, "method": "loess"}}
    contents["hidden"] = [*sides]
    program = from_infix(f"c/{VOLUME + 0.1}", tuple(sides))
    volume = constant(VOLUME + 0.1, 0.01) | {"bounds": bounds.get("V")}
    contents["observations"] = [
        {
            "column": "y",
            "expression": to_infix(program, tuple(sides)),
            "program": program.to_bytes().hex(),
            "constants": [volume],
            "given": {"text": "c/V", "parameters": {"V": 0}, "unknowns": []},
        }
    ]
    initial = {name: {"start": 0.0} for name in sides} | {"c": dict(dose)}
    contents["config"] = {
        "data": {"hidden": [*sides], "observe": {"y": "c/V"}},
        "prior": {"equations": dict(sides), "initial": initial},
    }
    course = dict(zip(("c", "p"), np.round(states, 6).tolist(), strict=True)) | {"y": (states[0] / VOLUME).tolist()}
    known = {name: course[name] for name in ("y", *sides)}
    start = {name: course[name][0] for name in sides}
    contents["simulation"] = {
        "trajectories": [
            {
                "name": "1", "held_out": False, "r2": {"y": 0.999}, "offsets": {}, "start": start,
                "times": times.tolist(), "measured": {"y": measured_y.tolist()}, "values": known,
                "lower": known, "upper": known,
            }
        ]
    }  # fmt: skip
    return contents
