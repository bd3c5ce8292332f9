"""Lines below a table are left out and named; a damaged row is none of them."""

from pathlib import Path

import openpyxl
import pandas
import pytest

from atoll.api.tables import table_of
from atoll_coordinator.data.reading.raw_table import footer_length
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

ROWS = [(0.5 * row, 1.5 * row, 10 - row) for row in range(8)]
FOOTERS = [
    ["Total,42,52"],
    ["Σ,42,52"],
    ["Mean,5.25,6.5", "SD,3.4,2.3", "n = 8"],
    ["", "Source: Institute of Fisheries, 2020, page 3"],
    ["n = 20"],
    ["p < 0.05"],
    ["-----", "end of file"],
    ["20 observations"],
    ["(c) 2020 by me", "", "made on 3 May"],
    ['"Source: a, b",,'],
]
DAMAGED = ["4.0,1", "4.", "x.0,12,2", "4.0,x,2", ",error,2", "4.0,12,2,7", "4.0;12;2", "x"]


def text(*below: str, above: str = "", separator: str = ",", header: str = "t,x,y") -> str:
    lines = [header, *(",".join(map(str, row)) for row in ROWS), *below]
    return above + "\n".join(lines).replace(",", separator) + "\n"


@pytest.mark.parametrize("above", ["", "Run 3\nDevice,FM-1\n\n"], ids=["", "preamble"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("below", FOOTERS, ids=lambda below: below[0] or below[1])
def test_a_footer_is_left_out_and_named(below, separator, above, read) -> None:
    table = read(text(*below, above=above, separator=separator))
    assert [*zip(*table.columns.tolist(), strict=True)] == ROWS
    assert table.starts == (0,)
    (phrase,) = table.left_out
    first = next(line for line in below if line)
    assert phrase.startswith("line")
    assert f"'{first.split(',')[0].strip(chr(34))}" in phrase
    assert phrase in table.read_as


@pytest.mark.parametrize("below", [[], ["Total,42,52"], ["", "Source: me"]], ids=lambda below: "".join(below))
@pytest.mark.parametrize("place", [3, 8], ids=["middle", "last row"])
@pytest.mark.parametrize("row", DAMAGED)
def test_a_damaged_row_is_refused_above_a_footer_as_well(row, place, below, read) -> None:
    lines = text().splitlines()
    with pytest.raises(DataError):
        read("\n".join([*lines[:place], row, *(lines[place + 1 :]), *below]))


@pytest.mark.parametrize("row", ["Total,42,52", "n = 20", "Source: me"])
def test_a_line_of_text_between_rows_is_no_footer(row, read) -> None:
    lines = text().splitlines()
    with pytest.raises(DataError):
        read("\n".join([*lines[:5], row, *lines[5:]]))


@pytest.mark.parametrize("last", ["03-Ma", "03-", "31-Marc"])
def test_a_date_that_lost_its_end_is_no_footer(last, read) -> None:
    rows = "".join(f"{day:02}-Mar-2021,{day},2\n" for day in range(1, 8)).replace("07-Mar", "07-Apr")
    with pytest.raises(DataError):
        read(f"day,x,y\n{rows}{last}\n")


def test_rows_of_a_trajectory_whose_name_is_no_number_are_no_footer(read) -> None:
    runs = "".join(f"{run},{row},{row + 0.5}\n" for run in (1, 2, 3, "control") for row in range(6))
    with pytest.raises(DataError, match=r"column 'subject' of a\.csv holds 'control' in line 20"):
        read(f"subject,t,x\n{runs}")


def test_the_last_row_of_names_may_lose_its_end_and_is_refused(read) -> None:
    rows = "".join(f"{run},{row},{row + 0.5}\n" for run in ("left", "right") for row in range(6))
    for last in ("rig\n", "right\n", "right,6\n"):
        with pytest.raises(DataError):
            read(f"run,t,x\n{rows}{last}")
    assert read(f"run,t,x\n{rows}Source: me\n").rows == 12


def test_footers_of_workbooks_frames_and_records(tmp_path: Path) -> None:
    rows = [*ROWS, ("Total", 42.0, 52), ("Source: me", None, None)]
    book = openpyxl.Workbook()
    for row in (("t", "x", "y"), *rows):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    frame = pandas.DataFrame(rows, columns=["t", "x", "y"])
    records = [dict(zip("txy", row, strict=True)) for row in rows]
    for data, kind, first in ((tmp_path / "a.xlsx", "line", 10), (frame, "row", 9), (records, "row", 9)):
        table = table_of(data, DataConfig())
        assert [*zip(*table.columns.tolist(), strict=True)] == ROWS
        (phrase,) = table.left_out
        assert phrase.startswith(f"{kind}s {first} to {first + 1} below the table left out: 'Total 42")


def test_a_table_without_a_footer_costs_a_look_at_its_first_rows_and_its_last() -> None:
    looked_at: list[int] = []
    assert footer_length(100_000, lambda place: looked_at.append(place) or ["1", "2"]) == 0
    assert len(looked_at) < 100
