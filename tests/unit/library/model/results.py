"""Results as small as a model needs them."""

from typing import Any

from atoll_core.expression.text.parsing import from_infix


def result(equations: dict[str, str], inputs: tuple[str, ...] = (), **changes: Any) -> dict[str, Any]:
    """Return the content of a result.json: dx/dt = expression for each of `equations`."""
    names = [*equations, *inputs]
    entries = [
        {
            "variable": name,
            "lhs": f"d{name}/dt",
            "expression": text,
            "program": from_infix(text, names).to_bytes().hex(),
            "complexity": 5,
            "constants": [],
            "candidates": [],
            "front": [],
            "verdict": "good",
            "reason": "It fits & more.",
        }
        for name, text in equations.items()
    ]
    return {
        "schema": 1,
        "job": "j",
        "seed": 7,
        "equations": entries,
        "symbols": {name: name for name in names},
        "system": {"time": "t", "units": {}, "ranges": {name: [0.0, 1.0] for name in names}},
        "data": {"digest": "ab", "files": ["a.csv"], "rows": 3},
        "simulation": None,
        "covariance": None,
        "digest": "cd",
        **changes,
    }


def constant(value: float, error: float) -> dict[str, Any]:
    """Return a constant with its standard error, as a result has it."""
    bounds = [value - 2.0 * error, value + 2.0 * error]
    return {"value": value, "std_error": error, "fitted": value, "interval": bounds, "identifiable": True}


def process_result(drift: str = "1-x", diffusion: str = "0.25", inputs: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the content of the result.json of a process of one state that was measured in steps of 0.1 from 2."""
    contents = result({"x": drift, "[x]": diffusion}, inputs)
    del contents["symbols"]["[x]"]
    ensemble = {"trajectory": "1", "times": [0.0, 0.5], "mean": {"x": [2.0, 1.6]}}
    return contents | {"process": {"step": 0.1, "ensemble": ensemble}}
