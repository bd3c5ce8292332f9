"""MATLAB files of version 7.3, which are HDF5 -> values as scipy returns them of earlier versions.

A structure is a group, with its fields; cells are a dataset of references, and so is each field of a structure array.
References lead to ``#refs#``. Matrices have the other order of numbers.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.reading.hdf5 import opened, refuse_elsewhere, text_of
from atoll_core.errors import DataError

_DEEPEST: Final = 8
"""Levels of structures and cells within each other; a file may lead back to where it came from."""
_MOST: Final = 1_000_000
"""Values in a file, of which one may be led to by many references."""
_NOTHING: Final = ""
"""Stands for what holds no numbers: texts, functions, tables, arrays without elements."""


def read_values(path: Path) -> dict[str, object]:
    """Return values by name: arrays, dicts of structures, and lists of cells and of elements of structure arrays.

    Raises DataError where h5py is not installed, or the file is none that it reads.
    """
    with opened(path) as (file, h5py):
        reader = _Reader(path.name, file, h5py)
        return {name: reader.value(file[name], 0) for name in file if not name.startswith("#")}


class _Reader:
    """Reads the values of one open file, called `name` in messages."""

    def __init__(self, name: str, file: Any, h5py: Any) -> None:
        self._name, self._file, self._h5py = name, file, h5py
        self._count = 0

    def value(self, item: Any, depth: int) -> object:
        """Return what a group or a dataset stands for, `depth` levels below the file; raises DataError."""
        self._count += 1
        if depth > _DEEPEST or self._count > _MOST:
            found = f"{_DEEPEST} levels of structures and cells" if depth > _DEEPEST else f"{_MOST:,} values"
            advice = "save the columns as vectors or matrices"
            raise DataError(f"{self._name} holds more than {found} within each other; {advice}")
        if isinstance(item, self._h5py.Group):
            return self._structure(item, depth)
        refuse_elsewhere(self._name, item.name.strip("/"), item)
        if item.attrs.get("MATLAB_empty"):  # its numbers are those of rows and columns
            return _NOTHING
        if self._is_references(item):
            return [self._referred(reference, depth) for reference in np.ravel(item[()])]
        if text_of(item.attrs.get("MATLAB_class")) in ("char", "function_handle", "table"):
            return _NOTHING
        return _array(item)

    def _structure(self, group: Any, depth: int) -> object:
        """Return the fields of a structure, or a list of those of the elements of an array of structures."""
        fields = {name: group[name] for name in group}
        arrays = {
            name: np.ravel(field[()])
            for name, field in fields.items()
            if self._is_references(field) and not text_of(field.attrs.get("MATLAB_class"))
        }
        if not arrays or len(arrays) < len(fields) or len({len(array) for array in arrays.values()}) > 1:
            return {name: self.value(field, depth + 1) for name, field in fields.items()}
        return [
            {name: self._referred(reference, depth) for name, reference in zip(arrays, references, strict=True)}
            for references in zip(*arrays.values(), strict=True)
        ]

    def _is_references(self, item: Any) -> bool:
        is_dataset = isinstance(item, self._h5py.Dataset)
        return is_dataset and self._h5py.check_ref_dtype(item.dtype) is self._h5py.Reference

    def _referred(self, reference: Any, depth: int) -> object:
        return self.value(self._file[reference], depth + 1) if reference else _NOTHING


def _array(item: Any) -> object:
    """Return the numbers of a dataset as MATLAB means them."""
    values = item[()]
    if getattr(values, "dtype", np.dtype("O")).names == ("real", "imag"):
        values = values["real"] + 1j * values["imag"]
    return np.squeeze(np.transpose(values)) if np.asarray(values).dtype.kind in "biufc" else _NOTHING
