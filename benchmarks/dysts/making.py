"""Trajectories and true equations of chaotic flows from the ``dysts`` package, one NPZ file for each.

The protocol of Kaptanoglu et al. (Nonlinear Dynamics 2023, arXiv 2302.10787): five training and five test trajectories
from different points of the attractor, 1000 points each, 100 for each dominant period. The module needs ``dysts``,
scipy and sympy, and nothing of Atoll: it runs in an environment of its own.
"""

import importlib
import types
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

_NAMES: Final = [line.split(",") for line in Path(__file__).with_name("flows.csv").read_text("utf-8").split()[1:]]
POLYNOMIAL: Final = tuple(name for name, kind in _NAMES if kind == "polynomial")
"""The 70 flows of the published table."""

OTHERS: Final = tuple(name for name, kind in _NAMES if kind == "other")
"""Autonomous flows beyond the table; nearly all are not polynomial."""

TRAJECTORIES: Final = 5
POINTS: Final = 1000
POINTS_PER_PERIOD: Final = 100
_REFERENCE_PERIODS: Final = 33
"""Length of the trajectory whose points are initial conditions."""

_TOLERANCE: Final = 1e-12
_MOST_CALLS: Final = 400_000
"""Evaluations of the right sides after which a flow is taken for stiff."""


def make(folder: Path, names: Iterable[str], seed: int, say: Callable[[str], None]) -> None:
    """Write ``NAME.npz`` for each flow into `folder`, unless it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        module = importlib.import_module("dysts.flows")
    except ImportError as error:
        raise SystemExit(f"the package dysts is missing ({error}); pip install dysts sympy") from error
    for name in names:
        path = folder / f"{name}.npz"
        if path.exists():
            continue
        try:
            arrays = _made(module, name, seed)
        except Exception as error:  # one flow that cannot be made does not end the rest
            say(f"{name}: not made ({type(error).__name__}: {error})")
            continue
        np.savez_compressed(path, **arrays)
        say(f"{name}: {arrays['train'].shape}, {'; '.join(arrays['equations'])[:120]}")


def _made(module: Any, name: str, seed: int) -> dict[str, Any]:
    flow = getattr(module, name)()
    states = (
        tuple("xyzw"[: flow.dimension]) if flow.dimension <= 4 else tuple(f"x{i + 1}" for i in range(flow.dimension))
    )
    times = np.linspace(0.0, flow.period * POINTS / POINTS_PER_PERIOD, POINTS)
    generator = np.random.default_rng(np.random.SeedSequence([seed, *name.encode()]))
    reference = _integrated(flow, np.asarray(flow.ic, float), np.linspace(0.0, _REFERENCE_PERIODS * flow.period, 1000))
    chosen = generator.choice(len(reference), 2 * TRAJECTORIES, replace=False)
    values = np.array([_integrated(flow, reference[row], times) for row in chosen])
    rates = np.array([[np.asarray(flow.rhs(point, 0.0), float) for point in path] for path in values])
    return {
        "times": times,
        "train": values[:TRAJECTORIES],
        "test": values[TRAJECTORIES:],
        "train_rates": rates[:TRAJECTORIES],
        "test_rates": rates[TRAJECTORIES:],
        "states": np.array(states),
        "equations": np.array(_equations(module, flow, states)),
        "parameters": np.array([f"{key} = {value!r}" for key, value in flow.params.items()]),
        "period": np.array(flow.period),
        "lyapunov": np.array(flow.maximum_lyapunov_estimated or np.nan, float),
    }


def _integrated(flow: Any, start: Any, times: Any) -> Any:
    """Return the states (R, D) at `times`, by an explicit method, or an implicit one if that takes too long."""
    from scipy.integrate import solve_ivp

    calls = 0

    def rates(time: float, state: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > _MOST_CALLS:
            raise _TooManyCallsError
        return np.asarray(flow.rhs(state, time), float)

    scale = float(np.abs(start).max()) or 1.0
    for method in ("DOP853", "Radau"):
        calls = 0
        try:
            options = {"rtol": _TOLERANCE, "atol": _TOLERANCE * scale}
            solution = solve_ivp(rates, (times[0], times[-1]), start, method, times, **options)
        except _TooManyCallsError:
            continue
        if solution.success and np.isfinite(solution.y).all():
            return solution.y.T
    raise ValueError("it could not be integrated")


class _TooManyCallsError(Exception):
    pass


def _equations(module: Any, flow: Any, states: Sequence[str]) -> list[str]:
    """Return the right sides as text, parameters as numbers; empty where there is no such text."""
    import sympy

    symbols = [sympy.Symbol(state, real=True) for state in states]
    numpy = module.np
    module.np = _symbolic(numpy, sympy)
    try:
        rates = flow.rhs(np.array(symbols, dtype=object), sympy.Symbol("t", real=True))
        return [str(sympy.sympify(rate)) for rate in rates]
    except (TypeError, AttributeError, ValueError):
        return [""] * len(states)
    finally:
        module.np = numpy


def _symbolic(numpy: Any, sympy: Any) -> types.SimpleNamespace:
    """Return numpy with functions of symbols in place of its own."""

    def lifted(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def apply(value: Any, *_: Any) -> Any:
            if isinstance(value, np.ndarray):
                return np.array([function(symbol) for symbol in value.ravel()], dtype=object).reshape(value.shape)
            return function(value)

        return apply

    names = {key: getattr(numpy, key) for key in dir(numpy) if not key.startswith("__")}
    for key in ("sin", "cos", "tan", "exp", "log", "tanh", "sinh", "cosh", "sqrt", "sign"):
        names[key] = lifted(getattr(sympy, key))
    names["abs"] = lifted(sympy.Abs)
    names["heaviside"] = lifted(lambda value: (1 + sympy.sign(value)) / 2)
    return types.SimpleNamespace(**names)
