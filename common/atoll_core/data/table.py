"""Raw numeric columns as read from files: clients upload them, and preparing a job interprets them.

Letters: C columns, N rows.
"""

import datetime
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field

from atoll_core.config import Frozen
from atoll_core.data.dataset import AnyArray, FloatArray, IntArray
from atoll_core.errors import DataError, RemoteProtocolError
from atoll_core.wire.codec import BROKEN, decode_arrays, encode_arrays

S = TypeVar("S", bound=np.generic)
MANY = 5
"""Largest number of rows that a message lists; if there are more, it lists the first rows and the total number."""
MIDNIGHT: Final = "midnight"


def _moment(since: str) -> str:
    if since != MIDNIGHT:
        datetime.datetime.fromisoformat(since.removesuffix(" UTC"))
    return since


class Origin(NamedTuple):
    """The moment from which the times of a column of dates count, ISO 8601 or `MIDNIGHT`, and their unit in seconds."""

    since: Annotated[str, AfterValidator(_moment)]
    seconds: Annotated[float, Field(gt=0.0, strict=True)]


class _Header(Frozen):
    """The parts of a table in bytes that are not arrays; see `Table`."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    starts: tuple[int, ...]
    files: tuple[str, ...]
    skipped: tuple[str, ...]
    read_as: str = ""
    labels: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    origins: dict[str, Origin] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns as read, checked for shape only.

    `names` are unique and without units, `units` are "" where the header has none; `columns` (C, N) float64, C order,
    may hold NaN and infinity; `starts` are the rows at which files or blank rows begin a new trajectory, the first one
    0. For messages: `files` are the names of the files, `file_of_row` (N,) indices into them, `line_of_row` (N,) line
    numbers from 1, or 0 where a file has no lines. `skipped` are columns of text. `read_as` describes how the files
    were read, "" where unknown. `labels` are the texts for the numbers 1, 2, … of a column of groups. `origins` belong
    to columns of dates or clock times. `left_out` lists other parts of the files that are not in the table, in phrases
    such as ``other sheets left out: notes``.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: FloatArray
    starts: tuple[int, ...]
    files: tuple[str, ...]
    file_of_row: IntArray
    line_of_row: IntArray
    skipped: tuple[str, ...] = ()
    read_as: str = ""
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    origins: Mapping[str, Origin] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that the parts fit together; raises DataError."""
        shape = (len(self.names), len(self.file_of_row))
        sizes_fit = self.columns.shape == shape and len(self.units) == shape[0] and len(self.line_of_row) == shape[1]
        if not sizes_fit or len(set(self.names)) != len(self.names) or not self.files:
            raise DataError(f"a table of {len(self.names)} names has columns of shape {self.columns.shape}")
        if list(self.starts) != sorted(set(self.starts)) or self.starts[:1] != (0,) or self.starts[-1] > shape[1]:
            raise DataError(f"a table of {shape[1]} rows has trajectories that start at rows {self.starts}")
        if shape[1] and not 0 <= self.file_of_row.min() <= self.file_of_row.max() < len(self.files):
            raise DataError(f"a table refers to files beyond its {len(self.files)}")

    def label(self, name: str, value: float) -> str | None:
        """Return the text for a number of column `name`, None where the number has no text."""
        texts = self.labels.get(name)
        return texts[int(value) - 1] if texts is not None and 1 <= value <= len(texts) else None

    def moment(self, name: str, time: float) -> str:
        """Return a time of column `name` as a date or clock time if the files hold these, else as a number."""
        origin = self.origins.get(name)
        if origin is None:
            return repr(time)
        start = "1970-01-01" if origin.since == MIDNIGHT else origin.since.removesuffix(" UTC")
        try:
            since = datetime.timedelta(seconds=round(time * origin.seconds, 6))
            moment = datetime.datetime.fromisoformat(start) + since
        except (OverflowError, ValueError):  # the date is beyond the calendar
            return repr(time)
        return str(moment.time() if origin.since == MIDNIGHT else moment)

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return int(self.columns.shape[1])

    def column(self, name: str) -> FloatArray:
        """Return the values (N,) of column `name`; raises KeyError."""
        values: FloatArray = self.columns[self._place_by_name[name]]
        return values

    @cached_property
    def _place_by_name(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def places(self, rows: Sequence[int]) -> str:
        """Return the positions of `rows` (indices from 0): ``rows 12, 40 (lines 13, 41 of a.csv), 2 in all``."""
        first = list(rows[:MANY])
        numbers = ", ".join(str(row + 1) for row in first)
        text = f"{_plural('row', first)} {numbers}{', …' if len(rows) > MANY else ''}"
        if all(self.line_of_row[row] > 0 for row in first):
            parts = []
            for file in dict.fromkeys(self.file_of_row[first].tolist()):
                lines = [str(self.line_of_row[row]) for row in first if self.file_of_row[row] == file]
                parts.append(f"{_plural('line', lines)} {', '.join(lines)} of {self.files[file]}")
            text += f" ({'; '.join(parts)})"
        return text + (f", {len(rows)} in all" if len(rows) > 1 else "")

    def to_bytes(self) -> bytes:
        """Return the bytes that are uploaded; `from_bytes` reads them."""
        header = {name: getattr(self, name) for name in _Header.model_fields}
        header = {name: part for name, part in header.items() if part or name not in ("labels", "left_out", "origins")}
        arrays = {"columns": self.columns, "file_of_row": self.file_of_row, "line_of_row": self.line_of_row}
        return encode_arrays(header, arrays)

    @classmethod
    def from_bytes(cls, data: bytes) -> "Table":
        """Parse the result of `to_bytes`; raises RemoteProtocolError when `data` is something else."""
        header, arrays = decode_arrays(data)
        try:
            parts = _Header.model_validate(header)
            return cls(
                columns=_numbers(arrays["columns"], np.float64, 2),
                file_of_row=_numbers(arrays["file_of_row"], np.int64, 1),
                line_of_row=_numbers(arrays["line_of_row"], np.int64, 1),
                **{name: getattr(parts, name) for name in _Header.model_fields},
            )
        except (*BROKEN, DataError) as error:
            raise RemoteProtocolError(f"the bytes of a table do not fit: {error}") from error

    @cached_property
    def digest(self) -> str:
        """Hex sha256 of the content."""
        return hashlib.sha256(self.to_bytes()).hexdigest()


def _plural(noun: str, items: Sequence[object]) -> str:
    return noun if len(items) == 1 else noun + "s"


def _numbers(array: AnyArray, kind: type[S], dimensions: int) -> npt.NDArray[S]:
    if array.dtype != kind or array.ndim != dimensions:
        raise TypeError(f"an array of {array.dtype} with {array.ndim} dimensions was found")
    return np.ascontiguousarray(array)
