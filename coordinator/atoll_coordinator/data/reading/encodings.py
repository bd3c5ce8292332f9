"""Bytes of a text file -> text: UTF-8, UTF-16 with a byte order mark, else Windows-1252, of which Latin-1 is a part."""

import re
from typing import Final

from atoll_core.errors import DataError

_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
_UTF_8: Final = re.compile(rb"[\xc2-\xdf][\x80-\xbf]|[\xe0-\xef][\x80-\xbf]{2}|[\xf0-\xf4][\x80-\xbf]{3}")
_KNOWN: Final = (
    (b"PK\x03\x04", "an Excel workbook or another ZIP archive", ".xlsx or .npz"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", ".xlsx, saved as such"),
    (b"\x89HDF", "an HDF5 file", ".h5"),
    (b"MATLAB", "a MATLAB file", ".mat"),
    (b"PAR1", "a Parquet file", ".parquet"),
    (b"\x1f\x8b", "a gzip archive", ".csv, unpacked"),
)
"""First bytes, what begins so, and the ending of the name under which it is read."""


def decode(name: str, data: bytes) -> tuple[str, str]:
    """Return the text, and the name of its encoding ("" for UTF-8); raises DataError where the bytes are no text."""
    for start, kind, ending in _KNOWN:
        if data.startswith(start):
            raise DataError(f"{name} is {kind}, not text; give it the ending {ending}")
    try:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16"), "UTF-16"
        if b"\0" in data:
            content = f"{name} holds zero bytes, as a binary file does, or UTF-16 without a byte order mark"
            raise DataError(f"{content}; save it as CSV in UTF-8, or as Parquet")
        try:
            return data.decode("utf-8-sig"), ""
        except UnicodeDecodeError:
            if _CONTROL.search(data) or _UTF_8.search(data):
                raise
        return data.decode("cp1252"), "Windows-1252 (Latin-1)"
    except UnicodeDecodeError as error:
        place = f"byte {error.start + 1}"
        raise DataError(f"{name} is not UTF-8 text ({place}); save it as CSV in UTF-8, or as Parquet") from error
