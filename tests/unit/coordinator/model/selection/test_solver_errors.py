"""The errors of the solver that computed a table: found where the equations are the law, and only there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.selection.candidates import collect_candidates
from atoll_coordinator.model.selection.solver_errors import subtract_solver_errors
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.infix import to_infix
from tests.unit.coordinator.model.shooting.made import Known, pools, table

CONFIG = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "/")))
ROOTS = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "/", "sqrt")))
TIMES = np.linspace(0.0, 12.0, 120)
STARTS = [(10.0, 5.0), (3.0, 2.0)]
LAW = ("1.1*x - 0.4*x*y", "0.1*x*y - 0.4*y")


@dataclass(frozen=True)
class Computed(Known):
    """Solutions with the errors of a solver."""

    method: str = "RK45"
    rtol: float = 1e-3

    def values(self, start: Sequence[float], times: FloatArray) -> FloatArray:
        span = (float(times[0]), float(times[-1]))
        return solve_ivp(self.rates, span, start, self.method, times, rtol=self.rtol).y


def predation(_: float, z: Sequence[float]) -> Sequence[float]:
    return [1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]]


def convection(_: float, z: Sequence[float]) -> Sequence[float]:
    return [10.0 * (z[1] - z[0]), z[0] * (28.0 - z[2]) - z[1], z[0] * z[1] - 8.0 / 3.0 * z[2]]


def corrected(
    known: Known, texts: Sequence[str], noise: float = 0.0, starts: Sequence[Sequence[float]] = STARTS,
    times: FloatArray = TIMES,
) -> ModellingTask | None:  # fmt: skip
    """Return the task without the errors of a solver, by these equations fitted to short pieces."""
    prepared = prepare(table(known, starts, times, noise), CONFIG)
    given = {name: (name,) for name in prepared.dataset.names}
    candidates = collect_candidates(prepared.dataset, CONFIG, pools(prepared, **given))
    task = ModellingTask(prepared.dataset, prepared.recording, CONFIG, candidates)
    comparison = task.make_comparison(task.compared_measurements, task.variables)
    fit = comparison.fit_model([known.parsed(text) for text in texts], lengths=(10,))
    return subtract_solver_errors(task, fit.fit)


@pytest.mark.parametrize(("method", "rtol"), [("RK45", 1e-3), ("RK45", 1e-6), ("LSODA", 1e-3)])
def test_without_the_errors_of_its_solver_a_table_is_the_exact_solution(method, rtol):
    task = corrected(Computed(("x", "y"), predation, method=method, rtol=rtol), LAW)
    exact = Known(("x", "y"), predation)
    assert f"{method}, rtol={rtol:g}" in task.solver
    for part, start in zip(task.recording.trajectories, STARTS, strict=True):
        np.testing.assert_allclose(part.measured, exact.values(start, TIMES), rtol=1e-6)
    assert max(smoothing.relative_noise for smoothing in task.recording.smoothing) < 1e-8


def test_along_chaotic_trajectories_simple_numbers_are_known_exactly():
    """After 35 time units of Lorenz's system the sixteenth digit of a constant decides."""
    known = Computed(("x", "y", "z"), convection)
    texts = ("10.02*y - 10.02*x", "27.98*x - x*z - y", "x*y - 2.667*z")
    task = corrected(known, texts, starts=[(1.0, 1.0, 1.0)], times=np.linspace(0.0, 36.0, 1800))
    assert task is not None
    assert "RK45, rtol=0.001" in task.solver


@pytest.mark.parametrize(
    ("known", "texts", "noise"),
    [
        (Computed(("x", "y"), predation), ("1.1*x - 0.4*x*y", "0.1*x*y - 0.38*y - 0.002*y**2"), 1e-6),
        (Computed(("x", "y"), predation), ("1.1*x - 0.4*x*y", "0.02*x*x - 0.4*y"), 0.0),
        (Computed(("x", "y"), predation, method="Radau"), LAW, 0.0),
        (Known(("x", "y"), predation), LAW, 0.0),
    ],
    ids=["noise", "wrong law", "other solver", "exact"],
)
def test_nothing_is_taken_off_where_the_solver_would_not_give_these_rows(known, texts, noise):
    assert corrected(known, texts, noise) is None


@pytest.mark.parametrize("first", [np.nan, -1.0])
def test_a_held_out_trajectory_that_cannot_be_solved_leaves_the_table_as_it_is(first):
    """Its first row is missing, or the law has no value there: a solver would never end its first step."""
    known = Computed(("x",), lambda _, z: [0.9 - np.sqrt(z[0])])
    prepared = prepare(table(known, [(4.0,), (0.2,), (2.0,)], 0.1 * np.arange(80.0)), ROOTS)
    *others, last = prepared.recording.trajectories
    last = replace(last, measured=np.where(np.arange(80) == 0, first, last.measured), held_out=True)
    recording = replace(prepared.recording, trajectories=(*others, last))
    candidates = collect_candidates(prepared.dataset, ROOTS, pools(prepared, x=("x",)))
    task = ModellingTask(prepared.dataset, recording, ROOTS, candidates)
    comparison = task.make_comparison(task.compared_measurements, task.variables)
    fit = comparison.fit_model([known.parsed("0.9 - sqrt(x)")], lengths=(10,))
    assert subtract_solver_errors(task, fit.fit) is None
    task = replace(task, recording=prepared.recording)
    assert subtract_solver_errors(task, fit.fit) is not None


def test_no_further_candidates_are_sought_once_a_solver_computes_the_rows(caplog):
    """The equation of y with a term too many describes the rows better in nats; the law gives all digits."""
    prepared = prepare(table(Computed(("x", "y"), predation), STARTS, TIMES), CONFIG)
    pool = pools(prepared, x=(LAW[0],), y=(LAW[1], "0.1*x*y - 0.4*y - 0.003*x"))
    with caplog.at_level("INFO"):
        made = refine_all(prepared, CONFIG, pool)
    assert [made.equations[name].grade for name in ("x", "y")] == ["exact", "exact"]
    assert [len(made.equations[name].constants) for name in ("x", "y")] == [2, 2]
    assert "rows computed by a known solver" in caplog.text
    assert "sums by pursuit" not in caplog.text


@pytest.mark.parametrize("amplitude", [0.25, 0.35])
def test_a_system_close_to_the_law_is_not_taken_for_it_although_the_solver_nearly_gives_the_rows(amplitude):
    """Of small swings a cubic differs from the sine by a millionth, a thousandth of the errors of the solver."""
    pendulum = Computed(("x", "y"), lambda _, z: [z[1], -np.sin(z[0])])
    config = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "/", "sin", "cos")))
    prepared = prepare(table(pendulum, [(amplitude, 0.0)], np.linspace(0.0, 12.0, 200)), config)
    pool = pools(prepared, x=("y",), y=("-sin(x)", "0.1666*x*x*x - x", "-x"))
    made = refine_all(prepared, config, pool)
    assert made.equations["y"].grade == "exact"
    assert to_infix(made.equations["y"].program, ("x", "y")) == "-sin(x)"


@pytest.mark.slow
def test_terms_that_follow_a_solver_are_left_out_and_it_is_named():
    known = Computed(("x", "y"), predation)
    prepared = prepare(table(known, STARTS, TIMES), CONFIG)
    crumbs = ("1.1*x - 0.4*x*y + 0.002*y", "0.1*x*y - 0.4*y - 0.003*x")
    pool = pools(prepared, x=(LAW[0], crumbs[0]), y=(LAW[1], crumbs[1]))
    made = refine_all(prepared, CONFIG, pool)
    assert [made.equations[name].grade for name in ("x", "y")] == ["exact", "exact"]
    assert [len(made.equations[name].constants) for name in ("x", "y")] == [2, 2]
    assert any("RK45" in warning for warning in made.warnings)
    measured = made.simulation.trajectories[0].measured
    np.testing.assert_allclose([measured["x"], measured["y"]], known.values(STARTS[0], TIMES), rtol=1e-6)
