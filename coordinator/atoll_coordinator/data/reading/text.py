"""Text files -> `RawTable`: their encoding, the character between cells, comments, and where the table begins.

1. Bytes are UTF-8, UTF-16 with a byte order mark, else Windows-1252, which includes the printable characters of
   Latin-1.
2. The header is the first line that is not a comment. If that line has numbers, the header is the last comment before
   it with as many cells, as `numpy.savetxt` writes it.
3. Titles, settings and names of the recorder may stand above the table (a preamble). The first rows of numbers show
   where the table begins: the header is the row of text above them. If there are several rows of text, the header is
   the only widest row, or the only widest row that names a time. In other cases the header may not be clear; then the
   table is refused.

Lines keep their numbers, because messages name them.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, NamedTuple

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, on_one_line, shortened
from atoll_coordinator.data.reading.dates import is_datum
from atoll_coordinator.data.reading.raw_table import (
    RawTable,
    Record,
    are_groups,
    footer_length,
    is_units_row,
    plain_unit,
    table_of_records,
    take_header,
)
from atoll_coordinator.data.reading.reshaping import has_times
from atoll_coordinator.data.roles.names_and_options import TIME_NAMES, split_unit
from atoll_core.errors import DataError

# ----------------------------------------------------------------------------------------------------------- encoding

_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
_UTF_8: Final = re.compile(rb"[\xc2-\xdf][\x80-\xbf]|[\xe0-\xef][\x80-\xbf]{2}|[\xf0-\xf4][\x80-\xbf]{3}")
_FIRST_BYTES: Final = (
    (b"PK\x03\x04", "an Excel workbook or another ZIP archive", ".xlsx or .npz"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", ".xlsx, saved as such"),
    (b"\x89HDF", "an HDF5 file", ".h5"),
    (b"MATLAB", "a MATLAB file", ".mat"),
    (b"PAR1", "a Parquet file", ".parquet"),
    (b"\x1f\x8b", "a gzip archive", ".csv, unpacked"),
)
"""First bytes of other formats, and the file name ending under which the format is read."""


def decode(name: str, data: bytes) -> tuple[str, str]:
    """Return the text, and the name of its encoding ("" for UTF-8); raises DataError if the bytes are not text."""
    for start, kind, ending in _FIRST_BYTES:
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
        where = f"byte {error.start + 1}"
        raise DataError(f"{name} is not UTF-8 text ({where}); save it as CSV in UTF-8, or as Parquet") from error


# ----------------------------------------------------------------------------------------------------------- preamble

SAMPLED: Final = 200
"""A table with a preamble must begin within this number of rows; the limit saves time for long files.

Preambles have a few dozen lines. With any limit from 20 to 2,000, the 498 files that `benchmarks.operations.files`
draws are read in the same way.
"""
_ALIKE: Final = 20
"""This many first rows of a table must have numbers in the same columns.

Measured on the same 498 files, tables of 6 to 15 rows: with 2 rows, five undamaged files are refused. With 3 and with
10 rows the same files are read as with 20, but some damaged files are refused with another sentence. From 12 rows on
nothing changes.
"""
_TIMES: Final = frozenset({"t", "time", "times", "timestamp", "date", "datetime", "day", "hour", "year"})
"""Names of time columns in lower case, which distinguish a header from other rows of text."""


@dataclass(frozen=True)
class Preamble:
    """The rows of a file before its table: `header` is the line of the header, with the lines `above` it.

    `below` are lines of text between the header and the first numbers that are neither units nor data.
    """

    header: int
    above: tuple[int, ...]
    below: tuple[int, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Phrases about the lines that are left out."""
        named = {
            where: f"line {lines[0]}" if len(lines) == 1 else f"lines {lines[0]} to {lines[-1]}"
            for lines, where in ((self.above, "above"), (self.below, "below"))
            if lines
        }
        return tuple(f"{lines} {where} the header left out" for where, lines in named.items())


def find_preamble(rows: Sequence[Record]) -> Preamble | None:
    """Return the preamble of a table from its nonblank rows; None if there is no preamble, or if it is not clear."""
    rows = rows[:SAMPLED]
    first = next((place for place in range(len(rows)) if _begins_table(rows[place:])), None)
    if not first or any(_is_data(cells, rows[first][1]) for _, cells in rows[:first]):
        return None  # there is no header, the header is a comment, or there are two tables
    if has_times(rows[first][1], [cells for _, cells in rows[first + 1 :]]):
        return Preamble(rows[first][0], tuple(line for line, _ in rows[:first]))
    block = _block(rows, first)
    header = _header_of(rows, block)
    if header is None:
        return None
    start = header
    following = [cells for _, cells in rows[header : header + 4]]
    if header and are_groups(rows[header - 1][1], following[0], following[1:3]):
        start = header - 1
    between = [(line, cells) for line, cells in rows[header + 1 : first]]
    if between and is_units_row(between[0][1], rows[header][1]):
        between = between[1:]
    if len(block) < 3:
        between = []  # a single word in place of a number is refused; several such rows are the preamble of a recorder
    if not start and not between:
        return None
    return Preamble(rows[start][0], tuple(line for line, _ in rows[:start]), tuple(line for line, _ in between))


def _begins_table(rows: Sequence[Record]) -> bool:
    """Tell whether rows of numbers begin here: all of one width, with columns of only numbers or dates.

    A setting such as ``Rate, 100`` has a number in one column only.
    """
    alike = [cells for _, cells in rows[:_ALIKE]]
    width = len(alike[0])
    if width < 2 or not any(map(is_datum, alike[0])):
        return False
    if len(rows) <= 2 * _ALIKE:  # a longer sample does not contain the footer
        alike = alike[: len(rows) - footer_length(len(rows), lambda place: rows[place][1])]
    if any(len(cells) != width for cells in alike):
        return False
    columns = [[cell for cell in column if not is_missing(cell)] for column in zip(*alike, strict=True)]
    numbers = [place for place, column in enumerate(columns) if column and all(map(is_datum, column))]
    filled = sum(is_datum(alike[0][place]) for place in numbers)
    return bool(numbers) and 2 * filled >= len(numbers)


def _is_data(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Tell whether a row holds only numbers and dates, or has them in all columns where the table has them."""
    filled = [cell for cell in cells if not is_missing(cell)]
    of_table = [place for place, cell in enumerate(below) if is_datum(cell)]
    is_like = len(cells) == len(below) and len(of_table) > 1 and all(is_datum(cells[place]) for place in of_table)
    return is_like or (len(filled) > 1 and all(map(is_datum, filled)))


def _block(rows: Sequence[Record], first: int) -> list[int]:
    """Return the indices of the rows of text directly above row `first` that are not wider than it."""
    width = len(rows[first][1])
    block: list[int] = []
    for place in range(first - 1, -1, -1):
        line, cells = rows[place]
        is_apart = bool(block) and line + 1 != rows[place + 1][0]
        if is_apart or any(map(is_datum, cells)) or not 2 <= len(cells) <= width:
            break
        block.append(place)
    return block[::-1]


def _header_of(rows: Sequence[Record], block: Sequence[int]) -> int | None:
    """Return the index of the header among rows of text; None if it is not clear.

    The header is one of the widest rows: the only one, or the only one that names a time. Otherwise it is the first of
    the widest rows, if other rows stand above it.
    """
    width = max((len(rows[place][1]) for place in block), default=0)
    wide = [place for place in block if len(rows[place][1]) == width]
    if len(wide) == 1:
        return wide[0]
    filled = {place: sum(bool(cell.strip()) for cell in rows[place][1]) for place in wide}
    names = {place: [split_unit(cell)[0].strip() for cell in rows[place][1]] for place in wide}
    for known in (frozenset(TIME_NAMES), _TIMES):
        named = [place for place in wide if any(name in TIME_NAMES or name.lower() in known for name in names[place])]
        if len(named) == 1:
            return named[0] if filled[named[0]] >= min(max(filled.values()), 2) else None
    return wide[0] if wide and wide[0] > 0 else None


# ----------------------------------------------------------------------------------------------------------- the table

SPACES: Final = " "
"""Separator that means any white space between cells."""
_NAMES: Final = {",": "commas", ";": "semicolons", "\t": "tabs", SPACES: "spaces"}
_LINE: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_COMMENT: Final = re.compile(r"\s*(?:#(?!N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!)|%)", re.IGNORECASE)
"""The beginning of a comment; error values of spreadsheets are not comments."""
_SEPARATOR: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_JSON: Final = re.compile(r"""\s*(?:\{\s*["}]|\[\s*[\[{]|[{\[]\s*$)""")
"""How the first line of JSON begins."""
_Line = tuple[int, str]


class _Beginning(NamedTuple):
    """The lines before the first row: a separator named in the file, comments, the `first` line, a preamble.

    With a preamble the `first` line is the header.
    """

    separator: str | None
    comments: tuple[str, ...]
    first: _Line
    preamble: Preamble | None = None


def read_text(name: str, data: bytes) -> RawTable:
    """Split a text file into cells; raises DataError if it is not text, is empty, has no header or cannot be split."""
    text, encoding = decode(name, data)
    if not text.strip():
        raise DataError(f"{name} is empty; a header line and rows of numbers are expected")
    beginning = _beginning(name, text)
    number, first = beginning.first
    if _JSON.match(first):
        raise DataError(f"{name} holds JSON or JSON lines; give it the ending .json or .jsonl")
    try:
        raw = _split(name, text, beginning, _COMMENT.match)
    except DataError as error:
        raise (_preamble_error(name, text, number) or error) from None
    if not raw.lines and any(place > number and _COMMENT.match(line) for place, line in _lines(text)):
        # the name of the first column begins with the comment mark
        raw = _split(name, text, beginning, lambda _: None)
    return replace(raw, remarks=(*raw.remarks, encoding)) if encoding else raw


def _lines(text: str) -> Iterator[_Line]:
    """Yield line numbers and lines; a StringIO would take four bytes for each character."""
    return enumerate((match[0] for match in _LINE.finditer(text)), start=1)


def _beginning(name: str, text: str) -> _Beginning:
    separator: str | None = None
    comments: list[str] = []
    first: _Line | None = None
    for number, line in _lines(text):
        if not line.strip():
            continue
        if (named := _SEPARATOR.fullmatch(line)) and not comments and separator is None:
            separator = named[1]
        elif _COMMENT.match(line):
            comments.append(line)
        else:
            first = (number, line)
            break
    if first is None:
        raise DataError(f"{name} holds comments only; a header line and rows of numbers are expected")
    beginning = _Beginning(separator, tuple(comments), first)
    below = ((number, line) for number, line in _lines(text) if number >= first[0] and line.strip())
    sample = [*islice(((number, line) for number, line in below if not _COMMENT.match(line)), SAMPLED)]
    for candidate in separator or "\t;, ":
        split = ((number, cells_of(line, candidate)) for number, line in sample)
        rows = [(number, cells) for number, cells in split if any(map(str.strip, cells))]
        preamble = find_preamble(rows)
        if preamble is not None:
            header = next(line for line in sample if line[0] == preamble.header)
            return beginning._replace(separator=candidate, first=header, preamble=preamble)
        if any(_begins_table(rows[place:]) for place in range(len(rows))):
            return beginning
    return beginning


def _split(name: str, text: str, beginning: _Beginning, is_comment: Callable[[str], object]) -> RawTable:
    number, line = beginning.first
    skipped = () if beginning.preamble is None else beginning.preamble.below
    comments = len(beginning.comments)

    def body() -> Iterator[_Line]:
        nonlocal comments
        for place, line in _lines(text):
            if place >= number and is_comment(line):
                comments += 1
            elif place >= number and place not in skipped:
                yield place, line

    following = (line for place, line in _lines(text) if place > number and line.strip())
    below = next((line for line in following if not _COMMENT.match(line)), "")
    comment_header = _header_of_comments(line, below, beginning)
    remarks = [] if beginning.preamble is None else [*beginning.preamble.remarks]
    if comment_header is not None:
        separator, headers, units = comment_header
        raw = table_of_records(name, headers, _records(name, body(), separator))
        raw = replace(raw, units=units or raw.units)
        remarks.append("header in a comment")
        comments -= 1 + bool(units)
    else:
        separator = beginning.separator or _separator(line, below)
        header, records = take_header(_records(name, body(), separator))
        if not header.is_made:
            _check_header(name, header.names)
        has_row_names = below.lstrip().startswith('"')  # R writes names of rows in this way
        raw = header.applied(table_of_records(name, header.names, records, has_row_names, separator == ","))
    left_out = (f"{comments} comment {'line' if comments == 1 else 'lines'} left out",) if comments else ()
    how = f"text with {_NAMES.get(separator, repr(separator))}"
    return replace(raw, remarks=(how, *remarks, *raw.remarks, *left_out), separator=separator)


def _records(name: str, lines: Iterator[_Line], separator: str) -> Iterator[Record]:
    """Yield line number and cells of each record, blank lines included."""
    if separator == SPACES:
        for number, line in lines:
            yield number, cells_of(line, separator)
        return
    numbers: list[int] = []
    quotes = 0

    def read_lines() -> Iterator[str]:
        nonlocal quotes
        for number, line in lines:
            numbers.append(number)
            quotes += line.count('"')
            yield line

    def unclosed(line: int) -> DataError:
        return DataError(f'line {line} of {name} has a quotation mark that is not closed; close it, or remove the "')

    reader = csv.reader(read_lines(), delimiter=separator, skipinitialspace=True)
    before = 0
    try:
        for record in reader:
            if reader.line_num > before + 1 and quotes % 2:
                raise unclosed(numbers[before])
            yield numbers[before], record
            before, quotes = reader.line_num, 0
    except csv.Error as error:
        if quotes % 2:
            raise unclosed(numbers[before]) from error
        raise DataError(f"line {numbers[-1]} of {name} cannot be split into cells: {error}") from error


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
    """Return the separator in the header, outside of quotes and units: tab, semicolon or comma.

    Otherwise spaces, if possible.
    """
    bare = re.sub(r'"[^"]*"|\[[^\]]*\]', "", header)
    for separator in "\t;,":
        if separator in bare:
            return separator
    count = len(cells_of(header, SPACES))
    return SPACES if count > 1 and len(cells_of(below, SPACES)) in (count, count + 1) else ","


def _header_of_comments(
    line: str, below: str, beginning: _Beginning
) -> tuple[str, Sequence[str], tuple[str, ...]] | None:
    """Return separator, names and units if the first line holds data and a comment before it names the columns.

    Data may hold text if the line `below` has text in the same cells.
    """

    def kinds(cells: Sequence[str]) -> list[bool]:
        return [is_missing(cell) or is_datum(cell) for cell in cells]

    for separator in beginning.separator or "\t;, ":
        cells = cells_of(line, separator)
        has_text = not all(kinds(cells))
        is_like_next = kinds(cells) == kinds(cells_of(below, separator)) and any(map(is_numeral, cells))
        if all(map(is_missing, cells)) or (has_text and not is_like_next):
            continue
        named = [_names_in_comment(comment, separator, len(cells), has_text) for comment in beginning.comments]
        fitting = [names for names in named if names]
        if len(fitting) > 1 and is_units_row(fitting[-1], fitting[-2]):
            return separator, fitting[-2], tuple(plain_unit(cell) for cell in fitting[-1])
        if fitting:
            return separator, fitting[-1], ()
    return None


def _names_in_comment(comment: str, separator: str, count: int, is_strict: bool) -> list[str] | None:
    """Return the cells of a comment if there are `count` of them; else None.

    If `is_strict`, cells are separated as in the data; otherwise any separator is tried.
    """
    text = comment.strip().lstrip("#% \t")
    for candidate in (separator,) if is_strict else (separator, ",", ";", "\t", SPACES):
        cells = [on_one_line(cell) for cell in cells_of(text, candidate)]
        if len(cells) == count and not any(cell.endswith((",", ";")) or is_numeral(cell) for cell in cells):
            return cells
    cells = re.split(r"\s{2,}", text)
    return cells if not is_strict and len(cells) == count and not any(map(is_numeral, cells)) else None


def _preamble_error(name: str, text: str, first: int) -> DataError | None:
    """Return the error if most lines have as many cells as a header below line `first`, unlike lines above it."""
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
