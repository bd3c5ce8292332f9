"""Results as a page shows them: of dynamics, a regression, a process."""

from typing import Any

from tests.unit.library.model.results import constant, result

TIMES = [0.0, 0.5, 1.0]


def dynamics(**changes: Any) -> dict[str, Any]:
    """Return the result of two competing species with one trajectory of three rows."""
    contents = result({"x": "x*(3.0 - x - 2.0*y)", "y": "y*(2.0 - x - y)"})
    for content in contents["equations"]:
        content |= {"why": "target", "epoch": 1, "point_evaluations": 1000, "seconds": 0.5, "origin": "front"}
        content |= {"implied": [], "convergence": [{"island": 0, "generations": [3, 10], "errors": [0.5, 1e-9]}]}
        content["constants"] = [{**constant(3.0, 0.1), "simple": None}]
        content["front"] = [
            {"expression": "x", "complexity": 1, "normalized_error": 0.5, "selected": False},
            {"expression": content["expression"], "complexity": 8, "normalized_error": 1e-9, "selected": True},
        ]
        content["candidates"] = [
            {"expression": "x - y", "complexity": 3, "nats": 2.5, "r2": 0.9, "held_out_r2": None,
             "cross_validated": False, "origin": "library", "selected": False}
        ]  # fmt: skip
    curves = {"x": [1.0, 1.25, None], "y": [3.0, 2.0, 1.5]}
    part = {
        "name": "1",
        "times": TIMES,
        "values": curves,
        "lower": curves,
        "upper": curves,
        "r2": {"x": 0.99, "y": 0.5},
    }
    part |= {
        "measured": {"x": [1.0, 1.5, 2.0], "y": [3.0, 2.0, None]},
        "held_out": False,
        "start": {"x": 1.0, "y": 3.0},
    }
    contents["simulation"] = {"trajectories": [part]}
    contents["system"] |= {"states": ["x", "y"], "inputs": [], "target": None}
    noise = {"sd": 0.1, "relative": 0.05, "method": "loess", "span": 7, "degree": 4}
    contents["noise"] = {name: {**noise, "errors": {"sd": 0.25}} for name in ("x", "y")}
    return {**contents, **changes}


def regression() -> dict[str, Any]:
    """Return the result of y = 2 x."""
    contents = dynamics(simulation=None, noise={})
    equation = {**contents["equations"][0], "variable": "y", "lhs": "y", "expression": "2.0*x", "convergence": []}
    contents["system"] |= {"states": [], "target": "y", "time": None}
    contents["system"]["ranges"] = {"x": [0.0, 2.0]}
    rows = {"variables": {"x": [0.0, 2.0, 1.0]}, "measured": [0.5, 4.0, 2.0], "fitted": [0.0, 4.0, 2.0]}
    return {**contents, "equations": [equation], "regression": {"rows": 3, "listed": 3, **rows}}


def process() -> dict[str, Any]:
    """Return the result of a stochastic process."""
    bands = {name: {"x": [0.0, 0.5, 0.5]} for name in ("mean", "lower", "upper")}
    density = {"edges": [0.0, 1.0, 2.0], "density": [0.25, 0.75], "measured": [0.5, 0.5], "overlap": 0.75}
    process = {"steps": 100, "step": 0.5, "log_likelihood": 1.5, "stationary": {"x": density}}
    process["ensemble"] = {"times": TIMES, "finite_paths": 256, **bands}
    return dynamics(process=process, simulation=None)
