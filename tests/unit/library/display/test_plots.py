"""Pictures of a model show what its result has."""

import matplotlib
import numpy as np
import pytest

from atoll.api.model import Model
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import measured, two_compartments
from tests.unit.library.model.results import result


@pytest.fixture
def model() -> Model:
    matplotlib.use("agg")
    times = [0.0, 0.5, 1.0]
    curves = {"x": [1.0, 0.5, 0.0], "y": [0.0, 0.5, None]}
    contents = result({"x": "-y", "y": "x"})
    measured = {"x": [1.0, 0.7, None], "y": [0.0, 0.5, 1.0]}
    part = {"name": "1", "times": times, "values": curves, "lower": curves, "upper": curves, "measured": measured}
    contents["simulation"] = {"trajectories": [part]}
    member = {"expression": "-y", "complexity": 3, "normalized_error": 0.1, "selected": True}
    contents["equations"][0]["front"] = [member]
    return Model(contents)


def test_residuals_are_measured_less_simulated(model: Model) -> None:
    axes, _ = model.plot_residuals()
    assert axes.lines[0].get_ydata() == pytest.approx([0.0, 0.2, np.nan], nan_ok=True)


def test_states_are_drawn_below_each_other_with_their_measurements(model: Model) -> None:
    above, below = model.plot_fit()
    assert [len(above.lines), len(below.lines)] == [2, 2]
    assert (above.get_ylabel(), below.get_xlabel()) == ("x", "t")


def test_a_forecast_is_drawn_with_two_bands_after_its_measurements() -> None:
    matplotlib.use("agg")
    t = np.linspace(0.0, 4.0, 20)
    model = Model(measured({"x": "0.5"}, [(t, {"x": 0.5 * t + 0.01 * np.sin(9.0 * t)})], 0.01))
    forecast = model.forecast(2.0, draws=20)
    (axes,) = model.plot_forecast(forecast)
    median, rows = axes.lines
    assert median.get_ydata() == pytest.approx(forecast["x"])
    assert rows.get_xdata() == pytest.approx(t)
    assert len(axes.collections) == 2


def test_a_forecast_has_the_measured_columns_that_are_computed_from_hidden_states() -> None:
    matplotlib.use("agg")
    model = Model(two_compartments())
    forecast = model.forecast(2.0, draws=5)
    axes = model.plot_forecast(forecast)
    assert [at.get_ylabel() for at in axes] == ["c", "p", "y"]
    assert [len(at.lines) for at in axes] == [1, 1, 2]
    assert axes[2].lines[0].get_ydata() == pytest.approx(forecast["y"])


def test_a_phase_plane_and_a_front_are_drawn_into_given_axes(model: Model) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots(1, 2)
    model.plot_phase(axes[0])
    assert (axes[0].get_xlabel(), axes[0].get_ylabel()) == ("x", "y")
    marks = {line.get_label(): line.get_xydata().tolist() for line in axes[0].lines}
    assert marks["other fixed point"] == [pytest.approx([0.0, 0.0], abs=1e-9)]  # the centre
    measured = [[1.0, 0.0], [0.7, 0.5]]
    assert any(line.get_marker() == "." and line.get_xydata()[:2].tolist() == measured for line in axes[0].lines)
    model.plot_front(axes)
    assert axes[0].lines[-1].get_xdata().tolist() == [3]
    with pytest.raises(UsageError, match="1 axes are needed, but 2 were given"):
        model.plot_phase(axes)


def test_curves_are_those_of_the_model_between_rows(model: Model) -> None:
    times = [0.0, 2.0, 4.0, 6.0]
    values = {"x": np.cos(times).tolist(), "y": np.sin(times).tolist()}
    contents = result({"x": "-y", "y": "x"})
    part = {"name": "1", "times": times, "values": values, "start": {"x": 1.0, "y": 0.0}}
    contents["simulation"] = {"trajectories": [part]}
    round_model = Model(contents)
    above, _ = round_model.plot_fit()
    assert above.lines[0].get_ydata().min() == pytest.approx(-1.0, abs=0.01)
    (plane,) = round_model.plot_phase()
    (curve,) = [line for line in plane.lines if line.get_color() == "C0"]
    assert np.hypot(*curve.get_data()) == pytest.approx(1.0, abs=0.01)
