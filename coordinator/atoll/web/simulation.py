"""What pages draw of a model along what was measured: curves of trajectories, and fitted values. Pure."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from atoll.display.curves import chosen, curves_of, label
from atoll.model.arguments import initial_conditions
from atoll.model.model import Model
from atoll.model.simulation import Simulation
from atoll.web.progress import some
from atoll_coordinator.result.base import Number
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.errors import AtollError

MOST_ROWS: Final = 1_000
"""Rows of columns, and measured points of a picture, at most."""


def simulation_of(result: Result) -> dict[str, Any]:
    """Return a simulation as columns, and the curves of trajectories beside what was measured.

    Of a regression there are fitted values; nothing, with a sentence, of what is no model.
    """
    answer: dict[str, Any] = {"time": result.time, "columns": {}, "trajectories": [], "fitted": None, "message": ""}
    try:
        model = Model(result)
        if model.is_regression:
            return answer | {"fitted": _fitted_values(model)}
        parts = chosen(result.simulated)
        simulation = None if model.groups else model.simulate(has_bands=False)
        if not parts and simulation is not None:
            parts = [_part(model, simulation)]
    except AtollError as error:
        return answer | {"message": str(error)}
    labels = {name: label(result, name) for name in (result.time, *result.columns.states)}
    answer |= {"labels": labels, "trajectories": [_trajectory(model, part) for part in parts]}
    answer["trajectories_in_total"] = max(len(parts), len(result.simulated))
    if simulation is not None:
        rows = some(len(simulation.t), MOST_ROWS)
        columns = {name: _numbers(values[rows].tolist()) for name, values in simulation.columns().items()}
        answer |= {"columns": columns, "message": simulation.message}
    return answer


def _part(model: Model, simulation: Simulation) -> Simulated:
    """Return the simulation of an equation that was picked, from the first measured state, as a result lists it."""
    beginning, names = initial_conditions(model), model.result.columns_by_symbol
    recorded = next((part for part in model.result.recorded if part.name == beginning.name), None)
    rows = range(len(simulation.t))
    is_same = recorded is not None and len(recorded.times) == len(rows)
    columns = {names[state]: tuple(simulation[state].tolist()) for state in simulation.states}
    return Simulated(
        name=beginning.name or "1",
        times=tuple(simulation.t.tolist()),
        values={name: curve for name, curve in columns.items() if name in model.result.columns.states},
        start=dict(beginning.start),
        measured=dict(recorded.measured) if recorded is not None and is_same else {},
    )


def _trajectory(model: Model, part: Simulated) -> Mapping[str, Any]:
    curves, rows = curves_of(model, part), some(len(part.times), MOST_ROWS)
    bounds = [{name: _numbers(curve) for name, curve in side.items()} if side else None
              for side in (curves.lower, curves.upper)]  # fmt: skip
    return {
        "name": part.name,
        "held_out": part.held_out,
        "pieces": curves.pieces,
        "times": _numbers(curves.times, 12),
        "values": {name: _numbers(curve) for name, curve in curves.values.items()},
        "lower": bounds[0],
        "upper": bounds[1],
        "measured_times": _numbers((part.times[row] for row in rows), 12) if part.measured else [],
        "measured": {name: _numbers(curve[row] for row in rows) for name, curve in part.measured.items()},
    }


def _fitted_values(model: Model) -> Mapping[str, Any] | None:
    """Return measured and fitted values of a regression; None where the result has none."""
    known = model.result.regression
    if known is None or not known.measured:
        return None
    rows = some(len(known.measured), MOST_ROWS)
    variables = {name: np.array([values[row] for row in rows], dtype=float) for name, values in known.variables.items()}
    return {
        "target": model.result.columns.target,
        "measured": _numbers(known.measured[row] for row in rows),
        "fitted": _numbers(model.predict(variables).tolist()),
    }


def _numbers(values: Iterable[Number], digits: int = 6) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if value is not None and math.isfinite(value) else None for value in values]
