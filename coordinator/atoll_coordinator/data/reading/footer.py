"""Lines below a table that are no rows of it: totals, sources, numbers of observations. Pure.

They are the rows below the last row of data. The first of them has to read as a line of text, or to begin with a word
where all rows above it have a number or a date. Anything else there is a damaged row, which is refused as elsewhere.
"""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from atoll_coordinator.data.reading.cells import is_missing, shortened
from atoll_coordinator.data.reading.dates import is_datum

_SAMPLED: Final = 50
"""Rows that tell which columns hold numbers: the first ones, half of all at most, since a footer comes last."""
_QUOTED: Final = 3
"""Lines that a message quotes."""
_LETTERS: Final = r"[^\W\d_]"
_WORD: Final = re.compile(rf"[^0-9]*?(?:{_LETTERS}{{2,}}|[^\x00-\x7f\d\W_])[^0-9]*")
"""Text with a word, or with a letter such as Σ, and without a digit, which a damaged number has."""
_TEXTS: Final = rf"[^0-9]*{_LETTERS}{{2,}}.*|\W*{_LETTERS}(?:\s*[=:<>]|\)\s).*|\W*[^\w\s]{{3,}}\W*"
_BEGINS_WITH_A_WORD: Final = re.compile(_TEXTS, re.DOTALL)
"""A word before any digit, ``n = 20``, ``p < 0.05``, ``(c) 2020``, or a rule of three marks or more."""
_LINE_OF_TEXT: Final = re.compile(rf"{_TEXTS}|\W*\d+ .*{_LETTERS}{{3,}}.*", re.DOTALL)
"""These, or ``20 observations``, which may also be a damaged date."""
_ALIKE: Final = 3
"""Characters in which a damaged name or date is like others of its column, such as those of a month."""


def footer_length(rows: Sequence[Sequence[str]]) -> int:
    """Return how many of the last rows are no rows of the table; rows that are blank are none of them.

    That is 0 where the last row is one of data, and where it may be a damaged one.
    """
    return footer_below(len(rows), lambda place: rows[place])


def footer_below(count: int, row: Callable[[int], Sequence[str]]) -> int:
    """Return `footer_length` of `count` rows, of which `row` returns one by its place."""
    if count < 2:
        return 0
    first = [row(place) for place in range(min(max(count // 2, min(count, 3)), _SAMPLED))]
    width = Counter(map(len, first)).most_common(1)[0][0]
    sample = [cells for cells in first if len(cells) == width]
    numeric = [place for place in range(width) if _is_numeric([cells[place] for cells in sample])]
    end = count
    while end and not _is_data(row(end - 1), width, numeric):
        end -= 1
    if not numeric or end in (0, count):
        return 0
    below = [row(place) for place in range(end, count)]
    wide = [cells[0].strip() for cells in below if len(cells) == width and any(map(is_datum, cells))]
    if len(set(wide)) < len(wide):
        return 0  # rows of a trajectory whose name is not a number
    if width == 1 and below[0][0].strip().isalpha():
        return 0  # a word in place of a number
    names = [cell for place in range(end) if any(map(str.isalpha, cell := row(place)[0].strip()))]
    return len(below) if _is_text(below[0], 0 in numeric, names) else 0


def _is_numeric(cells: Sequence[str]) -> bool:
    """Tell whether most cells of a column that hold something hold numbers or dates."""
    filled = [is_datum(cell) for cell in cells if not is_missing(cell)]
    return 2 * sum(filled) > len(filled)


def _is_data(cells: Sequence[str], width: int, numeric: Sequence[int]) -> bool:
    """Tell whether a row has as many cells as the table, and numbers or dates, or nothing, where these have them."""
    if len(cells) != width:
        return False
    filled = [cells[place] for place in numeric if not is_missing(cells[place])]
    return bool(filled) and all(map(is_datum, filled))


def _is_text(cells: Sequence[str], is_numeric: bool, names: Sequence[str]) -> bool:
    """Tell whether a row is no row of data, not even a damaged one.

    The first column `is_numeric` where it holds numbers or dates; `names` are its cells with letters, of dates as well.
    """
    first, filled = cells[0].strip(), [cell for cell in cells if not is_missing(cell)]
    if is_missing(first) or is_datum(first) or any(name.startswith(first[:_ALIKE]) for name in names):
        return False  # a row that lost its end begins as others do
    has_numbers = any(map(is_datum, filled))
    if _WORD.fullmatch(first) and (is_numeric or not has_numbers):
        return True
    may_be_date = any(name[0].isdecimal() for name in names)
    is_sentence = _BEGINS_WITH_A_WORD if may_be_date else _LINE_OF_TEXT
    is_split = sum(not is_datum(cell) for cell in filled) > 1  # at the spaces of a sentence
    return is_sentence.fullmatch(" ".join(cells)) is not None and (is_split or not has_numbers)


def footer_phrase(lines: Sequence[int], rows: Sequence[Sequence[str]], kind: str = "line") -> str:
    """Say which lines below a table are left out; `rows` are their cells."""
    places = f"{kind} {lines[0]}" if len(lines) == 1 else f"{kind}s {lines[0]} to {lines[-1]}"
    quoted = ", ".join(f"'{shortened(' '.join(cells), 40)}'" for cells in rows[:_QUOTED])
    return f"{places} below the table left out: {quoted}{', …' if len(rows) > _QUOTED else ''}"
