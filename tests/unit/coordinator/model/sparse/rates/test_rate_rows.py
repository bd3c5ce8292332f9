"""Rows by which laws of many variables are sought."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.rates.rate_rows import rate_rows
from atoll_coordinator.settings import SETTINGS
from tests.unit.coordinator.model.sparse.windows.enzyme import NAMES, prepared


@pytest.mark.slow
def test_as_many_rows_as_a_search_is_given_stand_for_all():
    few, many = (prepared(0.0, runs, 101).recording for runs in (10, 60))
    known = sum(int(np.isfinite(part.rate_errors[0]).sum()) for part in few.trajectories)
    assert len(rate_rows(few, NAMES, "a").values) == known
    rows = rate_rows(many, NAMES, "a")
    assert SETTINGS.rows.most <= len(rows.values) < 2 * SETTINGS.rows.most
    assert rows.inputs.shape == (2, len(rows.values))
    assert rows.errors.shape == rows.values.shape
    whole = np.concatenate([part.smoothed for part in many.trajectories], axis=1)
    assert np.isin(rows.inputs[0], whole[0]).all()
    assert np.median(np.abs(rows.values - (1.0 - 3.0 * rows.inputs[0] / (0.4 + rows.inputs[0])))) < 1e-4
