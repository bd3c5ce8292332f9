import numpy as np
from scipy import linalg

from atoll.config import DataConfig, JobConfig, SpaceConfig
from atoll.data.dataset import FloatArray
from atoll.expression.evaluation import values_of
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.stochastic.choice import ProcessChoice, is_zero
from tests.unit.coordinator.data.tables import table_of


def oscillator(rows: int, step: float, seed: int) -> FloatArray:
    """Return position and velocity of dx = v dt, dv = -(x + v/2) dt + dW/2, from their transition density."""
    drift, noise = np.array([[0.0, 1.0], [-1.0, -0.5]]), np.diag([0.0, 0.25])
    block = linalg.expm(step * np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]))
    move = block[2:, 2:].T
    factor = np.linalg.cholesky(move @ block[:2, 2:])
    found = [np.array([1.0, 0.0])]
    for normal in np.random.default_rng(seed).standard_normal((rows - 1, 2)):
        found.append(move @ found[-1] + factor @ normal)
    return np.array(found).T


def test_a_state_without_noise_of_its_own_has_an_ordinary_equation() -> None:
    states = oscillator(500, 0.1, seed=1)
    config = JobConfig(data=DataConfig(stochastic=True), space=SpaceConfig(operators=("+", "-", "*")))
    prepared = prepare(table_of({"t": 0.1 * np.arange(500), "x": states[0], "v": states[1]}), config)
    assert prepared.process is not None
    assert prepared.process.components == ("[x]", "[v]"), "what v carries over to x is no correlation of noises"
    chosen = ProcessChoice(prepared.dataset, prepared.process, config, {}, Deadline()).choose()
    x, v, of_x, of_v = chosen.fitted.model.programs
    assert is_zero(of_x)
    assert np.allclose(values_of(x, states), states[1], atol=0.005), "it is known far better than steps with noise tell"
    assert np.std(values_of(v, states) + states[0] + 0.5 * states[1]) < 0.3
    assert abs(values_of(of_v, states).mean() - 0.25) < 0.08
    assert chosen.free == (0, 1, 3)
