"""MATLAB files that are read by a process of their own."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.reading.matlab import read_matlab
from atoll_coordinator.data.reading.matlab_child import flat
from atoll_core.config import DataConfig
from atoll_core.errors import DataError


def test_a_file_that_ends_its_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(200))
    (tmp_path / "reader").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "reader").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "reader"))
    with pytest.raises(DataError, match=r"a\.mat is not a MATLAB file that can be read; save it anew"):
        read_matlab(tmp_path / "a.mat", DataConfig())


def test_fields_of_structures_are_arrays_and_what_holds_no_numbers_is_empty() -> None:
    values = {
        "x": np.ones(3),
        "run": {"x": np.zeros(3), "t": np.arange(3)},
        "cell": np.array([{}], dtype=object),
        "k": 2.0,
    }
    arrays = flat(values)
    assert {name: array.shape for name, array in arrays.items()} == {
        "x": (3,),
        "run.x": (3,),
        "t": (3,),
        "cell": (),
        "k": (),
    }


def _cells(*items: object) -> np.ndarray:
    cells = np.empty(len(items), dtype=object)
    for place, item in enumerate(items):
        cells[place] = item
    return cells


def _runs(lengths: tuple[int, int]) -> dict[str, dict[str, object]]:
    """Return two runs in every form that MATLAB users keep them in."""
    times = [0.5 * np.arange(float(length)) for length in lengths]
    values = [10.0 + time**2 for time in times]
    array = np.zeros(2, dtype=[("t", "O"), ("x", "O")])
    for place, run in enumerate(zip(times, values, strict=True)):
        array[place] = run
    structures = [{"t": time, "x": value} for time, value in zip(times, values, strict=True)]
    return {
        "a structure array": {"runs": array},
        "cells of vectors": {"t": _cells(*times), "x": _cells(*values)},
        "cells of structures": {"runs": _cells(*structures)},
        "cells of matrices": {"runs": _cells(*map(np.column_stack, zip(times, values, strict=True)))},
    }


@pytest.mark.parametrize("lengths", [(6, 8), (6, 6)])
@pytest.mark.parametrize("kind", _runs((1, 1)))
def test_structures_and_cells_of_runs_are_trajectories(kind: str, lengths: tuple[int, int], tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {**_runs(lengths)[kind], "gain": 2.5})
    table = read_table([tmp_path / "a.mat"], DataConfig())
    assert (table.names, table.starts, table.rows) == (("t", "x"), (0, 6), sum(lengths))
    assert np.allclose(table.column("x"), 10.0 + table.column("t") ** 2)
    assert table.left_out == ("left out: gain",)
    assert "2 runs" in table.read_as


def test_rows_of_a_structure_array_are_rows(tmp_path: Path) -> None:
    rows = np.array([(0.0, 1.5), (0.5, 2.5), (1.0, 4.5)], dtype=[("t", "f8"), ("x", "f8")])
    scipy.io.savemat(tmp_path / "a.mat", {"table": rows})
    assert read_table([tmp_path / "a.mat"], DataConfig()).columns.tolist() == [[0.0, 0.5, 1.0], [1.5, 2.5, 4.5]]


def test_runs_of_different_fields_are_refused(tmp_path: Path) -> None:
    runs = _cells({"t": np.arange(6.0), "x": np.arange(6.0)}, {"t": np.arange(6.0), "y": np.arange(6.0)})
    scipy.io.savemat(tmp_path / "a.mat", {"runs": runs})
    with pytest.raises(DataError, match=r"runs 1 and 2 of a\.mat differ in x, y; give all runs the same fields"):
        read_table([tmp_path / "a.mat"], DataConfig())
