import numpy as np

from atoll_coordinator.data.increments import take_steps
from atoll_coordinator.data.recording import ProcessRecording, SampledPath
from atoll_coordinator.model.stochastic.path_ensembles import simulate_ensemble, simulate_stationary_density
from atoll_coordinator.process_steps.paths import Simulator
from tests.unit.coordinator.model.stochastic.processes import model_of, ornstein_uhlenbeck


def recording(states: np.ndarray, step: float) -> ProcessRecording:
    path = SampledPath("1", step * np.arange(len(states)), states[None], np.zeros((0, len(states))))
    return ProcessRecording(("x",), ("x",), (), (), 0.0, (path,), np.zeros(1), ((0, 0),))


def test_an_ensemble_and_a_settled_density_are_those_of_the_process() -> None:
    process = recording(ornstein_uhlenbeck(3000, 0.1, seed=1) + np.where(np.arange(3000) == 0, 2.0, 0.0), 0.1)
    simulator = Simulator(model_of("-1*x", "0.25").moments, np.random.default_rng(1))
    ensemble = simulate_ensemble(simulator, process)
    assert ensemble is not None
    assert ensemble.trajectory == "1"
    assert ensemble.finite_paths == ensemble.paths
    place = ensemble.times.index(1.0)
    assert abs(ensemble.mean["x"][place] - 2.0 * np.exp(-1.0)) < 4.0 * 0.35 / np.sqrt(ensemble.paths)
    density = simulate_stationary_density(simulator, process, take_steps(process))
    assert density is not None
    assert abs(density["x"].sd - 0.5 / np.sqrt(2.0)) < 0.01
    assert density["x"].overlap > 0.9


def test_what_grows_without_end_does_not_settle() -> None:
    process = recording(1.0 + ornstein_uhlenbeck(500, 0.1, seed=1), 0.1)
    simulator = Simulator(model_of("0.05*x", "0.01*x*x").moments, np.random.default_rng(1))
    assert simulate_stationary_density(simulator, process, take_steps(process)) is None
