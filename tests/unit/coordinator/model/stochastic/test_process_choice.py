from collections.abc import Mapping

import numpy as np
import pytest
from scipy import linalg

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.stochastic.likelihood import ProcessModel
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess, ProcessChoice, is_zero
from atoll_core.config import DataConfig, JobConfig, SpaceConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.data.tables import table_of


def oscillator(rows: int, step: float, seed: int) -> FloatArray:
    """Return position and velocity of dx = v dt, dv = -(x + v/2) dt + dW/2, from their transition density."""
    drift, noise = np.array([[0.0, 1.0], [-1.0, -0.5]]), np.diag([0.0, 0.25])
    block = linalg.expm(step * np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]))
    move = block[2:, 2:].T
    factor = np.linalg.cholesky(move @ block[:2, 2:])
    states = [np.array([1.0, 0.0])]
    for normal in np.random.default_rng(seed).standard_normal((rows - 1, 2)):
        states.append(move @ states[-1] + factor @ normal)
    return np.array(states).T


def euler_maruyama(rows: int, step: float, seed: int) -> FloatArray:
    """Return position and velocity of the same oscillator as the method of Euler and Maruyama moves them."""
    x, v, states = 1.0, 0.0, [(1.0, 0.0)]
    for normal in (0.5 * np.sqrt(step) * np.random.default_rng(seed).standard_normal(rows - 1)).tolist():
        x, v = x + step * v, v - step * (x + 0.5 * v) + normal
        states.append((x, v))
    return np.array(states).T


def begun(
    states: FloatArray, known: Mapping[str, str] | None = None, required: Mapping[str, tuple[str, ...]] | None = None
) -> ProcessChoice:
    space = SpaceConfig(operators=("+", "-", "*"), required_of=dict(required or {}))
    config = JobConfig(data=DataConfig(stochastic=True), space=space)
    prepared = prepare(table_of({"t": 0.1 * np.arange(states.shape[1]), "x": states[0], "v": states[1]}), config)
    assert prepared.process is not None
    assert prepared.process.components == ("[x]", "[v]"), "what v carries over to x is no correlation of noises"
    candidates = {name: CandidateSet(known=from_infix(text, ["x", "v"])) for name, text in (known or {}).items()}
    return ProcessChoice(prepared.dataset, prepared.process, config, candidates, Deadline())


def choice_of(states: FloatArray, known: Mapping[str, str] | None = None) -> ChosenProcess:
    return begun(states, known).choose()


def test_a_variance_that_must_depend_on_a_variable_does_not_become_zero() -> None:
    states = np.round(euler_maruyama(120, 0.1, seed=1), 7)
    programs = [from_infix(text, ["x", "v"]) for text in ("v", "-x - 0.5*v", "0.01*v*v", "0.25")]
    model = ProcessModel(tuple(programs[:2]), tuple(programs[2:]), ((0, 0), (1, 1)), (0.0, 0.0))
    assert is_zero(begun(states)._fit_as_euler_maruyama(model).model.programs[2])
    choice = begun(states, required={"[x]": ("v",)})
    assert not is_zero(choice._fit_as_euler_maruyama(model).model.programs[2])


def test_a_table_made_by_euler_and_maruyama_is_taken_for_that() -> None:
    """As samples of a process in time, noise would have to reach x within a step, and be twice as large."""
    states = euler_maruyama(500, 0.1, seed=1)
    equations = {"x": "v", "v": "-x - 0.5*v", "[x]": "0"}
    chosen = choice_of(np.round(states, 7), equations)
    assert chosen.fitted.model.discretisation == "Euler-Maruyama"
    assert chosen.discretisation_nats > 100.0
    assert abs(values_of(chosen.fitted.model.programs[3], states).mean() - 0.25) < 4.0 * 0.25 * np.sqrt(2.0 / 500.0)


@pytest.mark.slow
def test_a_state_without_noise_of_its_own_has_an_ordinary_equation() -> None:
    states = oscillator(500, 0.1, seed=1)
    chosen = choice_of(states)
    x, v, of_x, of_v = chosen.fitted.model.programs
    assert is_zero(of_x)
    assert np.allclose(values_of(x, states), states[1], atol=0.005), "it is known far better than steps with noise tell"
    assert np.std(values_of(v, states) + states[0] + 0.5 * states[1]) < 0.3
    assert abs(values_of(of_v, states).mean() - 0.25) < 0.08
    assert chosen.free == (0, 1, 3)
    assert chosen.fitted.model.discretisation == "local linearisation"
