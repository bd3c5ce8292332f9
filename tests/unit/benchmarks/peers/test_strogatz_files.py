"""The Strogatz files: what must be there, SRBench's way to split and disturb them, and errors on their rows."""

import numpy as np
import pytest

from atoll_core.errors import DataError
from benchmarks.peers.strogatz_files import NAMES, rows_of, split, truths
from benchmarks.peers.strogatz_versus import measured_error


@pytest.fixture
def folder(tmp_path):
    for name in NAMES:
        rows = [f"{np.cos(index)},{index},{-index}" for index in range(400)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["label,x,y", *rows]) + "\n")
    (tmp_path / "truth.json").write_text('{"glider1": "x"}')
    return tmp_path


@pytest.mark.parametrize("missing", ["truth.json", "vdp2.csv"])
def test_a_missing_file_is_named(folder, missing):
    (folder / missing).unlink()
    with pytest.raises(DataError, match=missing):
        truths(folder)


def test_three_quarters_are_learned_from_and_the_rest_judged_by(folder):
    rows = rows_of(folder, "lv1")
    parts = split(rows, "lv1", 0, 0.0)
    learned, judged = parts.training.column("x"), parts.columns["x"]
    assert (len(learned), len(judged)) == (300, 100)
    assert sorted([*learned, *judged]) == sorted(rows.column("x"))
    np.testing.assert_array_equal(parts.training.column("label"), np.cos(learned))
    np.testing.assert_array_equal(parts.labels, np.cos(judged))


def test_noise_is_on_the_labels_to_learn_from_alone_and_of_the_given_size(folder):
    rows = rows_of(folder, "lv1")
    before = rows.columns.copy()
    parts = split(rows, "lv1", 0, 0.1)
    true = np.cos(parts.training.column("x"))
    noise = parts.training.column("label") - true
    expected = 0.1 * np.sqrt(np.mean(true**2))
    assert np.std(noise) == pytest.approx(expected, rel=0.15)
    assert abs(np.mean(noise)) < 4 * expected / np.sqrt(300)
    np.testing.assert_array_equal(parts.labels, np.cos(parts.columns["x"]))
    np.testing.assert_array_equal(rows.columns, before)


def test_the_error_of_an_equation_is_measured_in_spreads_of_the_label(folder):
    rows = rows_of(folder, "lv1")
    assert measured_error("cos(x)", rows) == pytest.approx(0.0, abs=1e-12)
    assert measured_error("cos(x) + 0.5", rows) == pytest.approx(0.5 / np.std(rows.column("label")))
    with np.errstate(all="ignore"):
        assert measured_error("x/(x + y)", rows) is None
