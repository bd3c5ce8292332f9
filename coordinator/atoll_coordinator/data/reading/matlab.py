"""MATLAB files -> `Rows`: up to version 7 by scipy, 7.3 by h5py, since they are HDF5 then.

Matrices have their columns counted from 1, fields of structures are taken as arrays.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.config import DataConfig
from atoll.errors import DataError
from atoll_coordinator.data.reading.arrays import rows_of_arrays
from atoll_coordinator.data.reading.hdf5 import MAGIC, read_arrays
from atoll_coordinator.data.reading.rows import Rows

_USERBLOCK: Final = 512
"""Bytes of text with which MATLAB begins an HDF5 file."""


def read_matlab(path: Path, config: DataConfig) -> Rows:
    """Read a MATLAB file; raises DataError."""
    with path.open("rb") as file:
        beginning = file.read(_USERBLOCK + len(MAGIC))
    if beginning[:8] == MAGIC or beginning[_USERBLOCK:] == MAGIC:
        arrays, units = read_arrays(path, is_matlab=True)
        version = "MATLAB 7.3"
    else:
        arrays, units, version = _flat(_loaded(path)), {}, "MATLAB"
    if not any(np.ndim(array) for array in arrays.values()):
        raise DataError(f"{path.name} holds no numeric arrays; save vectors or matrices, tables with table2struct")
    return rows_of_arrays(path.name, arrays, config, (version,), units, first=1)


def _loaded(path: Path) -> dict[str, Any]:
    import scipy.io

    try:
        found: dict[str, Any] = scipy.io.loadmat(path, simplify_cells=True)
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not a MATLAB file that can be read; save it anew, or as CSV") from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays, those of structures by the field's name, or by both names where it is taken.

    What holds no numbers or text becomes a single empty text.
    """
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            inner = _flat(value)
            found |= {field if field not in found else f"{name}.{field}": its for field, its in inner.items()}
        else:
            array = np.asarray(value)
            found[name] = array if array.dtype.kind in "biufcU" and array.ndim <= 2 else np.array("")
    return found
