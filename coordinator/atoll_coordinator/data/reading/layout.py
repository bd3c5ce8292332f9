"""A text file -> `RawTable`: which character separates cells, which lines are comments, which is the header.

Lines are kept apart because messages name them. The header is the first line that is no comment, or, where that holds
numbers, the last comment before it that has as many cells, as `numpy.savetxt` writes it; `header` says when names of
groups stand above it.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Final, NamedTuple

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, on_one_line, shortened
from atoll_coordinator.data.reading.dates import is_datum
from atoll_coordinator.data.reading.encodings import decode
from atoll_coordinator.data.reading.header import take_header
from atoll_coordinator.data.reading.preamble import SAMPLED, Preamble, begins_within, find_preamble
from atoll_coordinator.data.reading.raw_table import RawTable, is_units_row, plain_unit, table_of_records
from atoll_core.errors import DataError

SPACES: Final = " "
"""Stands for any white space between cells."""

_NAMES: Final = {",": "commas", ";": "semicolons", "\t": "tabs", SPACES: "spaces"}
_LINE: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_COMMENT: Final = re.compile(r"\s*(?:#(?!N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!)|%)", re.IGNORECASE)
"""How a comment begins; what spreadsheets write for an error is none."""
_SEPARATOR: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_JSON: Final = re.compile(r"""\s*(?:\{\s*["}]|\[\s*[\[{]|[{\[]\s*$)""")
"""How the first line of JSON begins."""
_MARKS: Final = "#% \t"
_Line = tuple[int, str]


class _Beginning(NamedTuple):
    """What stands before the first row, a separator that the file names and comments, and the `first` line.

    Where something else stands above the header, `preamble` says what, and `first` is the header.
    """

    separator: str | None
    comments: tuple[str, ...]
    first: _Line
    preamble: Preamble | None = None


def read_text(name: str, data: bytes) -> RawTable:
    """Split a text file into cells; raises DataError where it is no text, empty, has no header or cannot be split."""
    text, encoding = decode(name, data)
    if not text.strip():
        raise DataError(f"{name} is empty; a header line and rows of numbers are expected")
    beginning = _without_preamble(text, _beginning(name, text))
    number, first = beginning.first
    if _JSON.match(first):
        raise DataError(f"{name} holds JSON or JSON lines; give it the ending .json or .jsonl")
    try:
        raw = _split(name, text, beginning, _COMMENT.match)
    except DataError as error:
        raise (_preamble(name, text, number) or error) from None
    if not raw.lines and any(place > number and _COMMENT.match(line) for place, line in _lines(text)):
        # the first column begins with the mark of a comment
        raw = _split(name, text, beginning, lambda _: None)
    return replace(raw, remarks=(*raw.remarks, encoding)) if encoding else raw


def _lines(text: str) -> Iterator[_Line]:
    """Yield line numbers and lines; a StringIO would take four bytes for each character."""
    return enumerate((match[0] for match in _LINE.finditer(text)), start=1)


def _beginning(name: str, text: str) -> _Beginning:
    separator: str | None = None
    comments: list[str] = []
    for number, line in _lines(text):
        if not line.strip():
            continue
        if (named := _SEPARATOR.fullmatch(line)) and not comments and separator is None:
            separator = named[1]
        elif _COMMENT.match(line):
            comments.append(line)
        else:
            return _Beginning(separator, tuple(comments), (number, line))
    raise DataError(f"{name} holds comments only; a header line and rows of numbers are expected")


def _without_preamble(text: str, beginning: _Beginning) -> _Beginning:
    """Return where the table begins, and what separates its cells, if it is not in the first line."""
    sampled = ((number, line) for number, line in _lines(text) if number >= beginning.first[0] and line.strip())
    lines = [*islice((pair for pair in sampled if not _COMMENT.match(pair[1])), SAMPLED)]
    for separator in beginning.separator or "\t;, ":
        rows = [(number, cells_of(line, separator)) for number, line in lines]
        preamble = find_preamble([(number, cells) for number, cells in rows if any(map(str.strip, cells))])
        if preamble is not None:
            first = next(pair for pair in lines if pair[0] == preamble.header)
            return beginning._replace(separator=separator, first=first, preamble=preamble)
        if begins_within(rows):
            return beginning
    return beginning


def _split(name: str, text: str, beginning: _Beginning, is_comment: Callable[[str], object]) -> RawTable:
    number, line = beginning.first
    passed_over = () if beginning.preamble is None else beginning.preamble.below
    count = len(beginning.comments)

    def body() -> Iterator[_Line]:
        nonlocal count
        for place, line in _lines(text):
            if place >= number and is_comment(line):
                count += 1
            elif place >= number and place not in passed_over:
                yield place, line

    where: tuple[str, ...] = ()
    following = (line for place, line in _lines(text) if place > number and line.strip())
    below = next((line for line in following if not _COMMENT.match(line)), "")
    comment_header = _header_of_comments(line, below, beginning)
    if comment_header is not None:
        separator, headers, units = comment_header
        raw = table_of_records(name, headers, _records(name, body(), separator))
        raw, where = replace(raw, units=units or raw.units), ("header in a comment",)
        count -= 1 + bool(units)
    else:
        separator = beginning.separator or _separator(line, below)
        header, records = take_header(_records(name, body(), separator))
        if not header.is_made:
            _check_header(name, header.names)
        is_named_as_by_r = below.lstrip().startswith('"')
        raw = header.applied(
            table_of_records(
                name, header.names, records, has_row_names=is_named_as_by_r, may_have_commas=separator == ","
            )
        )
    left_out = (f"{count} comment {'line' if count == 1 else 'lines'} left out",) if count else ()
    how = f"text with {_NAMES.get(separator, repr(separator))}"
    above = () if beginning.preamble is None else beginning.preamble.remarks
    return replace(raw, remarks=(how, *above, *where, *raw.remarks, *left_out), separator=separator)


def _records(name: str, lines: Iterator[_Line], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each record, blank lines included."""
    if separator == SPACES:
        for number, line in lines:
            yield number, cells_of(line, separator)
        return
    numbers: list[int] = []
    quotes = 0

    def fed() -> Iterator[str]:
        nonlocal quotes
        for number, line in lines:
            numbers.append(number)
            quotes += line.count('"')
            yield line

    reader = csv.reader(fed(), delimiter=separator, skipinitialspace=True)
    before = 0
    try:
        for record in reader:
            if reader.line_num > before + 1 and quotes % 2:
                raise _unclosed(numbers[before], name)
            yield numbers[before], record
            before, quotes = reader.line_num, 0
    except csv.Error as error:
        if quotes % 2:
            raise _unclosed(numbers[before], name) from error
        raise DataError(f"line {numbers[-1]} of {name} cannot be split into cells: {error}") from error


def _unclosed(line: int, name: str) -> DataError:
    return DataError(f'line {line} of {name} has a quotation mark that is not closed; close it, or remove the "')


def cells_of(line: str, separator: str) -> list[str]:
    """Return the cells of one line."""
    if separator == SPACES and '"' not in line:
        return line.split()
    text = " ".join(line.split()) if separator == SPACES else line
    try:
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return [text]


def _separator(header: str, below: str) -> str:
    """Return what the header uses outside of quotes and units: tab, semicolon or comma; else perhaps spaces."""
    bare = re.sub(r'"[^"]*"|\[[^\]]*\]', "", header)
    for separator in "\t;,":
        if separator in bare:
            return separator
    number = len(cells_of(header, SPACES))
    return SPACES if number > 1 and len(cells_of(below, SPACES)) in (number, number + 1) else ","


def _header_of_comments(
    line: str, below: str, beginning: _Beginning
) -> tuple[str, Sequence[str], tuple[str, ...]] | None:
    """Return separator, names and units where the first line holds data and comments before it name the columns.

    Data may hold text, where the line `below` does so in the same cells.
    """
    for separator in beginning.separator or "\t;, ":
        cells = cells_of(line, separator)
        has_text = not all(map(_may_be_datum, cells))
        if all(map(is_missing, cells)) or (has_text and not _are_alike(cells, cells_of(below, separator))):
            continue
        named = [_names(comment, separator, len(cells), is_strict=has_text) for comment in beginning.comments]
        fitting = [names for names in named if names]
        if len(fitting) > 1 and is_units_row(fitting[-1], fitting[-2]):
            return separator, fitting[-2], tuple(plain_unit(cell) for cell in fitting[-1])
        if fitting:
            return separator, fitting[-1], ()
    return None


def _may_be_datum(cell: str) -> bool:
    return is_missing(cell) or is_datum(cell)


def _are_alike(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Tell whether two rows hold numbers in the same cells, and there is one that does."""
    kinds, kinds_below = [*map(_may_be_datum, cells)], [*map(_may_be_datum, below)]
    return kinds == kinds_below and any(map(is_numeral, cells))


def _names(comment: str, separator: str, count: int, *, is_strict: bool = False) -> list[str] | None:
    """Return the cells of a comment if there are as many as `count`, however it separates them unless `is_strict`."""
    text = comment.strip().lstrip(_MARKS)
    for candidate in (separator,) if is_strict else (separator, ",", ";", "\t", SPACES):
        cells = [on_one_line(cell) for cell in cells_of(text, candidate)]
        if len(cells) == count and not any(cell.endswith((",", ";")) or is_numeral(cell) for cell in cells):
            return cells
    cells = re.split(r"\s{2,}", text)
    return cells if not is_strict and len(cells) == count and not any(map(is_numeral, cells)) else None


def _preamble(name: str, text: str, first: int) -> DataError | None:
    """Return what is wrong where most lines have as many cells as a header below line `first`, others above it not."""
    lines = [(number, line) for number, line in _lines(text) if number >= first and line.strip()]
    for separator in "\t;,":
        counts = [len(cells_of(line, separator)) for _, line in lines]
        usual = Counter(counts).most_common(1)[0][0]
        place, header = lines[counts.index(usual)]
        if usual > 1 and place > first and not any(map(is_numeral, cells_of(header, separator))):
            last = lines[counts.index(usual) - 1][0]
            above = f"line {first} of {name} stands" if last == first else f"lines {first} to {last} of {name} stand"
            return DataError(
                f"{above} above the header '{shortened(header, 60)}' in line {place}; begin them with #, or remove them"
            )
    return None


def _check_header(name: str, headers: Sequence[str]) -> None:
    if all(header and is_numeral(header) for header in headers):
        raise DataError(f"the first line of {name} holds numbers only; a header with column names is expected there")
    if len(headers) == 1 and len(headers[0].split()) > 1:
        column = shortened(headers[0], 60)
        raise DataError(f"{name} has one column, '{column}'; separate columns with commas, semicolons or tabs")
