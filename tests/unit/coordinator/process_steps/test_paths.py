import numpy as np

from atoll_coordinator.process_steps.moments import StepMoments, predict_step_moments
from atoll_coordinator.process_steps.paths import Ensemble, Simulator, divided
from atoll_core.expression.text.parsing import from_infix


def test_gaps_between_times_are_divided_into_steps_no_longer_than_the_longest() -> None:
    begins, lengths, is_kept = divided(np.array([0.0, 0.1, 0.35]), 0.1)
    assert np.allclose(begins, [0.0, 0.1, 0.1 + 0.25 / 3.0, 0.1 + 0.5 / 3.0])
    assert np.allclose(lengths, [0.1, 0.25 / 3.0, 0.25 / 3.0, 0.25 / 3.0])
    assert is_kept.tolist() == [True, False, False, True]


def test_a_state_without_noise_in_a_step_follows_the_drift_alone() -> None:
    """By Euler and Maruyama a position moves with the velocity at the beginning of the step."""
    names = ["x", "v"]
    drift, noise = [from_infix(text, names) for text in ("v", "-x")], {(1, 1): from_infix("4", names)}

    def moments(points: np.ndarray, lengths: np.ndarray) -> StepMoments:
        return predict_step_moments(drift, noise, points, lengths, "Euler-Maruyama")

    simulator = Simulator(moments, np.random.default_rng(1))
    simulated_paths = simulator.paths(np.ones((2, 400)), np.zeros((0, 2)), np.full(2, 0.25))
    assert np.array_equal(simulated_paths[1:, 0], simulated_paths[:-1, 0] + 0.25 * simulated_paths[:-1, 1])
    assert abs(simulated_paths[1, 1].std() - 2.0 * 0.5) < 0.15


def test_of_an_ensemble_mean_and_bounds_are_those_of_paths_that_are_finite_to_the_end() -> None:
    paths = np.stack([np.array([[0.0], [float(value)]]) for value in [*range(101), np.nan]])
    ensemble = Ensemble(("x",), np.array([0.0, 1.0]), paths)
    assert len(ensemble.finite) == 101
    assert (ensemble.mean[1, 0], ensemble.lower[1, 0], ensemble.upper[1, 0]) == (50.0, 5.0, 95.0)
    assert ensemble.message == "102 paths, 1 not finite to the end"
    assert ensemble.to_csv().splitlines() == [
        "t,x_mean,x_lower,x_median,x_upper", "0.0,0.0,0.0,0.0,0.0", "1.0,50.0,5.0,50.0,95.0",
    ]  # fmt: skip
    assert ensemble.to_csv(has_paths=True).splitlines()[:4] == ["trajectory,t,x", "1,0.0,0.0", "1,1.0,0.0", "2,0.0,0.0"]
    assert ensemble.as_dict(has_paths=True)["states"]["x"][-1] == [0.0, None]
    assert np.isnan(Ensemble(("x",), np.array([0.0, 1.0]), paths[-1:]).upper).any()
