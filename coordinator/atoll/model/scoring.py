"""How well a model describes data that it may not have seen: R2."""

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from atoll.model.arguments import Columns, column, has, has_columns, read_columns, rows_of, stacked
from atoll.model.simulation import SimulationWarning
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.quoting import shown

if TYPE_CHECKING:
    from atoll.model.model import Model


def score(model: "Model", data: Columns | Sequence[Columns]) -> float:
    """Return R2 on data; see `atoll.Model.score`."""
    given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
    parts = [read_columns(model, part) for part in given if has_columns(part)]
    if not given or len(parts) < len(given):
        raise UsageError(f"a score takes columns by name, a frame or a list of these, but {shown(data)} was given")
    return _of_regression(model, parts) if model.is_regression else _of_dynamics(model, parts)


def _of_regression(model: "Model", parts: Sequence[Columns]) -> float:
    target = model.result.equations[0].variable
    both = [stacked([column(part, target), model.predict(part)]) for part in parts]
    return _r2(*np.concatenate(both, axis=1))


def _of_dynamics(model: "Model", parts: Sequence[Columns]) -> float:
    columns = model.result.columns_by_symbol
    states = [name for name in model.states if all(has(part, columns[name]) for part in parts)]
    if not states:
        names = ", ".join(columns[name] for name in model.states)
        raise UsageError(f"the data have none of the columns {names} in every part; give a measured state")
    simulated, measured = [], []
    for part in parts:
        times, _, start = rows_of(model, part)
        inputs = {name: column(part, columns[name]) for name in model.inputs}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SimulationWarning)
            simulation = model.simulate(start, times, inputs or None, has_bands=False)
        if simulation.status != "finished":
            return -np.inf
        simulated.append(stacked([simulation[name] for name in states]))
        measured.append(stacked([column(part, columns[name]) for name in states]))
    pairs = zip(np.concatenate(measured, axis=1), np.concatenate(simulated, axis=1), strict=True)
    return float(np.mean([_r2(rows, values) for rows, values in pairs]))


def _r2(measured: FloatArray, values: FloatArray) -> float:
    known = np.isfinite(measured)
    left = float(((measured - values)[known] ** 2).sum())
    spread = float(((measured[known] - measured[known].mean()) ** 2).sum())
    return 1.0 - left / spread if spread > 0.0 else (1.0 if left == 0.0 else -np.inf)
