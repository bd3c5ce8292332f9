"""JSON files -> `RawTable`: a list of records, a record a line, or columns by name, as pandas and polars write them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from atoll_coordinator.data.reading.cells import cell_of
from atoll_coordinator.data.reading.encodings import decode
from atoll_coordinator.data.reading.raw_table import RawTable, with_breaks
from atoll_core.errors import DataError

_EXPECTED = 'a list of records such as [{"t": 0, "x": 1}] is expected'


def read_records(path: Path) -> RawTable:
    """Read a JSON file; raises DataError."""
    text, _ = decode(path.name, path.read_bytes())
    if not text.strip():
        raise DataError(f"{path.name} is empty; {_EXPECTED}")
    return table_of_document(path.name, *_parsed(path.name, text))


def table_of_document(name: str, document: object, remark: str) -> RawTable:
    """Return the table of records, or of columns by name; `name` is for messages, which DataError has."""
    headers, columns = _columns(name, document)
    cells = [[_cell(name, header, value) for value in column] for header, column in zip(headers, columns, strict=True)]
    return with_breaks(headers, cells, (remark,))


def _parsed(name: str, text: str) -> tuple[Any, str]:
    """Return the value of the whole text, or a list of those of its lines."""
    try:
        return json.loads(text), "JSON"
    except (ValueError, RecursionError) as error:
        whole = error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if len(lines) < 2 or not lines[0][1].strip().endswith("}"):
        at = ""
        if isinstance(whole, json.JSONDecodeError):
            at = f" from line {whole.lineno}, column {whole.colno} on"
        raise DataError(f"{name} is not valid JSON{at}; {_EXPECTED}") from whole
    records = []
    for number, line in lines:
        try:
            records.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise DataError(f"line {number} of {name} is not valid JSON; one record a line is expected") from error
    return records, "JSON lines"


def _columns(name: str, document: Any) -> tuple[list[str], list[Sequence[Any]]]:
    """Return names and values of the columns."""
    if isinstance(document, Mapping) and {"columns", "data"} <= set(document):  # pandas: orient="split"
        document = [dict(zip(document["columns"], row, strict=False)) for row in document["data"]]
    elif isinstance(document, Mapping) and {"schema", "data"} <= set(document):  # pandas: orient="table"
        document = document["data"]
    if isinstance(document, Mapping):
        columns: list[Sequence[Any]] = [
            [*values.values()] if isinstance(values, Mapping) else values for values in document.values()
        ]
        lengths = {len(column) if isinstance(column, list) else 0 for column in columns}
        if len(lengths) != 1 or lengths == {0}:
            raise DataError(f"{name} holds an object whose values are no columns of one length; {_EXPECTED}")
        return [str(key) for key in document], columns
    if not isinstance(document, list) or not document or not all(isinstance(record, Mapping) for record in document):
        raise DataError(f"{name} holds no records; {_EXPECTED}")
    headers = list(dict.fromkeys(str(key) for record in document for key in record))
    return headers, [[record.get(header) for record in document] for header in headers]


def _cell(name: str, header: str, value: object) -> str:
    if isinstance(value, (list, dict)):
        raise DataError(f"column '{header}' of {name} holds lists or objects; write one number a cell")
    return cell_of(value)
