"""MATLAB files -> `RawTable`: versions 5 to 7 by scipy, 7.3 by h5py, since they are HDF5 then.

Matrices have their columns counted from 1, fields of structures are taken as arrays.
"""

import io
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Final

import numpy as np

from atoll_coordinator.data.reading.arrays import table_of_arrays
from atoll_coordinator.data.reading.hdf5 import MAGIC
from atoll_coordinator.data.reading.header import named_by_place
from atoll_coordinator.data.reading.matlab_child import parts_of
from atoll_coordinator.data.reading.matlab_hdf5 import read_values
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import DataError

_USERBLOCK: Final = 512
"""Bytes of text with which MATLAB begins an HDF5 file."""


def read_matlab(path: Path, config: DataConfig) -> RawTable:
    """Read a MATLAB file; raises DataError."""
    with path.open("rb") as file:
        beginning = file.read(_USERBLOCK + len(MAGIC))
    if beginning[:8] == MAGIC or beginning[_USERBLOCK:] == MAGIC:
        (arrays, *runs), version = parts_of(read_values(path)), "MATLAB 7.3"
    else:
        if not beginning.startswith(b"MATLAB"):
            raise _refusal(path)
        (arrays, *runs), version = _loaded(path), "MATLAB"
    if runs:
        return _of_runs(path.name, arrays, runs, config, version)
    if not any(np.ndim(array) for array in arrays.values()):
        raise DataError(f"{path.name} holds no numeric arrays; save vectors or matrices, tables with table2struct")
    return table_of_arrays(path.name, arrays, config, (version,), first=1)


def _of_runs(
    name: str, beside: Mapping[str, AnyArray], runs: Sequence[Mapping[str, AnyArray]], config: DataConfig, version: str
) -> RawTable:
    """Return the rows of runs, elements of a structure array or of cells, below each other; raises DataError."""
    is_matrix = all(len(run) == 1 and np.ndim(next(iter(run.values()))) == 2 for run in runs)
    raws = [
        table_of_arrays(f"run {place} of {name}", run, config, (), first=1) for place, run in enumerate(runs, start=1)
    ]
    first = raws[0]
    for place, raw in enumerate(raws, start=1):
        if set(raw.headers) != set(first.headers):
            different = ", ".join(sorted(set(raw.headers) ^ set(first.headers)))
            raise DataError(f"runs 1 and {place} of {name} differ in {different}; give all runs the same fields")
    columns = [[cell for raw in raws for cell in raw.columns[raw.headers.index(header)]] for header in first.headers]
    before = [0, *accumulate(len(raw.lines) for raw in raws[:-1])]
    left_out = [*beside, *dict.fromkeys(phrase.partition(": ")[2] for raw in raws for phrase in raw.left_out)]
    whole = replace(
        first,
        columns=columns,
        lines=[0] * sum(len(raw.lines) for raw in raws),
        starts=[start + rows for raw, rows in zip(raws, before, strict=True) for start in raw.starts],
        remarks=(f"{version}, {len(runs)} runs",),
        left_out=(f"left out: {', '.join(left_out)}",) if left_out else (),
    )
    return named_by_place(whole) if is_matrix else whole


def _loaded(path: Path) -> list[dict[str, AnyArray]]:
    """Return the arrays of a file, then those of each run in it, read by a process of its own: see `matlab_child`."""
    command = [sys.executable, "-P", "-m", "atoll_coordinator.data.reading.matlab_child", str(path)]
    child = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if child.returncode:
        raise _refusal(path)
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as packed:
        names = json.loads(str(packed["names"]))
        parts: list[dict[str, AnyArray]] = [{} for _ in range(1 + max((run for run, _ in names), default=0))]
        for number, (run, name) in enumerate(names):
            parts[run][name] = packed[str(number)]
        return parts


def _refusal(path: Path) -> DataError:
    return DataError(f"{path.name} is not a MATLAB file that can be read; save it anew, or as CSV")
