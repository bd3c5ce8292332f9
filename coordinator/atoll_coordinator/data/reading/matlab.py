"""MATLAB files -> `RawTable`: versions 5 to 7 by scipy, 7.3 by h5py, since they are HDF5 then.

Matrices have their columns counted from 1, fields of structures are taken as arrays.
"""

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np

from atoll_coordinator.data.reading.arrays import table_of_arrays
from atoll_coordinator.data.reading.hdf5 import MAGIC, read_arrays
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
        arrays, units = read_arrays(path, is_matlab=True)
        version = "MATLAB 7.3"
    else:
        if not beginning.startswith(b"MATLAB"):
            raise _refusal(path)
        arrays, units, version = _loaded(path), {}, "MATLAB"
    if not any(np.ndim(array) for array in arrays.values()):
        raise DataError(f"{path.name} holds no numeric arrays; save vectors or matrices, tables with table2struct")
    return table_of_arrays(path.name, arrays, config, (version,), units, first=1)


def _loaded(path: Path) -> dict[str, AnyArray]:
    """Return the arrays of a file, read by a process of its own: see `matlab_child`."""
    command = [sys.executable, "-P", "-m", "atoll_coordinator.data.reading.matlab_child", str(path)]
    child = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if child.returncode:
        raise _refusal(path)
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as packed:
        names = json.loads(str(packed["names"]))
        return {name: packed[str(number)] for number, name in enumerate(names)}


def _refusal(path: Path) -> DataError:
    return DataError(f"{path.name} is not a MATLAB file that can be read; save it anew, or as CSV")
