"""The verdicts in a result, also on equations that refining did not judge; and its candidates, in order."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation, Recording, StateSmoothing
from atoll_coordinator.dimensions import EquationUnits
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.result.building import Account, VariableOutcome, build_result
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry

VALUES = np.linspace(-1.0, 1.0, 20)
TARGET = Target("x", "dx/dt", VALUES, 1e-9, 0.6)
DATASET = Dataset(("x",), VALUES[np.newaxis], (TARGET,), {"x": "x"})
SMOOTHING = StateSmoothing("x", "loess", 0.1, 0.05, 21, 3)
PREPARATION = Preparation(DATASET, Recording(("x",), ("x",), (), (), (), 1, 0.0, (SMOOTHING,), ()))
ENTRY = FrontEntry(1, 0.1, 0.1, 0, 0, 0, from_infix("x", ("x",)).to_bytes())


def verdict_on(shown: Refined | None, state: str = "done", why: str = "target", *, has_trajectories: bool = False):
    """Return the equation of a result with its verdict."""
    preparation = PREPARATION if has_trajectories else replace(PREPARATION, recording=None)
    refinement = Refinement({} if shown is None else {"x": shown})
    outcome = VariableOutcome("x", (ENTRY,) if shown is not None else (), 1, why=why)
    account = Account(state, 1.0, 1.0)
    (equation,) = build_result("j", JobConfig(), preparation, [outcome], account, refinement).equations
    return equation


def test_a_verdict_is_given_when_the_job_has_ended() -> None:
    shown = Refined(0, from_infix("x", ("x",)), 1e-12, 1e-24)
    assert verdict_on(shown, "running").verdict is None
    assert verdict_on(shown).verdict == "exact"
    worse = replace(shown, program=from_infix("2.0*x", ("x",)), error=0.4, mse=0.3)
    assert verdict_on(worse, "cancelled").verdict == "doubtful"
    nothing = verdict_on(None)
    assert (nothing.verdict, nothing.reason, nothing.checks) == ("no model", "The search has found no equation.", ())
    unsimulated = verdict_on(shown, has_trajectories=True)
    assert unsimulated.verdict == "doubtful"
    assert "not simulated" in unsimulated.reason
    judged = replace(shown, grade="good", reason="Because.")
    equation = verdict_on(judged, has_trajectories=True)
    assert (equation.verdict, equation.reason, equation.checks) == ("good", "Because.", ())


@pytest.mark.parametrize(("why", "said"), [("max-time", "time limit"), ("cancelled", "was cancelled")])
def test_a_search_that_was_stopped_leaves_no_good_equation(why: str, said: str) -> None:
    judged = Refined(0, from_infix("x", ("x",)), 1e-3, 1e-6, grade="good", reason="Because.")
    verdict = verdict_on(judged, why=why, has_trajectories=True)
    assert verdict.verdict == "doubtful"
    assert said in verdict.reason
    assert verdict.checks[-1].outcome == "not made"
    exact = verdict_on(replace(judged, grade="exact"), why=why, has_trajectories=True)
    assert exact.verdict == "exact"


@pytest.mark.parametrize(("state", "why"), [("done", "max-time"), ("cancelled", "cancelled"), ("cancelled", "target")])
def test_the_check_of_time_does_not_pass_where_an_equation_that_nobody_refined_was_stopped(
    state: str, why: str
) -> None:
    """Neither a target nor an equation that was to be simulated."""
    shown = Refined(0, from_infix("x", ("x",)), 1e-12, 1e-24)
    for has_trajectories in (False, True):
        verdict = verdict_on(shown, state, why, has_trajectories=has_trajectories)
        assert verdict.verdict == "doubtful"
        time = next(check for check in verdict.checks if check.name == "time")
        assert time.outcome == "not made"
        assert ("--max-time" in time.reason, "was cancelled" in time.reason) == (state == "done", state == "cancelled")


def test_a_verdict_names_the_term_that_units_contradict() -> None:
    faults = EquationUnits((None,), (), ("the argument x of a function has the unit m instead of none",))
    shown = Refined(0, from_infix("2*exp(x)", ("x",)), 0.0, 0.0, grade="good", reason="It fits.", units=faults)
    equation = verdict_on(shown, has_trajectories=True)
    assert equation.verdict == "doubtful"
    assert "the argument x of a function has the unit m" in equation.reason


def test_candidates_stand_in_the_order_of_their_length() -> None:
    texts = {"3*x": 2.0, "x": 0.0, "x*x": 7.0}
    made = [Alternative(from_infix(text, ("x",)), nats, 0.9, is_shown=text == "x") for text, nats in texts.items()]
    shown = Refined(0, made[1].program, 0.1, 0.1, alternatives=tuple(made), grade="good", reason="Because.")
    candidates = verdict_on(shown, has_trajectories=True).candidates
    assert [(candidate.expression, candidate.nats, candidate.selected) for candidate in candidates] == [
        ("x", 0.0, True),
        ("3.0*x", 2.0, False),
        ("x**2", 7.0, False),
    ]
    assert candidates[0].held_out_r2 is None


def test_a_guess_is_listed_however_far_behind_it_is() -> None:
    programs = [from_infix("x", ("x",)), *(from_infix(f"{number}.5*x", ("x",)) for number in range(1, 40))]
    made = [Alternative(program, float(place), None, is_shown=not place) for place, program in enumerate(programs)]
    made[-1] = replace(made[-1], origin="guess")
    shown = Refined(0, programs[0], 0.1, 0.1, alternatives=tuple(made), grade="good", reason="Because.")
    candidates = verdict_on(shown, has_trajectories=True).candidates
    assert len(candidates) < len(made)
    assert candidates[-1].origin == "guess"
