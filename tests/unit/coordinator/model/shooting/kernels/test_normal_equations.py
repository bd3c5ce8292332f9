"""The normal equations of a trajectory fit, and their solution, against dense matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.shooting.kernels.innovations import innovate, innovate_smooth
from atoll_coordinator.model.shooting.kernels.normal_equations import LINES, normal_equations, solve_step

SEGMENTS = np.array([[0, 5], [5, 6], [6, 14]], dtype=np.int64)
ROWS = 14
STEPS = np.where(np.arange(ROWS) % 3 == 0, 2.0, 1.0)


def drawn(fitted, states, observed, seed=0):
    """Return residuals and weights (O, N) and sensitivities (N, D, Q)."""
    draw = np.random.default_rng(seed)
    weights = draw.uniform(0.5, 2.0, (len(observed), ROWS))
    weights[draw.uniform(size=weights.shape) < 0.2] = 0.0
    return draw.normal(size=weights.shape), weights, draw.normal(size=(ROWS, states, fitted + states))


def blocks(segments, observed, residuals, weights, gradients, shares=(0.0, 0.0), decays=(0.0, 0.0)):
    """Return the blocks of the normal equations: J'WJ as (P, P), (G, P, D), (G, D, D), and J'Wr."""
    states = gradients.shape[1]
    fitted, groups, columns = gradients.shape[2] - states, len(segments), gradients.shape[2] + 1
    made = (
        np.zeros((fitted, fitted)), np.zeros((groups, fitted, states)), np.zeros((groups, states, states)),
        np.zeros(fitted), np.zeros((groups, states)),
    )  # fmt: skip
    normal_equations(
        segments, observed, STEPS, residuals, weights, np.array(shares), np.array(decays), gradients, fitted, *made,
        np.empty((LINES, columns)), np.empty(columns), np.empty((columns, columns)),
    )  # fmt: skip
    return made


def dense(segments, observed, residuals, weights, gradients):
    """Return J'WJ and J'Wr with one column for each constant, then one for each state of each segment."""
    states = gradients.shape[1]
    fitted, groups = gradients.shape[2] - states, len(segments)
    jacobian, left, right = [], [], []
    for group, (first, end) in enumerate(segments.tolist()):
        for row in range(first, end):
            for place, state in enumerate(observed.tolist()):
                line = np.zeros(fitted + groups * states)
                line[:fitted] = gradients[row, state, :fitted]
                line[fitted + group * states : fitted + (group + 1) * states] = gradients[row, state, fitted:]
                jacobian.append(line)
                left.append(weights[place, row])
                right.append(weights[place, row] * residuals[place, row])
    matrix = np.array(jacobian)
    return matrix.T @ (np.array(left)[:, None] * matrix), matrix.T @ np.array(right)


def assembled(normal, coupling, own, gradient, own_gradient):
    """Return the dense matrix and vector of these blocks."""
    fitted, (groups, states) = len(gradient), own_gradient.shape
    matrix = np.zeros((fitted + groups * states,) * 2)
    matrix[:fitted, :fitted] = normal
    for group in range(groups):
        part = slice(fitted + group * states, fitted + (group + 1) * states)
        matrix[:fitted, part], matrix[part, :fitted], matrix[part, part] = (
            coupling[group],
            coupling[group].T,
            own[group],
        )
    return matrix, np.concatenate([gradient, own_gradient.ravel()])


CASES = [(3, 2, [0, 1]), (0, 2, [0, 1]), (4, 1, [0]), (2, 4, [0, 1]), (5, 3, [1])]


@pytest.mark.parametrize(("fitted", "states", "observed"), CASES)
def test_blocks_are_those_of_the_dense_normal_equations(fitted, states, observed):
    parts = (np.array(observed, dtype=np.int64), *drawn(fitted, states, observed))
    expected, slope = dense(SEGMENTS, *parts)
    matrix, vector = assembled(*blocks(SEGMENTS, *parts))
    assert matrix == pytest.approx(expected, abs=1e-12)
    assert vector == pytest.approx(slope, abs=1e-12)


@pytest.mark.parametrize(("shares", "decays"), [((0.4, 0.9), (0.8, 0.5)), ((1.0, 0.0), (0.95, 0.0))])
def test_errors_that_go_together_are_weighted_by_their_inverse_covariance(shares, decays):
    observed, fitted = np.array([0, 1], dtype=np.int64), 3
    residuals, weights, gradients = drawn(fitted, 2, [0, 1])
    matrix, vector = np.zeros((fitted, fitted)), np.zeros(fitted)
    for state in (0, 1):
        for first, end in SEGMENTS.tolist():
            rows = first + np.flatnonzero(weights[state, first:end])
            inverse = np.linalg.inv(covariance(rows, weights[state], shares[state], decays[state]))
            jacobian = gradients[rows, state, :fitted]
            matrix += jacobian.T @ inverse @ jacobian
            vector += jacobian.T @ inverse @ residuals[state, rows]
    normal, _, _, gradient, _ = blocks(SEGMENTS, observed, residuals, weights, gradients, shares, decays)
    assert normal == pytest.approx(matrix, rel=1e-9)
    assert gradient == pytest.approx(vector, rel=1e-9, abs=1e-9)


def covariance(rows, weights, share, decay):
    """Return the covariance of errors at these rows: the correlation of `share` falls by `decay` per median step."""
    places = np.cumsum(STEPS)[rows]
    together = share * decay ** np.abs(places[:, None] - places[None]) if decay else share * np.eye(len(rows))
    return (together + (1.0 - share) * np.eye(len(rows))) / np.sqrt(np.outer(weights[rows], weights[rows]))


@pytest.mark.parametrize(("share", "decay"), [(0.0, 0.0), (0.4, 0.8), (1.0, 0.95)])
def test_innovations_have_the_likelihood_of_the_whole_covariance(share, decay):
    residuals, weights, _ = drawn(1, 1, [0])
    squares, logarithm = 0.0, 0.0
    for first, end in SEGMENTS.tolist():
        rows = first + np.flatnonzero(weights[0, first:end])
        whole = covariance(rows, weights[0], share, decay)
        squares += residuals[0, rows] @ np.linalg.solve(whole, residuals[0, rows])
        logarithm += np.linalg.slogdet(whole)[1] + np.log(weights[0, rows]).sum()
    sums = np.empty(2)
    innovate(SEGMENTS, STEPS, residuals[0], weights[0], share, decay, sums, np.empty(0))
    assert sums == pytest.approx([squares, logarithm])


def test_what_has_no_weight_does_not_count_even_if_it_is_no_number():
    observed = np.array([0, 1], dtype=np.int64)
    residuals, weights, gradients = drawn(3, 2, [0, 1])
    before = blocks(SEGMENTS, observed, residuals, weights, gradients)
    residuals[weights == 0.0] = np.nan
    assert all(
        same.tolist() == other.tolist()
        for same, other in zip(before, blocks(SEGMENTS, observed, residuals, weights, gradients), strict=True)
    )


def solved(made, damping):
    change, moves = np.full_like(made[3], np.nan), np.full_like(made[4], np.nan)
    return solve_step(*made, damping, change, moves), change, moves


@settings(max_examples=40, deadline=None)
@given(
    case=st.sampled_from(CASES),
    damping=st.sampled_from([1e-12, 1e-6, 1e-3, 1.0, 1e6]),
    unit=st.floats(-6.0, 6.0),
    seed=st.integers(0, 1000),
)
def test_the_step_is_that_of_the_damped_dense_equations(case, damping, unit, seed):
    """The units of the constants do not matter. In segments with few rows, damping determines the initial states."""
    fitted, states, observed = case
    residuals, weights, gradients = drawn(fitted, states, observed, seed)
    gradients[:, :, :1] *= 10.0**unit
    segments = np.array([[0, 7], [7, 14]], dtype=np.int64)
    parts = (np.array(observed, dtype=np.int64), residuals, np.maximum(weights, 0.1), gradients)
    made = blocks(segments, *parts)
    matrix, vector = assembled(*made)
    scale = np.sqrt(np.diag(matrix))
    unit_matrix = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
    done, change, moves = solved(made, damping)
    assert done
    expected = np.linalg.solve(unit_matrix, vector / scale)
    step = np.concatenate([change, moves.ravel()]) * scale
    assert step == pytest.approx(expected, rel=1e-4, abs=1e-6 * (1.0 + np.abs(expected).max()))


def test_the_arguments_are_left_as_they_are():
    parts = (np.array([0, 1], dtype=np.int64), *drawn(3, 2, [0, 1]))
    made = blocks(SEGMENTS, *parts)
    copies = [part.copy() for part in made]
    assert solved(made, 1e-3)[0]
    assert all(part.tolist() == copy.tolist() for part, copy in zip(made, copies, strict=True))


def test_a_constant_without_influence_stays_and_does_not_disturb():
    parts = (np.array([0, 1], dtype=np.int64), *drawn(3, 2, [0, 1]))
    parts[3][:, :, 1] = 0.0
    done, change, _ = solved(blocks(SEGMENTS, *parts), 1e-3)
    assert done
    assert change[1] == 0.0
    others = (*parts[:3], np.ascontiguousarray(np.delete(parts[3], 1, axis=2)))
    assert change[[0, 2]] == pytest.approx(solved(blocks(SEGMENTS, *others), 1e-3)[1])


def test_numbers_that_are_not_finite_are_no_step():
    parts = (np.array([0, 1], dtype=np.int64), *drawn(3, 2, [0, 1]))
    made = blocks(SEGMENTS, *parts)
    made[0][0, 0] = np.nan
    done, change, _ = solved(made, 1e-3)
    assert not done or np.isnan(change).any()


def test_what_is_smooth_is_as_likely_as_by_its_covariance():
    residuals, weights, _ = drawn(1, 1, np.array([0]), seed=4)
    share, rate, expected = 0.7, 0.3, np.zeros(2)
    for first, end in SEGMENTS.tolist():
        rows = np.arange(first, end)
        at = np.cumsum(STEPS)[rows]
        kept = weights[0, rows] > 0.0
        apart = rate * np.abs(at[:, None] - at)
        covariance = (share * (1.0 + apart + apart**2 / 3.0) * np.exp(-apart) + (1.0 - share) * np.eye(len(rows)))[
            kept
        ][:, kept]
        errors = (np.sqrt(weights[0, rows]) * residuals[0, rows])[kept]
        expected += errors @ np.linalg.solve(covariance, errors), np.linalg.slogdet(covariance)[1]
    sums = np.empty(2)
    innovate_smooth(
        SEGMENTS, STEPS, residuals[0], weights[0], share, rate, sums, *np.empty((3, 3, 3)), np.empty((2, 3))
    )
    assert sums == pytest.approx(expected)
