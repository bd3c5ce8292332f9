"""Pictures of states with their bands, as SVG files: smoothed states and forecasts."""

from collections.abc import Sequence

import numpy as np

from atoll.display.curves import SHOWN, label
from atoll.experiments.forecast import Forecast
from atoll.experiments.smoothing import SmoothedStates
from atoll.report.markup import Axis, Chart, Number
from atoll.report.page import stacked_picture
from atoll_coordinator.model.thinning import spread_places
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray

_MOST_POINTS = 1_000
"""Most points of a curve in a picture: more than its pixels."""


def picture_of_states(smoothed: SmoothedStates, result: Result) -> str:
    """Return the states along at most `SHOWN` trajectories with their 95 % bands, one chart below another."""
    charts = []
    for place, state in enumerate(smoothed.states):
        drawn = _over_time(f"{state} under the law", state, result)
        for index, part in enumerate(smoothed.trajectories[:SHOWN]):
            rows = spread_places(len(part.t), _MOST_POINTS)
            times, style = _numbers(part.t[rows]), f"c{index}"
            drawn.add_band(times, _numbers(part.lower[rows, place]), _numbers(part.upper[rows, place]), style)
            if state in part.measured:
                drawn.add_points(times, _numbers(part.measured[state][rows]), f"small {style}")
            for piece in np.unique(part.piece[rows]).tolist():
                own = [row for row in rows if part.piece[row] == piece]
                drawn.add_line(_numbers(part.t[own]), _numbers(part.x[own, place]), style)
        charts.append(drawn)
    return stacked_picture(charts)


def picture_of_forecast(forecast: Forecast, result: Result) -> str:
    """Return the forecast of each state with its bands after the measurements, one chart below another."""
    charts = []
    times = _numbers(forecast.t)
    for state in forecast.states:
        drawn = _over_time(f"forecast of {state}", state, result)
        for level in (0.95, 0.5):
            lower, upper = forecast.band(state, level)
            drawn.add_band(times, _numbers(lower), _numbers(upper), "c1")
        drawn.add_line(times, _numbers(forecast[state]), "c1")
        if state in forecast.measured:
            rows = spread_places(len(forecast.measured_t), _MOST_POINTS)
            past = _numbers(forecast.measured_t[rows])
            drawn.add_points(past, _numbers(forecast.measured[state][rows]), "small c0")
        horizon = forecast.horizons[state]
        if horizon is not None:
            at, ends = float(forecast.t[0]) + horizon, drawn.range_of_values
            drawn.add_line([at, at], ends, "rule")
        charts.append(drawn)
    return stacked_picture(charts)


def _over_time(title: str, state: str, result: Result) -> Chart:
    column = result.columns_by_symbol.get(state, state)
    return Chart(title, Axis(label(result, result.time)), Axis(label(result, column)))


def _numbers(values: FloatArray) -> Sequence[Number]:
    return [value if abs(value) < 1e300 else None for value in values.tolist()]
