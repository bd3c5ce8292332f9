import numpy as np
from scipy import stats

from atoll.config import DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll.expression.evaluation import values_of
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.stochastic.conclusion import joint_objections
from tests.unit.coordinator.data.tables import table_of
from tests.unit.coordinator.model.stochastic.processes import ornstein_uhlenbeck

NAMES = ("x", "v", "w")


def test_independent_steps_of_variance_one_are_not_objected_to() -> None:
    residuals = np.random.default_rng(2).standard_normal((3, 4000))
    assert [joint_objections(residuals, state, NAMES, has_noise=state == 1) for state in range(3)] == [[], [], []]


def test_steps_that_go_together_with_those_of_another_state_are_objected_to() -> None:
    residuals = np.random.default_rng(2).standard_normal((3, 4000))
    residuals[2] = np.sqrt(0.99) * residuals[2] - 0.1 * residuals[1]
    (said,) = joint_objections(residuals, 1, NAMES, has_noise=True)
    assert said.startswith("the steps it leaves go together with those of w")


def test_steps_that_are_too_small_for_the_noise_of_others_are_objected_to() -> None:
    residuals = 0.5 * np.random.default_rng(2).standard_normal((3, 4000))
    (said,) = joint_objections(residuals, 2, NAMES, has_noise=False)
    assert said.startswith("its steps are 0.508 times what noise of other states makes of them")
    assert joint_objections(residuals, 2, NAMES, has_noise=True) == []


def test_equations_of_a_process_keep_to_bounds_and_have_the_variables_that_they_must_have() -> None:
    """The drift is -x and the variance 0.25 per time, were they free."""
    states = ornstein_uhlenbeck(150, 0.2, seed=2)
    prior = PriorConfig(bounds={"x": ("x > -0.5",)})
    space = SpaceConfig(operators=("+", "-", "*"), required_of={"[x]": ("x",)})
    config = JobConfig(data=DataConfig(stochastic=True), prior=prior, space=space)
    prepared = prepare(table_of({"t": 0.2 * np.arange(150), "x": states}), config)
    drift, diffusion = (refine_all(prepared, config, {}).equations[name].program for name in ("x", "[x]"))
    at = np.array([[0.0, 1.0, 2.0]])
    assert np.allclose(np.diff(values_of(drift, at)), -0.5, atol=1e-12)
    assert np.ptp(values_of(diffusion, at)) > 0.0


def test_the_log_likelihood_of_a_step_is_that_of_its_density_also_on_trajectories_that_were_held_out() -> None:
    """Two states whose steps are known exactly: the constant of the normal density is there once for each state."""
    states = np.array([ornstein_uhlenbeck(240, 0.2, seed) for seed in (3, 4)])
    decay, spread = np.exp(-0.2), 0.5 * np.sqrt((1.0 - np.exp(-0.4)) / 2.0)
    exact = stats.norm.logpdf(states[:, 1:], decay * states[:, :-1], spread).sum(axis=0)
    known = {"x": "-x", "y": "-y", "[x]": "0.25", "[y]": "0.25", "[x,y]": "0"}
    config = JobConfig(data=DataConfig(stochastic=True, holdout=1), prior=PriorConfig(known=known))
    columns = {"t": np.tile(0.2 * np.arange(120), 2), "x": states[0], "y": states[1]}
    columns |= {"trajectory": np.repeat([1.0, 2.0], 120)}
    process = refine_all(prepare(table_of(columns), config), config, {}).process
    assert abs(process.log_likelihood - exact[:119].mean()) < 1e-5
    assert abs(process.held_out - exact[120:].mean()) < 1e-5
