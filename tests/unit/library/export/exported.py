"""Models to be exported, and what runs their text here."""

from typing import Any

import numpy as np

from atoll.api.model import Model
from atoll_core.data.dataset import FloatArray
from tests.unit.library.model.results import constant, result

TIMES = np.linspace(0.0, 2.0, 9)


def model(
    equations: dict[str, str], start: dict[str, float] | None = None, inputs: tuple[str, ...] = (), **changes: Any
) -> Model:
    """Return the model dx/dt = expression, beginning at `start` (all 1 unless given) over `TIMES`."""
    contents = result(equations, inputs, **changes)
    contents["simulation"] = {
        "trajectories": [{"name": "1", "start": start or dict.fromkeys(equations, 1.0), "times": TIMES.tolist()}]
    }
    return Model(contents)


def everything() -> Model:
    """Return a model that has every operator, and names that languages refuse."""
    equations = {
        "lambda": "-0.5*x_1*exp(-abs(lambda_))/sqrt(1.0 + lambda_**2) + tanh(lambda_ - 0.25)",
        "θ": "sin(θ)*cos(lambda_) - tan(0.1*θ) + cot(θ + 1.5)/8 - θ**3/7",
        "x 1": "log(2.0 + x_1**2) - 1/(3 + x_1**2) - (-x_1)**2 + x_1**2.5/9 - 1.25e-07*until - (x_1 - θ)*0.1",
        "until": "-(until - x_1)**5 - 0.1234567890123456*until",
    }
    symbols = {"lambda": "lambda_", "θ": "θ", "x 1": "x_1", "until": "until"}
    texts = [*equations.values()]
    contents = result(dict(zip(symbols.values(), texts, strict=True)))
    for column, equation in zip(symbols, contents["equations"], strict=True):
        equation |= {"variable": column, "lhs": f"d{column}/dt"}
    contents["symbols"] = symbols
    contents["simulation"] = {
        "trajectories": [{"name": "1", "start": dict.fromkeys(symbols, 1.0), "times": TIMES.tolist()}]
    }
    return Model(contents)


def decay() -> Model:
    """Return dx/dt = -0.3 u x + u, the constant known to 0.1, with the input u."""
    contents = model({"x": "-0.3*u*x + u"}, inputs=("u",)).result.as_dict()
    contents["equations"][0]["constants"] = [constant(-0.3, 0.1)]
    return Model(contents)


def process() -> Model:
    """Return two states whose noises go together."""
    contents = result({"x": "-x", "y": "x - y"})
    part = contents["equations"][0]
    for name, text in (("[x]", "0.04"), ("[y]", "0.09 + 0.01*x**2"), ("[x,y]", "0.03*y")):
        contents["equations"].append({**part, "variable": name, "lhs": f"d{name}/dt", "expression": text})
    ensemble = {"times": TIMES.tolist(), "mean": {"x": [1.0], "y": [0.5]}}
    return Model({**contents, "process": {"step": 0.1, "ensemble": ensemble}})


def run_python(text: str) -> dict[str, Any]:
    """Return what a module of Python defines."""
    names: dict[str, Any] = {"__name__": "exported"}
    exec(compile(text, "exported.py", "exec"), names)
    return names


def difference(contents: FloatArray, of: Model, **given: Any) -> float:
    """Return how far states are from the simulation, over the largest of them."""
    expected = of.simulate(**given, has_bands=False).x
    return float(np.abs(contents - expected).max() / np.abs(expected).max())
