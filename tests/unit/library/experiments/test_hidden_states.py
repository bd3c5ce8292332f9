"""Experiments on results with hidden states: only what was measured is fitted, and hidden states have bands."""

import numpy as np
import pytest

from atoll import Model
from atoll.experiments.comparison import compare
from atoll.experiments.designs import DesignRequest
from atoll.experiments.fits import EquationSetFit, constants_of, fit_displayed, measured_of
from atoll.experiments.forecast import ForecastRequest, forecast
from atoll.experiments.identifiability import identify
from atoll.experiments.smoothing import smooth
from atoll.experiments.suggestion import suggest
from atoll_coordinator.result.result import Result
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import COMPARTMENTS, RATES, VOLUME, drug_course, measured, two_compartments
from tests.unit.library.model.results import given_entries, with_given

NOISE = 0.02
TRUTH = RATES | {"V": VOLUME}


@pytest.fixture(scope="module")
def result() -> Result:
    return Result.of(two_compartments())


@pytest.fixture(scope="module")
def fitted(result: Result) -> EquationSetFit:
    return fit_displayed(measured_of(result), result)


def test_the_parameters_of_equations_and_observations_are_fitted_to_the_measured_column(
    result: Result, fitted: EquationSetFit
) -> None:
    assert [one.name for one in constants_of(fitted.equations, result)] == [*TRUTH]
    np.testing.assert_allclose(fitted.values, [*TRUTH.values()], rtol=0.05)
    assert fitted.fit.squares.shape == (1,)
    np.testing.assert_allclose(np.sqrt(fitted.fit.squares), NOISE, rtol=0.25)


def test_given_initial_values_are_no_fitted_numbers(fitted: EquationSetFit) -> None:
    assert fitted.fit.starts.tolist() == [[10.0, 0.0]]
    assert fitted.fitted_starts == 0
    assert fitted.degrees_of_freedom == 60 - 4


def test_bounds_on_initial_values_hold_and_their_values_are_fitted() -> None:
    bounded = Result.of(two_compartments(dose={"lower": 11.0, "upper": 30.0}))
    fit = fit_displayed(measured_of(bounded), bounded)
    assert fit.fitted_starts == 1
    assert 11.0 <= fit.fit.starts[0, 0] <= 30.0
    # only c/V is measured, so the volume changes with the dose
    assert fit.fit.starts[0, 0] / fit.values[3] == pytest.approx(10.0 / VOLUME, rel=0.01)


def test_other_data_are_fitted_although_the_course_of_hidden_states_is_not_known_there(result: Result) -> None:
    times = np.linspace(2.0, 8.0, 30)
    y = drug_course(times)[0] / VOLUME + np.random.default_rng(7).normal(0.0, 0.001, len(times))
    profiled = Model(result).identifiability(data={"t": times, "y": y})
    assert profiled.source == "the given data"
    for name, value in TRUTH.items():
        assert profiled[name].estimate == pytest.approx(value, rel=0.05)


def test_profiles_show_what_the_measured_column_determines(result: Result) -> None:
    profiled = identify(result)
    assert {one.name: one.verdict for one in profiled.constants} == dict.fromkeys(TRUTH, "determined")
    for name, value in TRUTH.items():
        low, high = profiled[name].interval
        assert low < value < high


def test_a_factor_without_a_scale_is_not_determined_within_its_bounds() -> None:
    dose = {"lower": 0.1, "upper": 1000.0}
    bounds = {"V": [1.9, 2.2]}
    profiled = identify(Result.of(two_compartments(dose=dose, bounds=bounds)))
    volume = profiled["V"]
    assert volume.is_cut == (True, True)
    assert volume.verdict == "structurally non-identifiable"
    assert volume.sentence.endswith("not determined between its bounds 1.9 and 2.2")
    assert profiled["k10"].verdict == "determined"


def test_systems_with_different_hidden_states_are_compared_by_the_measured_column(result: Result) -> None:
    one = Result.of(two_compartments({"c": "-k10*c"}, {"k10": 0.4}))
    comparison = compare(result, one)
    (on,) = comparison.data
    assert on.columns == ("y",)
    assert on.nats > 20.0
    assert [side.constants for side in on.sides] == [4, 2]
    assert [[*side.residuals] for side in on.sides] == [["y"], ["y"]]
    assert on.sides[0].equations["y"].startswith("c/2.0")
    turned = compare(one, result)
    np.testing.assert_allclose(turned.data[0].nats, -on.nats, rtol=0.02)


def test_experiments_are_refused_in_a_sentence(result: Result) -> None:
    with pytest.raises(UsageError, match="only suggested for models whose states are all measured"):
        suggest(result, DesignRequest({}))


def test_a_result_without_fitted_observations_is_refused_in_a_sentence() -> None:
    contents = two_compartments() | {"observations": []}
    with pytest.raises(UsageError, match="no fitted observation"):
        measured_of(Result.of(contents))


def test_hidden_states_are_smoothed_with_bands_that_contain_their_true_course(result: Result) -> None:
    smoothed = smooth(result)
    assert smoothed.states == ("c", "p", "y")
    (part,) = smoothed.trajectories
    assert part.is_like_noise
    assert not part.joins
    states = drug_course(part.t)
    truth = np.array([*states, states[0] / VOLUME]).T
    assert part.x[0].tolist()[:2] == [10.0, 0.0]
    assert part.stderr[0].tolist()[:2] == [0.0, 0.0]  # given initial values
    within = (part.lower <= truth + 1e-9) & (truth - 1e-9 <= part.upper)
    assert within.mean() > 0.8
    np.testing.assert_allclose(part.x, truth, atol=0.15)
    assert [*part.measured] == ["y"]
    np.testing.assert_allclose(part.x[:, 2], part.x[:, 0] / smoothed_volume(result), rtol=1e-9)
    columns = smoothed.columns()
    assert "y_measured" in columns
    assert "c_measured" not in columns
    assert "c_lower" in columns


def smoothed_volume(result: Result) -> float:
    return float(fit_displayed(measured_of(result), result).values[3])


def test_forecasts_of_hidden_states_begin_at_the_last_row(result: Result) -> None:
    times = np.linspace(0.5, 8.0, 40)
    y = drug_course(times)[0] / VOLUME + np.random.default_rng(5).normal(0.0, NOISE, len(times))
    table = Table(
        ("t", "y"), ("", ""), np.array([times, y]), (0,), ("d.csv",), np.zeros(40, np.int64), np.arange(2, 42)
    )
    for data in (None, table):
        found = forecast(result, ForecastRequest(6.0, step=1.0, draws=200), data)
        assert found.states == ("c", "p", "y")
        assert found.t[0] == (20.0 if data is None else 8.0)
        states = drug_course(np.append(0.5, found.t))[:, 1:]
        for name, truth in zip(found.states, [*states, states[0] / VOLUME], strict=True):
            np.testing.assert_allclose(found[name], truth, rtol=0.1, atol=0.05)
            lower, upper = found.band(name)
            assert (lower < upper).all()
            assert ((lower - 0.03 <= truth) & (truth <= upper + 0.03)).all()
        assert [*found.measured] == [*found.noise] == ["y"]
        volumes = found.draws[..., 0] / found.draws[..., 2]
        assert np.ptp(volumes, axis=1).max() < 1e-9  # each draw has one volume
        assert np.ptp(volumes[:, 0]) > 1e-3


def test_a_free_scale_is_not_determined_although_profiles_take_large_steps() -> None:
    """x'' = -4 x as dx/dt = a h, dh/dt = -b x with a hidden h: only the product a b is determined."""
    times = np.linspace(0.0, 10.0, 101)
    x = np.cos(2.0 * times) + np.random.default_rng(1).normal(0.0, 0.005, len(times))
    sides = {"x": "a*h", "h": "-b*x"}
    contents = measured(dict.fromkeys(sides, "1"), [(times, {"x": x, "h": x})], 0.005)
    contents = with_given(contents, given_entries(sides, {}, {"a": 1.0, "b": 4.0}))
    contents["system"] |= {"states": ["x"]}
    del contents["data"]["trajectories"][0]["measured"]["h"]
    del contents["noise"]["h"]
    contents |= {"hidden": ["h"], "config": {"data": {"hidden": ["h"]}}}
    profiled = identify(Result.of(contents))
    assert {one.verdict.partition(" ")[2] for one in profiled.constants} == {"non-identifiable"}
    assert "only a*b is determined, not a and b separately" in str(profiled)


def test_forms_of_sides_with_parameters_of_other_sides_are_compared(result: Result) -> None:
    sides = COMPARTMENTS | {"c": "-k10*c"}
    other = Result.of(two_compartments(sides, {"k10": 0.4, "k12": 0.52, "k21": 0.25}))
    forms = compare(result, other).forms
    assert forms["dc/dt"] == "another form"
    assert forms["dp/dt"].startswith("the same form; its constants agree within their errors, k12 by ")
