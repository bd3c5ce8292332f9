from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.refinement import Grade, Refined
from atoll_coordinator.model.stochastic.checks import ProcessChecks, ProcessSteps
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess
from atoll_core.config import DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import FloatArray, Target
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.restrictions import NONE
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.data.tables import table_of
from tests.unit.coordinator.model.stochastic.processes import ornstein_uhlenbeck, steps_of

NAMES = ("x", "v", "w")


def list_checks(residuals: FloatArray, state: int, *, has_noise: bool) -> ProcessChecks:
    """Return the checks of the drift of a state whose whitened steps are given."""
    steps = SimpleNamespace(
        states=NAMES, residuals=residuals, noiseless_states=[] if has_noise else [state], exact_states=[],
        has_noise=True,
        chosen=SimpleNamespace(is_stopped=False),
    )  # fmt: skip
    target = Target("", "", residuals[state], 0.0, 1.0)
    return ProcessChecks(Refined(None, from_infix("x", NAMES), 0.0, 0.0), target, cast(ProcessSteps, steps), state)


def test_independent_steps_of_variance_one_are_not_objected_to() -> None:
    residuals = np.random.default_rng(2).standard_normal((3, 4000))
    for state in range(3):
        checks = list_checks(residuals, state, has_noise=state == 1)
        assert checks.check_correlation_of_states().outcome == "passed"
        assert checks.check_size_of_steps().outcome == ("not applicable" if state == 1 else "passed")


def test_steps_that_go_together_with_those_of_another_state_are_objected_to() -> None:
    residuals = np.random.default_rng(2).standard_normal((3, 4000))
    residuals[2] = np.sqrt(0.99) * residuals[2] - 0.1 * residuals[1]
    check = list_checks(residuals, 1, has_noise=True).check_correlation_of_states()
    assert check.outcome == "failed"
    assert check.reason.startswith("the residual steps are correlated with the steps of w")


def test_steps_that_are_too_small_for_the_noise_of_others_are_objected_to() -> None:
    residuals = 0.5 * np.random.default_rng(2).standard_normal((3, 4000))
    checks = list_checks(residuals, 2, has_noise=False)
    assert (checks.check_size_of_steps().outcome, checks.check_correlation_of_states().outcome) == ("failed", "passed")


@pytest.mark.slow
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
    from scipy import stats

    states = np.array([ornstein_uhlenbeck(240, 0.2, seed) for seed in (3, 4)])
    decay, spread = np.exp(-0.2), 0.5 * np.sqrt((1.0 - np.exp(-0.4)) / 2.0)
    exact = stats.norm.logpdf(states[:, 1:], decay * states[:, :-1], spread).sum(axis=0)
    known = {"x": "-x", "y": "-y", "[x]": "0.25", "[y]": "0.25", "[x,y]": "0"}
    config = JobConfig(data=DataConfig(stochastic=True, holdout=1), prior=PriorConfig(known=known))
    columns = {"t": np.tile(0.2 * np.arange(120), 2), "x": states[0], "y": states[1]}
    columns |= {"trajectory": np.repeat([1.0, 2.0], 120)}
    process = refine_all(prepare(table_of(columns), config), config, {}).process
    assert abs(process.log_likelihood - exact[:119].mean()) < 1e-5
    assert abs(process.held_out_log_likelihood - exact[120:].mean()) < 1e-5


ROWS = np.arange(101.0)
EXACT = {"a ramp": 2.0 * (0.1 * ROWS), "back and forth": ROWS % 2.0}


@pytest.mark.slow
@pytest.mark.parametrize("states", EXACT.values(), ids=[*EXACT])
def test_exact_tables_have_equations_of_which_none_is_said_to_be_the_law_of_a_process(states: FloatArray) -> None:
    config = JobConfig(data=DataConfig(stochastic=True), space=SpaceConfig(operators=("+", "*")))
    prepared = prepare(table_of({"t": 0.1 * ROWS, "x": states}), config)
    equations = refine_all(prepared, config, {}).equations
    assert [*equations] == ["x", "[x]"]
    assert {(equation.grade, (equation.reason or "")[:16]) for equation in equations.values()} == {
        ("doubtful", "No state shows n")
    }


def judged(rows_a_period: int, model: ProcessModel) -> list[Grade]:
    """Return the grades of the equations of a process, x = cos t and y = -sin t exactly."""
    times = 2.0 * np.pi / rows_a_period * ROWS
    steps = steps_of(np.array([np.cos(times), -np.sin(times)]), float(times[1]))
    process = ProcessRecording(("x", "y"), ("x", "y"), (), (), 0.0, (), pairs=model.pairs)
    fitted, count = FittedProcess(model, 0.0, lambda: np.zeros((0, 0))), len(model.programs)
    chosen = ChosenProcess(
        process, ("x", "y", *process.components), (*range(count),), (), ProcessLikelihood(steps), fitted,
        ((),) * count, (NONE,) * count, 0.0,
    )  # fmt: skip
    whitened, target = ProcessSteps(chosen, model), Target("", "", steps.increments[0], 0.0, 1.0)
    return [
        judge(ProcessChecks(Refined(None, program, 0.0, 0.0), target, whitened, number)).grade
        for number, program in enumerate(model.programs)
    ]


def two_states(*equations: str) -> ProcessModel:
    programs = tuple(from_infix(equation, ("x", "y")) for equation in equations)
    return ProcessModel(programs[:2], programs[2:], ((0, 0), (1, 1)), (0.0, 0.0))


def test_steps_that_follow_eulers_method_exactly_are_not_those_of_a_process() -> None:
    share = 2.0 / np.pi
    model = two_states(f"{share!r}*y - {share!r}*x", f"-{share!r}*x - {share!r}*y", "0", "0")
    assert judged(4, replace(model, discretisation="Euler-Maruyama")) == ["doubtful"] * 4


def test_a_variance_is_not_said_to_be_none_where_steps_are_not_those_that_other_states_make() -> None:
    """What the integration of ten steps a period misses has been taken for noise of the other state."""
    assert judged(10, two_states("1.001*y", "-1.001*x", "0", "6.5e-8")) == ["doubtful"] * 4


def test_a_process_is_judged_by_its_steps_and_not_as_a_target_is() -> None:
    states = ornstein_uhlenbeck(150, 0.2, seed=2)
    config = JobConfig(data=DataConfig(stochastic=True), space=SpaceConfig(operators=("+", "-", "*")))
    prepared = prepare(table_of({"t": 0.2 * np.arange(150), "x": states}), config)
    equations = refine_all(prepared, config, {}).equations
    names = {check.name for check in equations["x"].checks}
    assert {"pattern of steps", "serial correlation"} <= names
    assert not names & {"rows left out", "target uncertainty"}
