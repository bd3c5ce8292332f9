"""How sure constants are where errors of measurement may go together: least squares of lines as an oracle."""

import numpy as np
import pytest

from atoll_coordinator.model.constants.standard_errors import student_quantile_95
from atoll_coordinator.model.inference.residual_covariance import expected_variance_inflation
from atoll_core.data.dataset import FloatArray


def _errors(rng: np.random.Generator, rows: int, correlation: float) -> FloatArray:
    errors = rng.normal(size=rows)
    for row in range(1, rows):
        errors[row] = correlation * errors[row - 1] + np.sqrt(1.0 - correlation**2) * errors[row]
    return errors


def _fitted(rows: int, correlation: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return columns of a line, its residuals, and its estimate, of which the truth is (0, 0)."""
    columns = np.column_stack([np.linspace(0.0, 1.0, rows), np.ones(rows)])
    errors = _errors(np.random.default_rng([seed, 5]), rows, correlation)
    estimate = np.linalg.lstsq(columns, errors, rcond=None)[0]
    return columns, errors - columns @ estimate, estimate


def _widening(columns: FloatArray, residuals: FloatArray, owners: FloatArray | None = None) -> float:
    rows = len(residuals)
    numbers = np.zeros(rows, np.int64) if owners is None else owners.astype(np.int64)
    return expected_variance_inflation(columns, residuals, numbers, np.arange(rows, dtype=np.float64), 2)


def _coverage(rows: int, correlation: float, *, is_widened: bool) -> float:
    hits = []
    for seed in range(400):
        columns, residuals, estimate = _fitted(rows, correlation, seed)
        variance = residuals @ residuals / (rows - 2) * np.linalg.inv(columns.T @ columns)
        wide = _widening(columns, residuals) if is_widened else 1.0
        hits.append(abs(estimate[0]) <= student_quantile_95(rows - 2) * np.sqrt(wide * variance[0, 0]))
    return float(np.mean(hits))


def test_intervals_of_few_rows_hold_the_truth_whether_errors_are_correlated_or_not() -> None:
    assert _coverage(10, 0.6, is_widened=False) < 0.85  # what is mended
    assert _coverage(10, 0.6, is_widened=True) >= 0.89
    assert 0.95 <= _coverage(10, 0.0, is_widened=True) < 1.0


@pytest.mark.parametrize(("correlation", "low", "high"), [(0.0, 1.0, 1.2), (0.8, 4.0, 12.0)])
def test_many_rows_decide_for_themselves(correlation: float, low: float, high: float) -> None:
    """Of a slow column n/(1 - r)*(1 + r) rows count as n."""
    columns, residuals, _ = _fitted(600, correlation, 1)
    assert low <= _widening(columns, residuals) <= high


def test_rows_of_different_trajectories_are_not_neighbours() -> None:
    _, residuals, _ = _fitted(40, 0.8, 3)
    columns = np.column_stack([np.linspace(0.0, 1.0, 40), np.ones(40)])
    assert _widening(columns, residuals, np.arange(40.0)) == pytest.approx(1.0)


def test_nothing_is_said_where_no_row_is_left() -> None:
    columns = np.column_stack([np.linspace(0.0, 1.0, 2), np.ones(2)])
    assert _widening(columns, np.zeros(2)) == 1.0


def test_columns_without_effect_do_not_count() -> None:
    columns, residuals, _ = _fitted(30, 0.3, 2)
    with_empty = np.column_stack([columns, np.zeros(30)])
    assert _widening(with_empty, residuals) == pytest.approx(_widening(columns, residuals))
