"""States that no column measures, columns that are computed from states, and fits of such systems from many starts."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.batches import Spread, spreading
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_coordinator.model.shooting.many_starts import StartPoint, StartsProblem, fit_from_many_starts
from atoll_coordinator.model.shooting.measurements import (
    TrajectoryMeasurements,
    measurements_of,
)
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.points_between import latin_hypercube
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_core.data.dataset import FloatArray
from tests.batches import ScatteredBatches
from tests.unit.coordinator.model.shooting.given import FREE, Bounds, for_states, given_system, measured_columns, ranges
from tests.unit.coordinator.model.shooting.made import Known, recording

# A drug in two compartments; only the first one is measured.

DRUG = {"c": "-k*c - a*c + b*p", "p": "a*c - b*p"}
DRUG_VALUES = {"k": 0.5, "a": 0.8, "b": 0.3}
HOURS = np.linspace(0.0, 12.0, 41)


def drug(times: FloatArray = HOURS, k: float = 0.5, a: float = 0.8, b: float = 0.3) -> FloatArray:
    """Return the closed form of both compartments (2, N) after a dose of 5."""
    total, product = k + a + b, k * b
    fast, slow = (0.5 * (total + sign * np.sqrt(total**2 - 4.0 * product)) for sign in (1.0, -1.0))
    first, second = np.exp(-fast * times), np.exp(-slow * times)
    central = 5.0 * ((fast - b) * first + (b - slow) * second) / (fast - slow)
    return np.array([central, 5.0 * a * (second - first) / (fast - slow)])


def drug_fit(start: tuple[Bounds, Bounds], noise: float = 0.0, **bounds: Bounds):
    values = drug()[:1] + noise * np.random.default_rng(1).standard_normal((1, len(HOURS)))
    system, names = given_system(DRUG, ("c", "p"), dict.fromkeys(DRUG_VALUES, (0.01, 10.0)) | bounds)
    columns = measured_columns(values, HOURS, ["c"], max(noise, 1e-9))
    measurements = for_states(columns, ("c", "p"), [0], ranges(HOURS, *start))
    fit = MultipleShooting(measurements, 1e-9).fit(system, None, 60)
    assert fit is not None
    return fit, dict(zip(names, fit.system.values.tolist(), strict=True))


def test_a_hidden_compartment_is_found_as_in_its_closed_form():
    fit, values = drug_fit((FREE, (0.0, 0.0)))
    assert values == pytest.approx(DRUG_VALUES, rel=1e-6)
    assert fit.simulated == pytest.approx(drug(), abs=1e-6)


def test_given_initial_values_are_not_fitted():
    fit, _ = drug_fit(((5.0, 5.0), (0.0, 0.0)), noise=0.05)
    assert fit.starts.tolist() == [[5.0, 0.0]]
    fitted = fit.system.count
    assert not fit.integrated_sensitivities()[:, :, fitted:].any()
    assert np.isfinite(covariance(fit)).all()


def test_initial_values_stay_within_their_bounds():
    fit, values = drug_fit(((0.0, 20.0), (0.5, 1.0)), a=(0.8, 0.8))
    assert fit.starts[0, 1] == 0.5
    assert fit.starts[0, 0] == pytest.approx(5.0, rel=0.1)
    assert values["a"] == 0.8
    assert all(0.01 <= value <= 10.0 for value in values.values())


def test_a_number_stays_within_its_bounds_while_others_are_fitted():
    _, values = drug_fit((FREE, (0.0, 0.0)), a=(0.01, 0.6))
    assert values["a"] == 0.6
    assert values["k"] == pytest.approx(0.5, rel=0.5)


def test_uncertain_constants_of_a_hidden_compartment_cover_the_truth():
    fit, values = drug_fit((FREE, (0.0, 0.0)), noise=0.02)
    for name, variance in zip(values, np.diag(covariance(fit)).tolist(), strict=True):
        assert abs(values[name] - DRUG_VALUES[name]) < 4.0 * np.sqrt(variance)
        assert np.sqrt(variance) < 0.2 * values[name]


# Columns that are computed from states.

MIXED = {"x": "-r*x + s*h", "h": "x - h", "y": "a*h + b*x**2 - r*u"}


def mixed(groups: int = 1) -> tuple[MultipleShooting, OdeSystem]:
    times = 0.2 * np.arange(12.0)
    known = Known(("x", "h"), lambda t, z: [-z[0] + 0.5 * z[1], z[0] - z[1]])
    rows = measurements_of(recording(known, [[1.0, 0.5], [0.3, 2.0]], [times, times]), [0, 1])
    states = for_states(rows, ("x", "h"), [0, 2])
    system, _ = given_system(MIXED, ("x", "h"), dict.fromkeys("rsab", (0.1, 10.0)), ["u"])
    waves = np.sin(rows.times)[None]
    states = replace(states, inputs=waves, input_slopes=np.cos(rows.times)[None], variables=("x", "h", "u"))
    if groups > 1:
        states = replace(states, groups=np.arange(2))
        system = replace(system, lower=None, upper=None, is_logarithmic=None)
        system = system.sharing_numbers(system.constants * np.array([[1.0], [1.3]]), [])
    return MultipleShooting(states, 1e-10), system


@pytest.mark.parametrize("groups", [1, 2])
def test_sensitivities_of_computed_columns_are_derivatives(groups: int):
    estimator, system = mixed(groups)
    method, segments = estimator.integrator.methods[0], estimator.measurements.segments(None)
    starts = np.array([[1.0, 0.5], [0.3, 2.0]])

    def simulated(values: FloatArray, at: FloatArray) -> FloatArray:
        course = estimator.integrator.integrate(
            method, system.with_values(values), segments, at, has_sensitivities=False
        )
        assert course.done == len(segments)
        return course.states

    whole = estimator.integrator.integrate(method, system, segments, starts)
    assert whole.sensitivities.shape == (24, 3, system.count + 2)
    for number, value in enumerate(system.values.tolist()):
        step = 1e-5 * np.eye(system.count)[number] * value
        slope = (simulated(system.values + step, starts) - simulated(system.values - step, starts)) / (2e-5 * value)
        assert whole.sensitivities[:, :, number] == pytest.approx(slope.T, abs=1e-6)
    for state in range(2):
        step = 1e-5 * np.eye(2)[[state, state]]
        slope = (simulated(system.values, starts + step) - simulated(system.values, starts - step)) / 2e-5
        assert whole.sensitivities[:, :, system.count + state] == pytest.approx(slope.T, abs=1e-6)


def test_values_of_computed_columns():
    estimator, system = mixed()
    fit = estimator.fit(system, None, 0, np.array([[1.0, 0.5], [0.3, 2.0]]))
    assert fit is not None
    (x, h), u = fit.simulated, estimator.measurements.inputs[0]
    assert fit.simulated.shape == (2, 24)
    assert fit.simulated_columns == pytest.approx(np.array([x, h + x**2 - u]))
    assert fit.residuals == pytest.approx(estimator.measurements.measured - fit.simulated_columns)


def test_constants_of_columns_are_fitted_with_the_constants_of_equations():
    """The scale of a hidden state follows from its given initial value; a column measures it up to a line."""
    values = 0.7 * drug()[1:] + 2.0
    sides = DRUG | {"y": "m*p + n"}
    system, names = given_system(sides, ("c", "p"), dict.fromkeys("kab", (0.01, 10.0)) | dict.fromkeys("mn", FREE))
    columns = measured_columns(np.concatenate([drug()[:1], values]), HOURS, ["c", "y"], 1e-9)
    measurements = for_states(columns, ("c", "p"), [0, 2], ranges(HOURS, FREE, (0.0, 0.0)))
    fit = MultipleShooting(measurements, 1e-9).fit(system, None, 60)
    assert fit is not None
    expected = DRUG_VALUES | {"m": 0.7, "n": 2.0}
    assert dict(zip(names, fit.system.values.tolist(), strict=True)) == pytest.approx(expected, rel=1e-5)
    assert [len(program) for program in fit.system.programs][2] == len(fit.system.observation_programs[0])


def test_steps_in_logarithms_keep_signs_and_are_short():
    system, names = given_system(DRUG | {"y": "m*p"}, ("c", "p"), dict.fromkeys("kab", (0.01, 10.0)) | {"m": FREE})
    moved = dict(zip(names, system.moved(np.full(4, -50.0)).values / system.values, strict=True))
    assert [moved[name] for name in "kab"] == pytest.approx([np.exp(-1.0)] * 3)
    assert moved["m"] == pytest.approx(-49.0)
    small = dict(zip(names, system.moved(np.full(4, 1e-6)).values - system.values, strict=True))
    assert [small[name] for name in "kabm"] == pytest.approx([1e-6] * 4, rel=1e-4)


def test_the_slopes_of_the_penalty_are_derivatives():
    system, names = given_system(DRUG | {"y": "m*p"}, ("c", "p"), dict.fromkeys("kab", (0.01, 10.0)) | {"m": FREE})
    system = replace(system, has_prior=True)
    values = system.values * np.array([3.0, 0.2, 1.0, 5.0])
    _, pull, curvature = system.with_values(values).penalty()
    for number, value in enumerate(values.tolist()):
        step = 1e-6 * value * np.eye(4)[number]
        ahead, behind = (system.with_values(values + sign * step).penalty()[0] for sign in (1.0, -1.0))
        assert pull[number] == pytest.approx(-0.5 * (ahead - behind) / (2e-6 * value), abs=1e-6)
    assert curvature[names.index("m")] == 0.0
    assert system.penalty()[0] == pytest.approx(0.0)  # in the middle of the bounds
    edge = system.with_values(np.array([10.0 if name != "m" else 1.0 for name in names]))
    assert edge.penalty()[0] == pytest.approx(3 * 3.0)  # half a width is the square root of 3 standard deviations


def test_a_prior_keeps_what_the_data_do_not_determine_and_moves_little_else():
    """The sum of two rates is determined, their ratio is not."""
    system, names = given_system({"x": "-(a + b)*x"}, ("x",), {"a": (0.1, 10.0), "b": (0.01, 1.0)})
    values = np.exp(-2.0 * HOURS)[None] + 0.05 * np.random.default_rng(0).standard_normal((1, len(HOURS)))
    estimator = MultipleShooting(measured_columns(values, HOURS, ["x"], 0.05), 1e-8)
    starts = system.with_values(np.array([1.05, 0.95] if names == ["a", "b"] else [0.95, 1.05]))
    ends = {}
    for has_prior in (False, True):
        fit = estimator.fit(replace(starts, has_prior=has_prior), None, 60)
        assert fit is not None
        ends[has_prior] = dict(zip(names, fit.system.values.tolist(), strict=True))
    assert sum(ends[True].values()) == pytest.approx(sum(ends[False].values()), rel=0.01)
    assert ends[False]["b"] > 0.8
    assert 0.05 < ends[True]["b"] < 0.3


def test_parts_of_hidden_measurements_keep_the_initial_ranges_of_their_first_rows():
    columns = measured_columns(drug()[:1], HOURS, ["c"], 0.01)
    measurements = for_states(columns, ("c", "p"), [0], ranges(HOURS, FREE, (0.0, 0.0)))
    lower, upper = measurements.pieces([(0, 10, 0), (20, 30, 0)]).start_ranges(np.array([[0, 10], [10, 20]]))
    assert lower[:, 1].tolist() == [0.0, -np.inf]
    assert upper[:, 1].tolist() == [0.0, np.inf]
    first = measurements.first_rows(7)
    assert first.rows == 7
    assert np.array_equal(first.limits, measurements.limits)
    assert np.isinf(measurements.limits[1]).all()


def test_the_course_of_a_hidden_state_gives_its_scale():
    columns = measured_columns(drug()[:1], HOURS, ["c"], 0.01)
    measurements = for_states(columns, ("c", "p"), [0], ranges(HOURS, FREE, (0.01, 4.0)))
    assert measurements.smoothed[1] == pytest.approx(0.2)
    assert measurements.scales[1] == pytest.approx(0.2)
    again = measurements.with_course(drug())
    assert again.scales == pytest.approx(drug().std(axis=1))
    assert np.array_equal(again.smoothed[0], measurements.smoothed[0])


# Many starts.

NERVE = Known(("v", "w"), lambda _, z: [z[0] - z[0] ** 3 / 3 - z[1] + 0.5, (z[0] + 0.7 - 0.8 * z[1]) / 12.5])
NERVE_TEXT = {"v": "v - v**3/3 - w + 0.5", "w": "(v + a - b*w)/tau"}
NERVE_BOUNDS = {"a": (0.07, 7.0), "b": (0.08, 8.0), "tau": (1.0, 100.0)}
NERVE_TIMES = np.linspace(0.0, 60.0, 121)


def nerve(noise: float = 0.0) -> tuple[TrajectoryMeasurements, OdeSystem, list[str]]:
    values = NERVE.values([-1.0, 0.5], NERVE_TIMES)[:1]
    values = values + noise * np.random.default_rng(3).standard_normal(values.shape)
    columns = measured_columns(values, NERVE_TIMES, ["v"], max(noise, 1e-8))
    system, names = given_system(NERVE_TEXT, ("v", "w"), NERVE_BOUNDS)
    return for_states(columns, ("v", "w"), [0], ranges(NERVE_TIMES, FREE, (-2.0, 2.0))), system, names


def test_a_nerve_is_found_from_most_of_sixteen_starts():
    measurements, system, names = nerve()
    problem = StartsProblem(measurements, 1e-8, 0, system, None)
    ends = []
    for share in latin_hypercube(16, 4, 7):
        values = system.lower * (system.upper / system.lower) ** share[:3]
        start = StartPoint(values, np.array([[measurements.measured[0, 0], 4.0 * share[3] - 2.0]]))
        reached, _ = problem.fit(start)
        if reached is not None:
            ends.append(dict(zip(names, reached.values.tolist(), strict=True)))
    right = [end for end in ends if end == pytest.approx({"a": 0.7, "b": 0.8, "tau": 12.5}, rel=1e-3)]
    assert len(right) >= 12


def test_the_best_of_many_starts_has_the_hidden_course():
    measurements, system, names = nerve(noise=0.02)
    estimator = MultipleShooting(measurements, 1e-6)
    found = fit_from_many_starts(estimator, system)
    assert found is not None
    values = dict(zip(names, found.fit.system.values.tolist(), strict=True))
    assert values == pytest.approx({"a": 0.7, "b": 0.8, "tau": 12.5}, rel=0.05)
    truth = NERVE.values([-1.0, 0.5], NERVE_TIMES)
    assert found.fit.simulated[1] == pytest.approx(truth[1], abs=0.1)
    assert found.minima[0].reached >= 5
    assert found.starts < 100
    assert found.fit.estimator.measurements.scales[1] == pytest.approx(truth[1].std(), rel=0.1)
    assert estimator.work > 0


def test_starts_are_fitted_alike_by_threads_and_workers():
    values = drug()[:1] + 0.02 * np.random.default_rng(2).standard_normal((1, len(HOURS)))
    system, _ = given_system(DRUG, ("c", "p"), dict.fromkeys("kab", (0.01, 10.0)))
    columns = measured_columns(values, HOURS, ["c"], 0.02)
    measurements = for_states(columns, ("c", "p"), [0], ranges(HOURS, FREE, (0.0, 0.0)))
    results = []
    with spreading(None, 2, Deadline()) as threads:
        for spread in (None, threads, Spread(ScatteredBatches(3))):
            estimator = MultipleShooting(measurements, 1e-5, spread=spread)
            found = fit_from_many_starts(estimator, system, seed=4)
            assert found is not None
            numbers = [found.fit.system.values, found.fit.starts, found.fit.squares]
            results.append((estimator.work, found.starts, *(array.tobytes() for array in numbers)))
    assert results[0] == results[1] == results[2]


def test_a_chaotic_system_is_found_from_one_of_three_states():
    known = Known(
        ("x", "y", "z"), lambda _, s: [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]]
    )
    times = np.linspace(0.0, 6.0, 301)
    values = known.values([-8.0, 7.0, 27.0], times)
    sides = {"x": "s*(y - x)", "y": "x*(r - z) - y", "z": "x*y - b*z"}
    system, names = given_system(sides, known.states, {"s": (1.0, 100.0), "r": (1.0, 100.0), "b": (0.1, 10.0)})
    noise = 0.01 * values[0].std()
    seen = values[:1] + noise * np.random.default_rng(5).standard_normal((1, len(times)))
    columns = measured_columns(seen, times, ["x"], noise)
    measurements = for_states(columns, known.states, [0], ranges(times, FREE, (-50.0, 50.0), (0.0, 60.0)))
    found = fit_from_many_starts(MultipleShooting(measurements, 1e-6), system)
    assert found is not None
    expected = {"s": 10.0, "r": 28.0, "b": 8 / 3}
    assert dict(zip(names, found.fit.system.values.tolist(), strict=True)) == pytest.approx(expected, rel=0.02)
    assert np.abs(found.fit.simulated - values).max() < 2.0


def test_starts_that_cannot_be_integrated_are_counted_as_work():
    system, _ = given_system({"x": "k*exp(x**2)"}, ("x",), {"k": (10.0, 1000.0)})
    estimator = MultipleShooting(measured_columns(drug()[:1], HOURS, ["x"], 0.01), 1e-6)
    assert fit_from_many_starts(estimator, system) is None
    assert estimator.work > 0


def test_without_bounds_there_is_one_start():
    system, _ = given_system(DRUG, ("c", "p"), dict.fromkeys("kab", FREE))
    columns = measured_columns(drug()[:1], HOURS, ["c"], 0.01)
    measurements = for_states(columns, ("c", "p"), [0], ranges(HOURS, FREE, (0.0, 0.0)))
    found = fit_from_many_starts(MultipleShooting(measurements, 1e-6), system.with_values(np.array([0.3, 0.5, 0.25])))
    assert found is not None
    assert found.starts == 1


def test_a_stiff_hidden_state_is_fitted_with_the_implicit_method():
    times = np.linspace(0.0, 10.0, 41)
    slow, fast = 0.4, 4000.0
    product = 1.0 - (fast * np.exp(-slow * times) - slow * np.exp(-fast * times)) / (fast - slow)
    system, names = given_system(
        {"s": "-k*s", "i": "k*s - 4000*i", "p": "4000*i"}, ("s", "i", "p"), {"k": (0.01, 10.0)}
    )
    columns = measured_columns(product[None], times, ["p"], 1e-4)
    measurements = for_states(columns, ("s", "i", "p"), [2], ranges(times, (1.0, 1.0), (0.0, 0.0), (0.0, 0.0)))
    found = fit_from_many_starts(MultipleShooting(measurements, 1e-5), system)
    assert found is not None
    assert found.fit.is_stiff
    assert dict(zip(names, found.fit.system.values.tolist(), strict=True)) == pytest.approx({"k": slow}, rel=1e-3)
