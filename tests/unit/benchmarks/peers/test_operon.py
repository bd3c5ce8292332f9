"""Operon as a peer: the target is measured in our terms, and its process is bounded."""

import numpy as np
import pytest

from atoll_core.errors import AtollError
from benchmarks.peers.operon import scaled_error, search_apart


@pytest.fixture
def file(tmp_path):
    x, y = np.random.default_rng(1).uniform(0.5, 3.0, (2, 60))
    rows = np.column_stack((3 * x - 2 * x * y, x, y))
    path = tmp_path / "some.csv"
    np.savetxt(path, rows, delimiter=",", header="label,x,y", comments="")
    return path


def test_the_error_is_that_of_the_scaled_model():
    values = np.array([1.0, 2.0, 3.0, 4.0])
    assert scaled_error(values, 5.0 - 2.0 * values) == pytest.approx(0.0, abs=1e-12)
    label = np.array([1.0, -1.0, -1.0, 1.0])
    assert scaled_error(values, label) == pytest.approx(1.0)
    assert scaled_error(np.ones(4), label) == 1.0
    assert scaled_error(np.array([1.0, np.nan, 1.0, 2.0]), label) is None


def test_a_process_that_fails_is_reported(tmp_path):
    with pytest.raises(AtollError, match=r"Operon failed on missing\.csv"):
        search_apart(tmp_path / "missing.csv", 0, 1e-4, 5.0)


def test_an_easy_equation_is_found(file):
    pytest.importorskip("pyoperon")
    run = search_apart(file, 0, 1e-4, 30.0)
    assert run.error is not None
    assert run.error < 1e-4
    assert run.seconds is not None
    assert run.seconds <= run.elapsed
    assert run.generations >= 1
