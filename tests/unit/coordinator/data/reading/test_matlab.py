"""MATLAB files that are read by a process of their own."""

import sys
from pathlib import Path

import numpy as np
import pytest

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
