"""Files that cannot be read as they are: one sentence that says what was found and what helps, and exit code 2."""

from pathlib import Path

import numpy as np
import pytest

from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import DataError


def rows(form: str) -> str:
    """Return twelve rows of a format of i, j = i + 1 and k = 20 - i."""
    return "".join(form.format(i=i, j=i + 1, k=20 - i) + "\n" for i in range(12))


BROKEN: dict[str, tuple[str, str | bytes, str]] = {
    "empty": ("a.csv", "", "a.csv is empty; a header line"),
    "comments": ("a.csv", "# a\n# b\n", "a.csv holds comments only; a header line"),
    "no cells": ("a.csv", ",,\n,,\n", "a.csv has a header but no rows; rows of numbers"),
    "stamps beside a time": (
        "a.csv",
        "t,at\n" + rows("{i},17000000000000000{j:02}"),
        "left in a.csv: 'at' holds '1700000000000000001' in line 2",
    ),
    "no rows": ("a.csv", "# made\nt,x\n", "a.csv has a header but no rows; rows of numbers"),
    "a word": ("a.csv", "t,x\n" + rows("{i},{j}") + "12,two\n", "holds 'two' in line 14 where a number"),
    "a short row": ("a.csv", "t,x\n" + rows("{i},{j}") + "12\n", "line 14 of a.csv has 1 cell where the header has 2"),
    "a long row": ("a.txt", "t x\n" + rows("{i} {j}") + "1 2 3\n", "line 14 of a.txt has 3 cells"),
    "decimal commas between commas": ("a.csv", "t,x\n" + rows("0,{i},1,{j}"), "line 2 of a.csv has 4 cells"),
    "thousands or decimals": ("a.tsv", "t\tx\n" + rows("{i}\t{j},234"), "'1,234', which may be 1234 or 1.234"),
    "commas and points": ("a.csv", "t;x\n0;1,5\n1;2.5\n", "holds '2.5' in line 3, but decimal commas above it"),
    "day or month": ("a.csv", "date,x\n" + rows("01/{j:02}/2020,{i}"), "day/month/year or month/day/year"),
    "no such day": ("a.csv", "date,x\n2020-02-29,1\n2020-02-30,2\n", "'2020-02-30' in line 3, which is not a date"),
    "no such month": ("a.csv", "date,x\n13/01/2020,1\n01/13/2020,2\n", "'01/13/2020' in line 3, which is not a date"),
    "dates in two forms": ("a.csv", "date,x\n2020-02-27,1\n28.02.2020,2\n", "not written as '2020-02-27' is"),
    "zones in some rows": ("a.csv", "date,x\n2020-02-27T00:00Z,1\n2020-02-28T00:00,2\n", "a time zone in some rows"),
    "minutes or hours": ("a.csv", "time,x\n00:10,1\n45:20,2\n", "'45:20', which may be minutes and seconds"),
    "time that goes back": ("a.csv", "date,x\n" + rows("2020-01-{k},{i}"), "time goes back from 2020-01-"),
    "two columns of dates": ("a.csv", "a,b,x\n" + rows("2020-01-{k},2020-02-{k},{i}"), "no time column was found"),
    "words for time": ("a.csv", "t,x\n" + rows("day {i},{i}"), "holds text that is neither a number nor a date"),
    "header twice": ("a.csv", "t,x\nt,x\n" + rows("{i},{j}"), "column 't' of a.csv holds 't' in line 2"),
    "words for units": ("a.csv", "t,x\nzero,one\n" + rows("{i},{j}"), "column 't' of a.csv holds 'zero' in line 2"),
    "an error of a spreadsheet": ("a.csv", "t,x\n0,1\n#DIV/0!,2\n", "holds '#DIV/0!' in line 3"),
    "damaged UTF-8": ("a.csv", "t,ø\n0,1\n".encode() + b"1,\xff\n", "a.csv is not UTF-8 text (byte 12)"),
    "a picture": ("a.csv", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "a.csv holds zero bytes, as a binary file"),
    "control characters": ("a.csv", b"t,x\n0,\x01\xff\n", "a.csv is not UTF-8 text (byte 8)"),
    "UTF-16 without its mark": ("a.csv", "t,x\n0,1\n".encode("utf-16-le"), "or UTF-16 without a byte order mark"),
    "a cell without a header": ("a.csv", "t,x\n" + rows("{j},{i},3"), "line 2 of a.csv has 3 cells where the header"),
    "a workbook called CSV": ("a.csv", b"PK\x03\x04 and more", "a.csv is an Excel workbook or another ZIP archive"),
    "no workbook": ("a.xlsx", b"no", "a.xlsx cannot be read as an Excel workbook"),
    "no MATLAB file": ("a.mat", b"no matlab" * 100, "a.mat cannot be read as a MATLAB file"),
    "no HDF5 file": ("a.h5", b"no", "a.h5 cannot be read as an HDF5 file"),
    "no JSON": ("a.json", "{'t': 1}", "a.json is not valid JSON from line 1, column 2 on; a list of records"),
    "no Parquet file": ("a.parquet", b"PAR1 no", "a.parquet cannot be read as a Parquet file; save the file again"),
    "an open quote": ("a.csv", 't,x\n0,1\n1,"13\n2,15\n', "line 3 of a.csv has a quotation mark that is not closed"),
    "a long open quote": ("a.csv", 't,"x\n' + rows("{i},{j}") * 9999, "line 1 of a.csv has a quotation mark"),
    "units in cells": ("a.csv", "t,x\n" + rows("{i},{j} %"), "left in a.csv: 'x' holds '1 %' in line 2; write only"),
    "comments behind cells": ("a.csv", "t,x\n" + rows("{i},{j} # c"), "'x' holds '1 # c' in line 2; write"),
    "JSON lines": ("a.csv", '{"t":0,"x":4}\n{"t":1,"x":5}\n', "a.csv holds JSON or JSON lines; give it the ending"),
    "minutes with fractions": ("a.csv", "time,x\n00:00.5,0\n00:01.5,1\n", "'00:00.5', which may be minutes and"),
    "a date with minutes and a fraction": ("a.csv", "time,x\n2020-01-01 00:00.5,0\n", "which is not a date or time"),
    "clock that goes back": ("a.csv", "time,x\n23:00,1\n22:00,2\n" + rows("23:{j:02},1"), "from 23:00:00 to 22:00:00"),
    "no array": ("a.npy", b"\x93NUMPY", "a.npy cannot be read as a NumPy array of numbers; save the file again"),
    "another word for time": ("a.csv", "x,Zeit\n" + rows("7,{i}"), "name it with --time (perhaps Zeit), or give"),
    "numbers in JSON": ("a.json", "[1, 2]", 'a.json holds no records; a list of records such as [{"t": 0, "x": 1}]'),
    "a line of JSON": ("a.jsonl", '{"t": 0}\n{"t": \n{"t": 2}\n', "line 2 of a.jsonl is not valid JSON"),
    "lists in JSON": ("a.json", '[{"t": 0, "x": [1]}]', "column 'x' of a.json holds lists or objects"),
    "columns of two lengths": ("a.json", '{"t": [0, 1], "x": [1]}', "whose values are not columns of equal length"),
    "an old workbook": ("a.xls", b"any", "a.xls is an Excel workbook of the old format; save it as .xlsx"),
    "a pickle": ("a.pkl", b"any", "a.pkl is a pickle, which may hold programs"),
    "one column": ("a.csv", "t x y\n0 1\n", "a.csv has one column, 't x y'; separate columns with commas"),
    "one name twice": ("a.csv", "t,x [m],x [s]\n0,1,2\n", "a.csv has 2 columns named 'x'"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_file_is_one_sentence_and_code_2(kind: str, tmp_path: Path) -> None:
    name, content, words = BROKEN[kind]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DataError) as raised:
        describe(read_table([path], DataConfig()), JobConfig())
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)
    assert raised.value.exit_code == 2


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_a_dataset_that_names_another_file_is_refused(kind, tmp_path: Path) -> None:
    """Whoever wrote a file would see what whoever reads it may read."""
    import h5py

    (tmp_path / "other").write_bytes(np.arange(12, dtype=np.int8).tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.arange(12.0)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = np.arange(12.0)
        if kind == "external":
            file.create_dataset("x", (12,), "int8", external=[(str(tmp_path / "other"), 0, 12)])
        else:
            layout = h5py.VirtualLayout((12,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (12,))
            file.create_virtual_dataset("x", layout)
    with pytest.raises(DataError, match=r"dataset 'x' of a\.h5 is kept in another file"):
        read_table([tmp_path / "a.h5"], DataConfig())
