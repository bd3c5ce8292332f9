import numpy as np

from atoll_coordinator.model.stochastic.conclusion import joint_objections

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
