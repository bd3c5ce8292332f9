"""The integration kernels against scipy, and their sensitivities against finite differences of integrations."""

import json
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.shooting.kernels.implicit import STIFF
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, QUICK, integrate_segments, largest_sizes
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from atoll_coordinator.model.shooting.warmup import TOLERANCES
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, OPERATORS, POW, VARIABLE
from atoll_core.expression.program import Program, with_constants
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.integration import integrate
from tests.unit.coordinator.model.shooting.made import DECAY, measurements
from tests.unit.documents import ROOT

NAMES = ("x", "y", "u")
TIMES = np.array([0.0, 0.05, 0.2, 0.31, 0.6, 0.7, 1.1, 1.2])
WAVE, RISE = np.cos(3.0 * TIMES)[None], -3.0 * np.sin(3.0 * TIMES)[None]
WIDE = np.array([[-1e3, 1e3], [-1e3, 1e3]])
WHOLE = np.array([[0, len(TIMES)]], dtype=np.int64)


def integrated(
    programs, start, *, table=PRECISE, tolerance=1e-9, times=TIMES, inputs=WAVE, input_slopes=RISE, segments=WHOLE,
    limits=WIDE, budget=100_000, wants=True,
):  # fmt: skip
    """Return the number of integrated segments, states (D, N) and sensitivities (N, D, Q)."""
    system = programs if not isinstance(programs, list) else system_of(programs, NAMES, NAMES)
    states = len(system.outputs)
    starts = np.atleast_2d(np.asarray(start, dtype=np.float64))
    simulated = np.full((states, len(times)), np.nan)
    gradients = np.full((len(times), states, len(system.places) + states), np.nan)
    done = integrate_segments(
        table, system.tape, system.owners, (times, inputs, input_slopes), segments, starts, np.full(states, tolerance),
        np.ascontiguousarray(limits[:states]), budget, wants, simulated, gradients, np.zeros(1, np.int64),
    )  # fmt: skip
    return done, simulated, gradients


def parsed(*texts):
    return [from_infix(text, NAMES) for text in texts]


SYSTEMS = {
    "predator and prey": ("3*x - 2*x*y - x**2", "2*y - x*y - y**2"),
    "driven": ("y", "-2*x - 0.3*y + 1.5*u"),
    "swinging": ("y", "-4*sin(x) + 0.2*u*cos(2*y)"),
    "fractions": ("1.5 - x*y/(1 + 0.5*x**2)", "u*u/(x + 2) - y"),
}


@pytest.mark.parametrize("texts", SYSTEMS.values(), ids=SYSTEMS)
@pytest.mark.parametrize(("table", "tolerance", "error"), [(PRECISE, 1e-9, 3e-8), (QUICK, 1e-6, 3e-5)])
def test_states_are_those_of_scipy(texts, table, tolerance, error):
    programs = parsed(*texts)
    done, simulated, _ = integrated(programs, [0.7, 0.4], table=table, tolerance=tolerance)
    assert done == 1
    expected = integrate(programs, np.array([0.7, 0.4]), TIMES, WAVE, RISE)
    assert simulated == pytest.approx(expected, abs=error)


@pytest.mark.parametrize("table", [PRECISE, QUICK], ids=["precise", "quick"])
def test_the_error_falls_with_the_tolerance(table):
    programs = parsed(*SYSTEMS["swinging"])
    expected = integrate(programs, np.array([0.7, 0.4]), TIMES, WAVE, RISE)
    errors = [
        np.abs(integrated(programs, [0.7, 0.4], table=table, tolerance=tolerance)[1] - expected).max()
        for tolerance in (1e-3, 1e-5, 1e-7)
    ]
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


@pytest.mark.parametrize("table", [PRECISE, QUICK], ids=["precise", "quick"])
def test_the_weights_make_a_method_of_the_order_that_is_claimed(table):
    weights, nodes, errors, order = table
    assert weights.sum(axis=1) == pytest.approx(nodes, abs=1e-15)
    assert errors.sum() == pytest.approx(0.0, abs=1e-15)
    last, lower = weights[-1], weights[-1] - errors[:-1]
    for power in range(int(order)):
        expected = 1.0 / (power + 1)
        assert last @ nodes[:-1] ** power == pytest.approx(expected, abs=1e-14)
        if power < order - 1:
            embedded = lower @ nodes[:-1] ** power - errors[-1] * nodes[-1] ** power
            assert embedded == pytest.approx(expected, abs=1e-14)


def chain(code):
    """Return c2 op(c1 x, c3) - 0.1 y, or for a unary operator c2 op(c1 x) - 0.1 y."""
    nodes = [(VARIABLE, 0, 0, 0.0), (CONSTANT, 0, 0, 0.7), (MULTIPLY, 1, 0, 0.0), (CONSTANT, 0, 0, 1.3)]
    nodes += [(code, 2, 3 if ARITY[code] == 2 else 0, 0.0), (CONSTANT, 0, 0, -0.2), (MULTIPLY, 5, 4, 0.0)]
    nodes += [(VARIABLE, 1, 0, 0.0), (CONSTANT, 0, 0, -0.1), (MULTIPLY, 8, 7, 0.0), (ADD, 6, 9, 0.0)]
    codes, lefts, rights, values = zip(*nodes, strict=True)
    return Program(np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(values))


def differences(programs, start, step=1e-5):
    """Return the sensitivities (N, D, Q) from central differences with this `step`."""
    system = system_of(programs, NAMES, NAMES)
    columns = []
    for p in range(len(system.places)):
        both = []
        for sign in (1.0, -1.0):
            values = system.values
            values[p] += sign * step
            both.append(integrated(system.with_values(values), start, tolerance=1e-11, wants=False)[1])
        columns.append((both[0] - both[1]) / (2.0 * step))
    for d in range(len(start)):
        shift = step * np.eye(len(start))[d]
        both = [integrated(system, start + sign * shift, tolerance=1e-11, wants=False)[1] for sign in (1.0, -1.0)]
        columns.append((both[0] - both[1]) / (2.0 * step))
    return np.array(columns).transpose(2, 1, 0)


@pytest.mark.parametrize(
    "code", [operator.code for operator in OPERATORS if operator.arity], ids=lambda code: OPERATORS[code].name
)
def test_sensitivities_are_the_differences_for_every_operator(code):
    """The argument has both signs if the operator has values for negative arguments."""
    other = from_infix("0.3*x - 0.5*y + 0.2*u", NAMES)
    starts = [np.array([1.2, 0.4])]
    starts += [np.array([-1.2, 0.4])] if OPERATORS[code].name not in ("log", "sqrt", "pow") else []
    for start in starts:
        done, _, gradients = integrated([chain(code), other], start, tolerance=1e-11)
        assert done == 1
        assert gradients == pytest.approx(differences([chain(code), other], start), abs=2e-5, rel=1e-4)


def test_a_whole_power_of_a_negative_number_has_sensitivities():
    """The solution of x' = 0.1 (x - 3)^3, with the exponent held, has 1/(x - 3)^2 = 1/4 - t/5 for x(0) = 1."""
    program = from_infix("0.1*(x - 3.0)**2.5", NAMES)
    exponent = int(program.right[np.flatnonzero(program.operators == POW)[0]])
    program = with_constants(program, {exponent: 3.0})
    system = system_of([program], NAMES, NAMES, [{exponent}])
    still = np.zeros((2, len(TIMES)))
    done, simulated, gradients = integrated(system, [1.0], tolerance=1e-11, inputs=still, input_slopes=still)
    assert done == 1
    assert simulated[0] == pytest.approx(3.0 - (0.25 - TIMES / 5.0) ** -0.5, abs=1e-8)
    assert gradients[:, 0, -1] == pytest.approx((1.0 - 0.8 * TIMES) ** -1.5, rel=1e-5)


def test_the_first_row_is_the_start_and_segments_begin_anew():
    segments = np.array([[0, 3], [3, 4], [4, len(TIMES)]], dtype=np.int64)
    starts = [[0.7, 0.4], [1.0, 2.0], [-0.5, 0.1]]
    programs = parsed(*SYSTEMS["driven"])
    done, simulated, gradients = integrated(programs, starts, segments=segments)
    assert done == 3
    fitted = gradients.shape[2] - 2
    for (first, end), start in zip(segments.tolist(), starts, strict=True):
        assert simulated[:, first].tolist() == start
        assert gradients[first, :, fitted:].tolist() == np.eye(2).tolist()
        assert not gradients[first, :, :fitted].any()
        part = slice(first, end)
        if end > first + 1:
            expected = integrate(programs, np.array(start), TIMES[part], WAVE[:, part], RISE[:, part])
            assert simulated[:, part] == pytest.approx(expected, abs=1e-7)


def test_states_are_the_same_to_the_bit_without_sensitivities():
    programs = parsed(*SYSTEMS["fractions"])
    assert integrated(programs, [0.7, 0.4])[1].tolist() == integrated(programs, [0.7, 0.4], wants=False)[1].tolist()


def test_a_fixed_constant_has_no_column():
    program, other = parsed("-0.5*x + 0.25*y", "-y")
    places = np.flatnonzero(program.operators == CONSTANT).tolist()
    free = integrated([program, other], [1.0, 2.0])[2]
    held = integrated(system_of([program, other], NAMES, NAMES, [{places[0]}, ()]), [1.0, 2.0])[2]
    assert held.shape[2] == free.shape[2] - 1
    assert held.tolist() == free[:, :, 1:].tolist()


def test_a_blow_up_ends_the_segment_at_its_row_and_those_behind_are_not_tried():
    """The solution of x' = x^2, x(0) = 1, is 1/(1 - t). It reaches the limit 5 between the rows at 0.7 and 1.1."""
    programs = parsed("x*x", "0*y")
    segments = np.array([[0, 2], [2, 7], [7, 8]], dtype=np.int64)
    starts = [[1.0, 0.0], [1.0 / 0.8, 0.0], [3.0, 0.0]]
    limits = np.array([[-5.0, 5.0], [-5.0, 5.0]])
    done, simulated, _ = integrated(programs, starts, segments=segments, limits=limits)
    assert done == 1
    assert simulated[0, :6] == pytest.approx(1.0 / (1.0 - TIMES[:6]), rel=1e-6)
    assert np.isnan(simulated[:, 6:]).all()


@pytest.mark.parametrize("text", ["log(x)", "-1.0 - sqrt(x)", "1/(0.4 - x)", "-exp(8.0/x)"])
def test_where_the_rates_have_no_value_the_segment_ends(text):
    """x falls to zero, or the rate has a pole, between two rows."""
    done, simulated, _ = integrated(parsed(text, "0*y"), [0.3, 1.0])
    assert done == 0
    ended = np.isnan(simulated[0]).argmax()
    assert 0 < ended < len(TIMES)
    assert np.isfinite(simulated[:, :ended]).all()
    assert np.isnan(simulated[:, ended:]).all()


def test_rates_without_a_value_at_the_start_end_it_there():
    done, simulated, _ = integrated(parsed("log(x)", "0*y"), [-1.0, 1.0])
    assert done == 0
    assert simulated[:, 0].tolist() == [-1.0, 1.0]
    assert np.isnan(simulated[:, 1:]).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_step_too_wide_for_one_state_is_taken_again_whatever_the_other_says(order):
    """The first trial step reaches negative x, where the root has no value; shorter steps do not."""
    texts = ("0.001*sqrt(x) - 20.0*(x - 0.1)", "0.1")
    names = ("x", "y")
    swapped = [(texts[index], names[index]) for index in order]
    programs = [from_infix(text, NAMES) for text, _ in swapped]
    variables = (*(name for _, name in swapped), "u")
    system = system_of(programs, NAMES, variables)
    times = np.array([0.0, 1.0])
    still = np.zeros((1, 2))
    start = [{"x": 1.0, "y": 0.0}[name] for name in variables[:2]]
    done, simulated, _ = integrated(
        system, start, times=times, inputs=still, input_slopes=still, segments=np.array([[0, 2]], dtype=np.int64)
    )
    assert done == 1
    assert dict(zip(variables, simulated[:, 1], strict=False)) == pytest.approx({"x": 0.1, "y": 0.1}, abs=1e-3)


def test_when_the_steps_are_used_up_the_rows_before_stay():
    """A stiff system needs many steps; with a smaller budget fewer rows are reached."""
    programs = parsed("-3000.0*(x - u)", "0*y")
    reached = []
    for budget in (100, 400, 1200):
        done, simulated, _ = integrated(programs, [1.0, 0.0], budget=budget)
        assert done == -1
        ended = int(np.isnan(simulated[0]).argmax())
        assert simulated[0, 1:ended] == pytest.approx(WAVE[0, 1:ended], abs=0.01)
        reached.append(ended)
    assert reached == sorted(set(reached))
    assert integrated(programs, [1.0, 0.0], budget=100_000)[0] == 1


@settings(max_examples=30, deadline=None)
@given(
    rate=st.floats(-3.0, 1.0),
    level=st.floats(-2.0, 2.0),
    start=st.floats(-2.0, 2.0),
    cuts=st.sets(st.integers(1, len(TIMES) - 1)),
)
def test_a_linear_equation_is_solved_whatever_the_segments(rate, level, start, cuts):
    """x' = r x + l has states and sensitivities in closed form.

    The trajectory is split into segments anywhere; their initial states are points of the solution.
    """
    program = from_infix("0.5*x + 0.25", NAMES)
    system = system_of([program], NAMES, ("x", "u", "y"))
    system = system.with_values(np.array([rate, level]))
    powers = TIMES[:, None] * (rate * TIMES[:, None]) ** np.arange(25) / np.cumprod([1.0, *range(2, 26)])
    integral = powers.sum(axis=1)
    expected = start * np.exp(rate * TIMES) + level * integral
    edges = [0, *sorted(cuts), len(TIMES)]
    segments = np.array(list(pairwise(edges)), dtype=np.int64)
    still = np.zeros((2, len(TIMES)))
    done, simulated, gradients = integrated(
        system, expected[segments[:, :1]], segments=segments, inputs=still, input_slopes=still
    )
    assert done == len(segments)
    assert simulated[0] == pytest.approx(expected, abs=1e-7)
    since = TIMES - TIMES[np.repeat(segments[:, 0], np.diff(segments, axis=1)[:, 0])]
    assert gradients[:, 0, 2] == pytest.approx(np.exp(rate * since), abs=1e-3)  # only the states control the steps


TINY = """
import json, sys
from tests.unit.coordinator.model.shooting.kernels.test_integrate import numbers
sys.stdout.write(json.dumps(numbers()))
"""


def numbers():
    """Return states and sensitivities of some systems (one without finite rates) and a fit, from both methods."""
    with np.errstate(all="ignore"):
        parts = [
            part
            for table in (PRECISE, QUICK)
            for texts in (*SYSTEMS.values(), ("exp(900.0*x)", "tanh(y)"))
            for part in integrated(parsed(*texts), [0.7, 0.4], table=table)[1:]
        ]
        parts += [fitted for precision in TOLERANCES for fitted in small_fit(precision)]
    return np.concatenate([part.ravel() for part in parts]).tolist()


def small_fit(precision):
    times = 0.1 * np.arange(12.0)
    estimator = MultipleShooting(measurements(DECAY, [[2.0]], times, noise=0.01), precision)
    fit = estimator.fit(system_of([DECAY.parsed("-0.4*x")], DECAY.names, DECAY.names), 6, 5)
    return fit.system.values, fit.starts, fit.blocks.normal, fit.simulated


@pytest.mark.slow
def test_interpreted_kernels_give_the_numbers_of_the_compiled_ones():
    """The bits may differ, because the interpreter may take sine and cosine from another library."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    finished = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", TINY], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert finished.returncode == 0, finished.stderr
    assert json.loads(finished.stdout) == pytest.approx(numbers(), rel=1e-9, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("table", [PRECISE, QUICK, STIFF], ids=["precise", "quick", "stiff"])
def test_an_input_without_slopes_is_held_until_the_next_row(table):
    """For dx/dt = u - x, x approaches the value that u has at the row before."""
    inputs = np.array([[1.0, -2.0, 0.0, 5.0, 5.0, 1.0, -1.0, 9.0]])
    programs = parsed("u - x", "0*y")
    tolerance = 1e-9 if table is PRECISE else 1e-6
    _, simulated, gradients = integrated(
        programs, [0.5, 0.0], table=table, tolerance=tolerance, inputs=inputs, input_slopes=np.full((1, 8), np.nan)
    )
    expected = [0.5]
    for width, u in zip(np.diff(TIMES), inputs[0], strict=False):
        expected.append(u + (expected[-1] - u) * np.exp(-width))
    assert simulated[0] == pytest.approx(expected, abs=100.0 * tolerance)
    assert gradients[:, 0, -2] == pytest.approx(np.exp(-TIMES), abs=1e4 * tolerance)


def test_largest_sizes_are_numpys_and_infinite_where_a_value_is_not_finite():
    gradients = np.random.default_rng(1).normal(size=(40, 2, 5))
    sizes = np.empty((2, 5))
    largest_sizes(gradients, sizes)
    assert (sizes == np.abs(gradients).max(axis=0)).all()
    gradients[3, 0, 1], gradients[7, 1, 4], gradients[8, 1, 0] = np.nan, -np.inf, np.nan
    largest_sizes(gradients, sizes)
    expected = np.abs(gradients).max(axis=0)
    assert (sizes == np.where(np.isfinite(expected), expected, np.inf)).all()
    largest_sizes(gradients[:0], sizes)
    assert not sizes.any()
