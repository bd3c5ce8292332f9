"""Implicit steps against scipy, also where explicit steps fail; their sensitivities against finite differences."""

import numpy as np
import pytest

from atoll_coordinator.model.shooting.kernels.implicit import STIFF, eliminate
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, QUICK, integrate_segments
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.integration import integrate

NAMES = ("x", "y", "u")
TIMES = np.array([0.0, 0.05, 0.2, 0.31, 0.6, 0.7, 1.1, 1.2])
WAVE, RISE = np.cos(3.0 * TIMES)[None], -3.0 * np.sin(3.0 * TIMES)[None]
SYSTEMS = {
    "predator and prey": ("3*x - 2*x*y - x**2", "2*y - x*y - y**2"),
    "driven": ("y", "-2*x - 0.3*y + 1.5*u"),
    "fractions": ("1.5 - x*y/(1 + 0.5*x**2)", "u*u/(x + 2) - y"),
}
STEEP = ("2000*(cos(y) - x)", "1.5*x - 0.2*y + 0*u")
"""x follows cos(y) within half a millisecond."""


def parsed(texts):
    return [from_infix(text, NAMES) for text in texts]


def integrated(texts, start, *, table=STIFF, tolerance=1e-7, values=None, budget=100_000, limit=1e3):
    """Return the result of `integrate_segments`, states (D, N) and sensitivities (N, D, Q).

    `values` replace the constants.
    """
    system = system_of(parsed(texts), NAMES, NAMES)
    system = system if values is None else system.with_values(values)
    states = len(system.outputs)
    simulated = np.full((states, len(TIMES)), np.nan)
    gradients = np.full((len(TIMES), states, len(system.places) + states), np.nan)
    done = integrate_segments(
        table, system.tape, system.owners, (TIMES, WAVE, RISE), np.array([[0, len(TIMES)]]), np.array([start], float),
        np.full(states, tolerance), np.array([[-limit, limit]] * states), budget, True, simulated, gradients,
        np.zeros(1, np.int64),
    )  # fmt: skip
    return done, simulated, gradients


@pytest.mark.parametrize("texts", SYSTEMS.values(), ids=SYSTEMS)
def test_states_are_those_of_scipy(texts):
    done, simulated, _ = integrated(texts, [0.7, 0.4])
    assert done == 1
    assert simulated == pytest.approx(integrate(parsed(texts), np.array([0.7, 0.4]), TIMES, WAVE, RISE), abs=2e-5)


def test_the_error_falls_with_the_tolerance():
    expected = integrate(parsed(SYSTEMS["driven"]), np.array([0.7, 0.4]), TIMES, WAVE, RISE)
    errors = [
        np.abs(integrated(SYSTEMS["driven"], [0.7, 0.4], tolerance=tolerance)[1] - expected).max()
        for tolerance in (1e-4, 1e-8)
    ]
    assert errors[1] < 0.01 * errors[0] < 1e-4


@pytest.mark.parametrize("texts", [*SYSTEMS.values(), STEEP], ids=[*SYSTEMS, "steep"])
def test_sensitivities_are_differences_of_perturbed_integrations(texts):
    start = np.array([0.7, 0.4])
    values = system_of(parsed(texts), NAMES, NAMES).values
    _, _, gradients = integrated(texts, start)
    for column in range(gradients.shape[2]):
        change = np.zeros(gradients.shape[2])
        size = values[column] if column < len(values) else 1.0
        change[column] = 1e-4 * max(abs(size), 1e-2)
        up, down = (
            integrated(texts, start + sign * change[len(values) :], values=values + sign * change[: len(values)])[1]
            for sign in (1.0, -1.0)
        )
        differences = ((up - down) / (2.0 * change[column])).T
        assert gradients[:, :, column] == pytest.approx(
            differences, rel=0.02, abs=3e-3 * (np.abs(differences).max() + 1e-3)
        )


def test_a_stiff_system_takes_few_implicit_steps_but_too_many_explicit_ones():
    budget = 20 * len(TIMES)
    done, simulated, _ = integrated(STEEP, [0.9, 0.4], tolerance=1e-5, budget=budget)
    assert done == 1
    assert simulated[0, 1:] == pytest.approx(np.cos(simulated[1, 1:]), abs=2e-3)
    assert integrated(STEEP, [0.9, 0.4], table=QUICK, tolerance=1e-5, budget=budget)[0] == -1


@pytest.mark.parametrize("table", [STIFF, QUICK, PRECISE], ids=["stiff", "quick", "precise"])
def test_what_blows_up_is_told_from_what_takes_too_many_steps(table):
    assert integrated(("x*x + 1", "y"), [1.0, 0.4], table=table, tolerance=1e-5)[0] == 0
    assert integrated(("y", "-2*x - 0.3*y"), [1.0, 0.4], table=table, tolerance=1e-5, budget=3)[0] == -1


def test_what_has_no_rates_ends_at_once():
    assert integrated(("log(0 - x)", "y"), [1.0, 0.4])[0] == 0


@pytest.mark.slow
def test_elimination_exchanges_rows():
    matrix, right = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 3.0], [4.0, 5.0, 0.0]]), np.arange(6.0).reshape(3, 2)
    expected = np.linalg.solve(matrix, right)
    assert eliminate(matrix.copy(), right)
    assert right == pytest.approx(expected)


def test_a_singular_matrix_is_refused():
    assert not eliminate(np.array([[1.0, 2.0], [2.0, 4.0]]), np.ones((2, 1)))
