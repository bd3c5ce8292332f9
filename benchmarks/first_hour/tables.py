"""What is measured: closed forms, exact solutions, and processes that obey no law of their own columns.

Every function returns columns (R,) by plain name, times first; what is random comes from the seed given.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.data.dataset import FloatArray

Columns = dict[str, FloatArray]
Rates = Callable[[float, FloatArray], Sequence[float]]

RUNNING = 0.02
"""Step of the simulated processes that have delays, impacts or switches."""


def grid(rows: int, step: float) -> FloatArray:
    """Return `rows` times from 0 on, `step` apart."""
    return step * np.arange(rows, dtype=np.float64)


def turning(rows_a_period: float, rows: int = 200) -> Columns:
    """Return x = cos t and v = -sin t, so many rows a period."""
    times = grid(rows, 2.0 * math.pi / rows_a_period)
    return {"t": times, "x": np.cos(times), "v": -np.sin(times)}


def closed(times: FloatArray, **forms: Callable[[FloatArray], FloatArray]) -> Columns:
    """Return functions of time."""
    return {"t": times, **{name: np.asarray(form(times), dtype=np.float64) for name, form in forms.items()}}


def solved(rates: Rates, names: str, start: Sequence[float], times: FloatArray) -> Columns:
    """Return the solution of differential equations, to eleven digits; `names` has one letter for each state."""
    solution = solve_ivp(rates, (times[0], times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-13)
    return {"t": times, **dict(zip(names, solution.y, strict=True))}


def noisy(columns: Columns, share: float, seed: int) -> Columns:
    """Return the same with normal errors of `share` of each deviation, the times as they are."""
    draw = np.random.default_rng(seed)
    return {
        name: values if name == "t" else values + share * values.std() * draw.standard_normal(len(values))
        for name, values in columns.items()
    }


def scaled(columns: Columns, **factors: float) -> Columns:
    """Return the same in other units."""
    return {name: values * factors.get(name, 1.0) for name, values in columns.items()}


def joined(columns: Columns, **others: FloatArray) -> Columns:
    """Return the same beside `others`."""
    return {**columns, **{name: np.asarray(values, dtype=np.float64) for name, values in others.items()}}


def without(columns: Columns, name: str) -> Columns:
    """Return the same without one of them."""
    return {other: values for other, values in columns.items() if other != name}


def drawn(rows: int, seed: int, **kinds: str) -> Columns:
    """Return columns that are drawn row by row: see `_drawn`."""
    draw = np.random.default_rng(seed)
    return {"t": grid(rows, 0.1), **{name: _drawn(draw, rows, kind) for name, kind in kinds.items()}}


def _drawn(draw: np.random.Generator, rows: int, kind: str) -> FloatArray:
    if kind == "uniform":
        return draw.uniform(-3.0, 3.0, rows)
    if kind == "dice":
        return draw.integers(1, 7, rows).astype(np.float64)
    if kind == "counts":
        return draw.poisson(4.0, rows).astype(np.float64)
    white = draw.standard_normal(rows)
    if kind == "white":
        return white
    if kind == "red":
        return _iterated(lambda state, shock: 0.9 * state + shock, 0.0, white)
    walk = np.cumsum(white)
    return walk if kind == "walk" else np.exp(0.05 * walk)


def _iterated(step: Callable[[float, float], float], start: float, drive: FloatArray) -> FloatArray:
    states = [start]
    for shock in drive.tolist()[1:]:
        states.append(step(states[-1], shock))
    return np.array(states)


def mapped(step: Callable[[float], float], start: float, rows: int = 200) -> Columns:
    """Return what comes of applying a map again and again, one row a time."""
    return {"t": grid(rows, 1.0), "x": _iterated(lambda state, _: step(state), start, np.zeros(rows))}


def delayed(rates: Callable[[float, float], float], delay: float, rows: int, step: float, start: float) -> Columns:
    """Return x where dx/dt = rates(x, x before `delay`), by Heun's method with a fine step."""
    fine, every = RUNNING / 2.0, round(2.0 * step / RUNNING)
    back = round(delay / fine)
    states = [start] * (back + 1)
    for _ in range(rows * every):
        x, past, next_past = states[-1], states[-1 - back], states[-back]
        slope = rates(x, past)
        states.append(x + 0.5 * fine * (slope + rates(x + fine * slope, next_past)))
    return {"t": grid(rows, step), "x": np.array(states[back::every][:rows])}


def bouncing(rows: int, step: float) -> Columns:
    """Return height and velocity of a ball that loses a tenth of its speed at each bounce, exactly."""
    heights, speeds = [], []
    begun, height, speed = 0.0, 1.0, 0.0
    for time in grid(rows, step).tolist():
        while True:
            until = (speed + math.sqrt(speed * speed + 2.0 * 9.81 * height)) / 9.81
            if time - begun < until:
                break
            begun, height, speed = begun + until, 0.0, 0.9 * (9.81 * until - speed)
        since = time - begun
        heights.append(height + speed * since - 4.905 * since * since)
        speeds.append(speed - 9.81 * since)
    return {"t": grid(rows, step), "h": np.array(heights), "v": np.array(speeds)}


def heated(rows: int, step: float) -> Columns:
    """Return the temperature of a room whose heater switches at 19 and 21 degrees, and whether it is on."""
    temperature, on = 15.0, 1.0
    temperatures, heater = [], []
    every = round(step / RUNNING)
    for row in range(rows * every):
        if row % every == 0:
            temperatures.append(temperature)
            heater.append(on)
        on = 1.0 if temperature < 19.0 else 0.0 if temperature > 21.0 else on
        rest = 10.0 + 20.0 * on  # where it tends to
        temperature = rest + (temperature - rest) * math.exp(-0.2 * RUNNING)
    return {"t": grid(rows, step), "T": np.array(temperatures), "u": np.array(heater)}


def csv_of(columns: Mapping[str, FloatArray], header: Mapping[str, str]) -> str:
    """Return the text of a CSV file; whole numbers are written as such. `header` has other names for some columns."""
    names = ",".join(_quoted(header.get(name, name)) for name in columns)
    cells = [_cells(values) for values in columns.values()]
    return "\n".join([names, *map(",".join, zip(*cells, strict=True))]) + "\n"


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def _cells(values: FloatArray) -> list[str]:
    if np.all(values == np.rint(values)) and np.all(np.abs(values) < 1e15):
        return [str(int(value)) for value in values.tolist()]
    return [repr(value) for value in values.tolist()]
