"""MATLAB files that are read by a process of their own."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from atoll_coordinator.data.reading.arrays import read_matlab
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.errors import DataError


def test_a_file_that_ends_its_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(200))
    (tmp_path / "reader").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "reader").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "reader"))
    with pytest.raises(DataError, match=r"a\.mat cannot be read as a MATLAB file; save the file again"):
        read_matlab(tmp_path / "a.mat", DataConfig())


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


def test_runs_of_different_fields_are_refused(tmp_path: Path) -> None:
    runs = _cells({"t": np.arange(6.0), "x": np.arange(6.0)}, {"t": np.arange(6.0), "y": np.arange(6.0)})
    scipy.io.savemat(tmp_path / "a.mat", {"runs": runs})
    with pytest.raises(DataError, match=r"runs 1 and 2 of a\.mat differ in x, y; give all runs the same fields"):
        read_table([tmp_path / "a.mat"], DataConfig())


# ------------------------------------------------------------------------------------------------------ version 7.3


def _written(path: Path, values: dict[str, object]) -> None:
    """Lay values out as MATLAB 7.3 does: structures as groups, and matrices as columns."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in values.items():
            fields = value if isinstance(value, dict) else {"": value}
            for field, part in fields.items():
                file[f"{name}/{field}".rstrip("/")] = np.asarray(part).T if np.ndim(part) == 2 else [part]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Nov 23 10:00:00 2026".ljust(124))


def test_structures_of_version_7_3_are_read_as_of_version_5(tmp_path: Path) -> None:
    values = {"run": {"t": np.arange(3.0), "x": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])}, "k": 2.0}
    _written(tmp_path / "new.mat", values)
    scipy.io.savemat(tmp_path / "old.mat", values)
    new, old = (read_table([tmp_path / name], DataConfig()) for name in ("new.mat", "old.mat"))
    assert (new.names, new.columns.tolist()) == (old.names, old.columns.tolist())
    assert new.left_out == old.left_out


def test_what_holds_no_numbers_in_version_7_3_is_left_out(tmp_path: Path) -> None:
    """Numbers of rows and columns stand in the file in place of no elements, and were read as two rows."""
    _written(tmp_path / "a.mat", {"t": np.arange(6.0), "x": np.arange(6.0) ** 2})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["empty"] = np.array([0, 6], dtype=np.uint64)
        file["empty"].attrs["MATLAB_empty"] = np.uint8(1)
        file.create_dataset("runs", (6, 1), dtype=h5py.ref_dtype)[0, 0] = file["t"].ref
    table = read_table([tmp_path / "a.mat"], DataConfig())
    assert (table.names, table.left_out) == (("t", "x"), ("left out: empty, runs",))
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        del file["t"], file["x"]
    with pytest.raises(
        DataError, match=r"a\.mat holds no numeric arrays; save vectors or matrices, tables with .* -v7"
    ):
        read_table([tmp_path / "a.mat"], DataConfig())
