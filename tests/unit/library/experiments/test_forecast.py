"""Forecasts: known posteriors, coverage, horizons, inputs, alternative systems, processes."""

import csv
import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll.api.model import Model
from atoll.experiments.draws import draw_constants
from atoll.experiments.fits import fit_displayed, measured_of
from atoll.experiments.forecast import Forecast, ForecastRequest, forecast
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import measured
from tests.unit.library.experiments.test_smoothing import LINE, TIMES, line, posterior_of_line
from tests.unit.library.model.results import process_result, result

PREY = {"x": "1.0*x-0.5*x*y", "y": "0.4*x*y-0.8*y"}


def prey(t: np.ndarray) -> np.ndarray:
    """Return the states (2, n) of the true law of `PREY`."""

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [x[0] - 0.5 * x[0] * x[1], 0.4 * x[0] * x[1] - 0.8 * x[1]]

    return solve_ivp(rates, (0.0, float(t[-1])), [1.5, 1.0], t_eval=t, rtol=1e-10, atol=1e-12).y


def prey_result(seed: int, noise: float = 0.1) -> Result:
    t = np.linspace(0.0, 10.0, 60)
    x, y = prey(t) + noise * np.random.default_rng(seed).standard_normal((2, 60))
    return Result.of(measured(PREY, [(t, {"x": x, "y": y})], noise))


def test_a_linear_law_has_its_known_posterior() -> None:
    found = forecast(line(), ForecastRequest(4.0, step=1.0, draws=20_000))
    assert found.t.tolist() == [4.0, 5.0, 6.0, 7.0, 8.0]
    values, errors = posterior_of_line(found.t)
    assert found["x"] == pytest.approx(values, abs=0.01)
    for level, reach in ((0.95, 2.024), (0.5, 0.681)):  # Student's t, 38 degrees of freedom
        lower, upper = found.band("x", level)
        assert 0.5 * (upper - lower) == pytest.approx(reach * errors, rel=0.05)
    assert found.systems[0].rows == 40
    assert found.noise["x"] == pytest.approx(0.1, rel=0.3)


def test_bands_cover_the_truth_about_as_often_as_they_say() -> None:
    t = np.array([10.0, 14.0, 18.0])
    truth, covered = prey(np.concatenate([[0.0], t]))[:, 1:], []
    for seed in range(25):
        found = forecast(prey_result(seed), ForecastRequest(8.0, step=4.0, draws=400))
        bands = np.array([found.band(state) for state in found.states])
        covered.append((bands[:, 0] <= truth) & (truth <= bands[:, 1]))
    assert 0.85 <= np.mean(covered) <= 1.0


def test_equal_seeds_give_equal_bits() -> None:
    request = ForecastRequest(3.0, draws=50, seed=4)
    first, second = (forecast(prey_result(1), request) for _ in range(2))
    assert first.draws.tobytes() == second.draws.tobytes()
    assert first.draws.tobytes() != forecast(prey_result(1), replace(request, seed=5)).draws.tobytes()


def test_newer_rows_move_the_state_and_not_the_constants() -> None:
    t = np.linspace(30.0, 31.0, 10)
    found = Model(line()).forecast(2.0, data={"t": t, "x": 9.0 + 0.5 * t}, step=1.0)
    assert found.t.tolist() == [31.0, 32.0, 33.0]
    slope = np.diff(posterior_of_line(np.array([0.0, 1.0]))[0])
    assert np.diff(found["x"]) == pytest.approx([*slope, *slope], abs=0.01)
    assert found["x"][0] == pytest.approx(24.5, abs=0.1)


def test_a_window_ends_where_the_law_has_failed() -> None:
    """The first half of the trajectory has another slope; the last rows alone tell the last state."""
    x = np.where(TIMES < 2.0, 10.0 - 5.0 * TIMES, LINE)
    found = Model(line()).forecast(1.0, data={"t": TIMES, "x": x})
    assert found.systems[0].since >= 1.9
    assert found["x"][0] == pytest.approx(3.0, abs=0.15)


def of(lower: list[float], upper: list[float], **changes: Any) -> Forecast:
    """Return a forecast of x with two draws, the ends of its band, at times 0, 1, …"""
    draws = np.array([lower, upper])[:, :, None]
    measured = {"x": np.array([0.0, 4.0])}
    own = {"measured_range": np.array([[0.0, 4.0]]), "noise": {}, **changes}
    return Forecast(("x",), np.arange(float(len(lower))), draws, (), "1", np.array([-1.0, 0.0]), measured, **own)


@pytest.mark.parametrize(
    ("lower", "upper", "horizon"),
    [
        ([1.0, 1.0, 1.0, 1.0], [1.1, 2.0, 2.9, 3.1], 2.0),
        ([1.0, 1.0, 1.0], [1.1, 1.2, 1.3], None),
        ([1.0, 10.0, 100.0], [1.1, 15.0, 160.0], None),  # it grows far beyond the measured range of 4
        ([0.0, 0.0], [3.0, 3.0], 0.0),
        ([1.0, 1.0, np.nan], [1.1, 1.1, 1.1], 1.0),  # a draw blows up
    ],
)
def test_the_horizon_ends_where_the_band_is_half_as_wide_as_the_measured_range(
    lower: list[float], upper: list[float], horizon: float | None
) -> None:
    found = of(lower, upper)
    assert found.horizon == horizon
    assert found.horizons == {"x": horizon}
    assert ("to its end" in str(found)) == (horizon is None)


def test_a_chaotic_law_has_a_horizon() -> None:
    t = np.linspace(0.0, 10.0, 250)

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]]

    states = solve_ivp(rates, (0.0, 22.0), [-8.0, 8.0, 27.0], t_eval=[*t, 11.0], rtol=1e-10, atol=1e-12).y
    noisy = states[:, :-1] + 0.3 * np.random.default_rng(0).standard_normal((3, 250))
    law = {"x": "10.0*y-10.0*x", "y": "x*(28.0-z)-y", "z": "x*y-2.667*z"}
    found = forecast(
        Result.of(measured(law, [(t, dict(zip("xyz", noisy, strict=True)))], 0.3)),
        ForecastRequest(12.0, step=0.5, draws=200),
    )
    assert found.horizon is not None
    assert 1.0 < found.horizon < 10.0
    at = found.t.tolist().index(11.0)
    for place, state in enumerate(found.states):
        lower, upper = found.band(state)
        assert lower[at] <= states[place, -1] <= upper[at]


def test_inputs_keep_their_last_value_unless_they_are_given() -> None:
    u = np.where(TIMES < 2.0, 0.0, 1.0)
    x = np.where(TIMES < 2.0, 0.0, 1.0 - np.exp(2.0 - TIMES))
    contents = measured(
        {"x": "1.0*u-1.0*x"}, [(TIMES, {"x": x + 0.02 * (LINE - 1.0 - 0.5 * TIMES), "u": u})], 0.01, ("u",)
    )
    contents["system"]["input_kinds"] = {"u": "held"}
    contents["data"]["trajectories"][0]["input_slopes"] = {"u": [None] * 40}
    model = Model(contents)
    kept = model.forecast(10.0)
    assert kept["x"][-1] == pytest.approx(1.0, abs=0.02)
    assert "the input u keeps its last value, 1" in str(kept)
    given = model.forecast(10.0, {"u": 3.0})
    assert given["x"][-1] == pytest.approx(3.0, abs=0.06)
    assert "keeps" not in str(given)
    switched = model.forecast(10.0, {"u": np.where(np.linspace(4.0, 14.0, 201) < 9.0, 3.0, 0.0)})
    assert switched["x"][100] == pytest.approx(3.0 - (3.0 - kept["x"][0]) * np.exp(-5.0), abs=0.06)
    assert switched["x"][-1] == pytest.approx(3.0 * np.exp(-5.0), abs=0.03)
    with pytest.raises(UsageError, match="no input 'v'"):
        model.forecast(10.0, {"v": 1.0})


def test_alternative_systems_have_their_share_of_the_draws() -> None:
    """The rows do not decide between decay and a straight line, which differ in the forecast."""
    t = np.linspace(0.0, 0.5, 20)
    x = 2.0 * np.exp(-0.5 * t) + 0.1 * np.random.default_rng(1).standard_normal(20)
    contents = measured({"x": "-0.5*x"}, [(t, {"x": x})], 0.1)
    other = {"expression": "-0.9", "complexity": 1, "nats": 1.0, "origin": "library", "selected": False}
    contents["equations"][0]["candidates"] = [other]
    result = Result.of(contents)
    found = forecast(result, ForecastRequest(4.0))
    assert len(found.systems) == 2
    assert sum(system.weight for system in found.systems) == pytest.approx(1.0)
    assert "alternative system has" in str(found)
    alone = forecast(result, ForecastRequest(4.0, has_rivals=False))
    assert len(alone.systems) == 1
    widths = [float(np.diff(each.band("x"), axis=0)[0, -1]) for each in (found, alone)]
    assert widths[0] > widths[1]


def test_a_population_that_has_vanished_in_the_noise_stays_positive() -> None:
    x = 2.0 * np.exp(-2.0 * TIMES) + 0.05 * np.random.default_rng(3).standard_normal(40)
    found = forecast(Result.of(measured({"x": "-2.0*x"}, [(TIMES, {"x": x})], 0.05)), ForecastRequest(2.0))
    assert found.draws.min() > 0.0


def test_draws_agree_with_the_data_where_constants_are_badly_determined() -> None:
    """x/(k + x) is nearly 1 along the data: a normal draw of k would make the denominator 0."""
    t = np.linspace(0.0, 1.0, 30)
    x = 5.0 - t + 0.05 * np.random.default_rng(2).standard_normal(30)
    fitted = fit_displayed(
        measured_of(Result.of(measured({"x": "-1.1*x/(0.5+x)"}, [(t, {"x": x})], 0.05))),
        Result.of(measured({"x": "-1.1*x/(0.5+x)"}, [(t, {"x": x})], 0.05)),
    )
    constants, _ = draw_constants(fitted, 300, np.random.default_rng(0))
    assert len(np.unique(constants, axis=0)) > 100
    rates = [fitted.fit.system.with_values(row) for row in constants]
    for system in rates:
        start = np.array([5.0])
        assert isinstance(fitted.fit.estimator.simulate(system, start), np.ndarray)


def test_a_process_is_forecast_by_its_paths() -> None:
    contents = process_result() | {"config": {"data": {"stochastic": True, "missing": "drop"}}}
    times, noise = 0.1 * np.arange(141.0), np.random.default_rng(3).standard_normal(141)
    x = 1.0 + 0.2 * noise
    x[-2:] = 1.9, np.nan
    found = Model(contents).forecast(20.0, data={"t": times, "x": x}, draws=2_000, step=1.0)
    assert found.t[0] == pytest.approx(13.9)
    assert found.draws[:, 0, 0].tolist() == [1.9] * 2_000
    lower, upper = found.band("x")
    assert found["x"][-1] == pytest.approx(1.0, abs=0.05)
    assert 0.5 * (upper - lower)[-1] == pytest.approx(1.96 * np.sqrt(0.25 / 2.0), rel=0.1)  # dx = (1 - x) dt + 0.5 dW


def test_a_process_needs_data() -> None:
    with pytest.raises(UsageError, match="has no measurements; give them as data"):
        Model(process_result()).forecast(1.0)


def test_a_forecast_of_any_finite_duration_ends() -> None:
    assert forecast(line(), ForecastRequest(1e308, draws=2)).t[-1] == pytest.approx(1e308)


def test_tables_have_the_median_and_both_bands() -> None:
    found = forecast(line(), ForecastRequest(4.0, step=2.0, draws=100))
    rows = [*csv.reader(io.StringIO(found.to_csv()))]
    assert rows[0] == ["t", "x", "x_lower", "x_upper", "x_lower50", "x_upper50"]
    listed: Any = found.as_dict()
    assert listed["columns"]["x"] == found["x"].tolist()
    assert listed["systems"][0]["weight"] == 1.0
    assert of([1.0, np.nan], [np.nan, np.nan]).as_dict()["columns"]["x_lower"] == [None, None]  # type: ignore[index]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"duration": 0.0}, "the duration of a forecast must be above 0"),
        ({"step": -1.0}, "the time step must be above 0"),
        ({"step": 9.0}, "the time step 9 is longer than the forecast"),
        ({"draws": 1}, "2 or more draws"),
        ({"step": 1e-7}, "give a larger time step or fewer draws"),
        ({"trajectory": "2"}, "there is no trajectory '2'; the trajectories are 1"),
    ],
)
def test_requests_that_do_not_fit_are_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        forecast(line(), replace(ForecastRequest(2.0), **changes))


def test_what_has_no_future_is_refused() -> None:
    with pytest.raises(UsageError, match="the result has no measurements"):
        forecast(Result.of(result({"x": "-x"})), ForecastRequest(1.0))
