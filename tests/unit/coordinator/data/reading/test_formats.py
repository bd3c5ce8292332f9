"""Files as the programs write them that people use: read as meant, and it is said how they were read."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import polars
import pytest
import scipy.io

from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError

MADE = Path(__file__).parent / "files"
ROWS = np.arange(12)
T, X, Y = 0.5 * ROWS, 1500.0 + 1000.0 * np.cos(ROWS), np.sin(ROWS)
MATRIX = np.column_stack([T, X, Y])
Writer = Callable[[Path], object]


def text(line: str, header: str = "t,x,y", comments: str = "", encoding: str = "utf-8") -> Writer:
    """Return what writes a row as `line`, a format of t, x and y; what commas and points it has, stays as it is."""
    rows = [line.format(t=t, x=x, y=y) for t, x, y in MATRIX]
    return lambda path: path.write_bytes(
        "\n".join([*([comments] if comments else []), header, *rows, ""]).encode(encoding)
    )


def comma(line: str, header: str) -> Writer:
    """Return what writes rows with decimal commas and thousands of points."""
    swapped = str.maketrans({",": ".", ".": ","})
    rows = [line.format(t=t, x=x, y=y).translate(swapped) for t, x, y in MATRIX]
    return lambda path: path.write_text("\n".join([header, *rows, ""]))


def workbook(path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append([])
    sheet.append([None, "t", "x", "y"])
    sheet.append([None, "s", "m", "m/s"])
    for row in MATRIX.tolist():
        sheet.append([None, *row])
    book.create_sheet("notes").append(["nothing of interest"])
    book.save(path)


def with_notes(path: Path) -> None:
    """Write a cover sheet, sheets of notes and of few numbers, then one with notes above the table, and another run."""
    book = openpyxl.Workbook()
    cover = book.active
    for cells in (["Parameter", "Value"], *([name, 1.5] for name in "abcdef")):
        cover.append(cells)
    book.create_sheet("empty")
    few = book.create_sheet("few")
    for cells in (["t", "k"], [0, 1], [1, 2]):
        few.append(cells)
    for title, factor in (("run 1", 1.0), ("run 2", 2.0)):
        sheet = book.create_sheet(title)
        for cells in (["Experiment of Monday"], [], ["made by A"], [None, "ball"], ["t", "x", "y"]):
            sheet.append(cells)
        for t, x, y in MATRIX.tolist():
            sheet.append([t, factor * x, y])
    book.save(path)


def matlab_73(path: Path) -> None:
    """Lay an HDF5 file out as MATLAB 7.3 does: a block of text before it, columns as rows, classes as attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": T[np.newaxis, :], "x": np.stack([X, Y])}.items():
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["note"] = np.array([[104], [105]], dtype=np.uint16)
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")["a"] = T
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Nov 23 10:00:00 2026".ljust(124))


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        for name, values, unit in (("t", T, "s"), ("x", X, "m"), ("y", Y, "m/s")):
            group[name] = values
            group[name].attrs["units"] = unit


def structured(fields: list[tuple[str, str]]) -> np.ndarray:
    return np.array([tuple(row) for row in MATRIX.tolist()], dtype=fields)


def nested() -> np.ndarray:
    array = np.zeros(len(T), dtype=[("t", "f8"), ("at", [("x", "f8"), ("y", "f8")])])
    array["t"], array["at"]["x"], array["at"]["y"] = T, X, Y
    return array


def compound(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["table"] = np.array([tuple(row) for row in MATRIX.tolist()], dtype=[("t", "f8"), ("x", "f8"), ("y", "f8")])


def parquet(path: Path) -> None:
    times = polars.datetime_range(
        polars.datetime(2021, 3, 1, 6), polars.datetime(2021, 3, 1, 11, 30), "30m", time_zone="Europe/Paris", eager=True
    )
    polars.DataFrame({"time": times, "x": X, "y": Y}).write_parquet(path)


CLOCK = [f"2021-03-01T{6 + row // 2:02}:{30 * (row % 2):02}:00" for row in ROWS]
EXCEL = "t;x;y"
"""Header as Excel writes it in countries of decimal commas."""

WRITTEN: dict[str, tuple[str, Writer, dict[str, object]]] = {
    "numpy.savetxt": ("a.txt", lambda path: np.savetxt(path, MATRIX, header="t x y"), {"says": "spaces; header in a"}),
    "numpy.savetxt with more lines": (
        "a.dat",
        lambda path: np.savetxt(path, MATRIX, header="run 7\nt, x, y\ns, m, m/s", footer="end", delimiter=", "),
        {"units": ("s", "m", "m/s"), "says": "2 comment lines left out"},
    ),
    "numpy.savez of a matrix": (
        "a.npz",
        lambda path: np.savez(path, t=T, x=MATRIX[:, 1:], of=np.array(7)),
        {"names": "t x0 x1"},
    ),
    "comments and units": (
        "a.csv",
        text("{t},{x},{y}", comments="# made by a logger\n% version 2", header="t,x,y\ns,°C,µmol/L"),
        {"units": ("s", "°C", "µmol/L"), "says": "units in line 4"},
    ),
    "spaces of many widths": (
        "a.txt",
        text("{t:8.2f}  {x:20.12f} {y:20.12f}  ", header="  t   x  y"),
        {"says": "spaces"},
    ),
    "thousands in quotes": ("a.csv", text('{t},"{x:,.9f}",{y}'), {"says": "separators of thousands in x"}),
    "thousands of points": ("a.csv", comma("{t};{x:,.9f};{y}", EXCEL), {"says": "decimal commas in t, x, y"}),
    "thousands of spaces": (
        "a.tsv",
        lambda path: path.write_text(
            "t\tx\ty\n" + "".join(f"{t}\t{x:,.9f}\t{y}\n" for t, x, y in MATRIX).replace(",", "\u202f")
        ),
        {"says": "tabs"},
    ),
    "Excel with sep=": ("a.csv", comma("{t}|{x:.9f}|{y}", "sep=|\nt|x|y"), {"says": "'|'"}),
    "Excel with a byte order mark": ("a.csv", text("{t},{x},{y}", header="\ufefft,x,y"), {}),
    "Latin-1": (
        "a.csv",
        text("{t},{x},{y}", header="t [s],x [°C],y [µm]", encoding="latin-1"),
        {"units": ("s", "°C", "µm"), "says": "Windows-1252 (Latin-1)"},
    ),
    "MATLAB": (
        "a.mat",
        lambda path: scipy.io.savemat(path, {"run": {"t": T, "x": MATRIX[:, 1:]}, "note": "hi", "k": 3.0}),
        {"names": "t x1 x2", "says": "MATLAB; left out: note, k"},
    ),
    "MATLAB 7.3": ("a.mat", matlab_73, {"names": "t x1 x2", "says": "MATLAB 7.3"}),
    "HDF5": ("a.h5", hdf5, {"units": ("s", "m", "m/s"), "says": "HDF5"}),
    "HDF5, a table": ("a.hdf5", compound, {"says": "HDF5"}),
    "Excel": (
        "a.xlsx",
        workbook,
        {"units": ("s", "m", "m/s"), "says": "Excel, sheet 'Sheet'; units in line 3; other sheets left out: notes"},
    ),
    "Excel with notes": (
        "a.xlsx",
        with_notes,
        {
            "says": "Excel, sheet 'run 1'; lines 1 to 3 above the header left out; "
            "header in line 5 below names of groups: ball; other sheets left out: Sheet, few, run 2"
        },
    ),
    "numpy.save of a structured array": (
        "a.npy",
        lambda path: np.save(path, structured([("t", "f8"), ("x", "f4"), ("y", "f8")])),
        {"says": "NumPy array", "digits": 3},
    ),
    "numpy.save of nested fields": (
        "a.npy",
        lambda path: np.save(path, nested()),
        {"names": "t at.x at.y"},
    ),
    "numpy.savez of a structured array": (
        "a.npz",
        lambda path: np.savez(path, run=structured([("t", "f8"), ("x", "f8"), ("y", "f8")]), k=np.array(3.0)),
        {"says": "NPZ; left out: k"},
    ),
    "JSON lines": (
        "a.jsonl",
        lambda path: path.write_text("".join(json.dumps({"t": t, "x": x, "y": y}) + "\n" for t, x, y in MATRIX)),
        {"says": "JSON lines"},
    ),
    "JSON columns": (
        "a.json",
        lambda path: path.write_text(json.dumps({"t": T.tolist(), "x": X.tolist(), "y": Y.tolist()})),
        {"says": "JSON"},
    ),
    "ISO dates": (
        "a.csv",
        lambda path: path.write_text(
            "date,x,y\n" + "".join(f"{c}Z,{x},{y}\n" for c, x, y in zip(CLOCK, X, Y, strict=True))
        ),
        {
            "names": "time x y",
            "unit": "min",
            "says": "column 'date' is the time; time: dates year-month-day, in min since 2021-03-01 06:00:00 UTC",
        },
    ),
    "Parquet with dates": (
        "a.parquet",
        parquet,
        {"names": "time x y", "unit": "min", "says": "since 2021-03-01 05:00:00 UTC"},
    ),
}

COMMITTED: dict[str, dict[str, object]] = {
    "r_write_csv.csv": {"says": "text left out: column 1"},
    "r_write_csv2.csv": {"says": "decimal commas in t, x, y"},
    "r_write_table.txt": {"says": "spaces"},
    "r_posixct.csv": {"names": "time x y", "unit": "min", "says": "since 2021-03-01 06:00:00"},
    "libreoffice.csv": {"names": "time x y", "unit": "min", "says": "dates day.month.year", "digits": 3},
    "libreoffice_de.csv": {
        "names": "time x y",
        "unit": "min",
        "says": "decimal commas in x, y; separators of thou",
        "digits": 3,
    },
    "libreoffice.xlsx": {"names": "time x y", "unit": "min", "says": "Excel, sheet 'Run 1'", "digits": 3},
    "pandas_datetime_index.csv": {"names": "time x y", "unit": "min", "says": "since 2021-03-01 06:00:00"},
    "pandas_timedelta.csv": {"names": "time x y", "unit": "min", "says": "clock times, in min since midnight"},
    "pandas_records.json": {"says": "JSON"},
    "pandas_split.json": {"says": "JSON"},
}


def check(
    path: Path, names: str = "t x y", unit: str = "", units: object = None, says: str = "", digits: int = 8
) -> None:
    table = read_table([path], DataConfig())
    assert " ".join(table.names) == names
    factor = {"": 1.0, "min": 60.0, "h": 1.0}[unit]
    expected = [T * factor, X, Y] if len(table.names) == 3 else [X, Y]
    for column, meant in zip(table.columns, expected, strict=True):
        assert np.allclose(column, meant, rtol=10.0**-digits, atol=10.0**-digits)
    if units is not None:
        assert table.units == units
    if unit:
        assert table.units[0] == unit
    assert says in table.read_as
    if len(table.names) == 3:
        assert f"\nread as {table.read_as}\n" in describe(table, JobConfig())
    assert Table.from_bytes(table.to_bytes()).read_as == table.read_as


@pytest.mark.parametrize("kind", WRITTEN)
def test_files_of_programs_are_read_as_meant(kind: str, tmp_path: Path) -> None:
    name, write, expected = WRITTEN[kind]
    write(tmp_path / name)
    check(tmp_path / name, **expected)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", COMMITTED)
def test_files_that_programs_have_written_are_read_as_meant(name: str) -> None:
    check(MADE / name, **COMMITTED[name])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("module", "name", "extra"),
    [
        ("openpyxl", "a.xlsx", "xlsx"),
        ("h5py", "a.h5", "hdf5"),
        ("h5py", "b.mat", "hdf5"),
        ("polars", "a.parquet", "parquet"),
    ],
)
def test_an_extra_that_is_not_installed_is_named(
    module: str, name: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    makers = {"a.xlsx": workbook, "a.h5": hdf5, "b.mat": matlab_73, "a.parquet": Path.touch}
    makers[name](tmp_path / name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DataError) as raised:
        read_table([tmp_path / name], DataConfig())
    assert str(raised.value) == f"reading {name} needs {module}; run: pip install 'atoll[{extra}]'"


def test_files_that_are_read_differently_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    (tmp_path / "b.txt").write_text("# t x\n1 2\n")
    table = read_table([tmp_path / "a.csv", tmp_path / "b.txt"], DataConfig())
    assert table.columns.tolist() == [[0.0, 1.0], [1.0, 2.0]]
    assert table.read_as == "a.csv: text with commas; b.txt: text with spaces, header in a comment"


def test_groups_with_times_of_their_own_are_refused_unless_options_choose(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for group in "ab":
            file[f"{group}/t"], file[f"{group}/x"] = T, X
    with pytest.raises(DataError, match=r"a\.h5 holds 2 times, t, b\.t; write each group into a file of its own"):
        read_table([tmp_path / "a.h5"], DataConfig())
    assert read_table([tmp_path / "a.h5"], DataConfig(time="t", states=("x",))).rows == len(T)


def test_a_sheet_may_be_named(tmp_path: Path) -> None:
    with_notes(tmp_path / "a.xlsx")
    table = read_table([tmp_path / "a.xlsx"], DataConfig(sheet="run 2"))
    assert np.allclose(table.column("x"), 2.0 * X)
    assert table.read_as.startswith("Excel, sheet 'run 2'; lines 1 to 3 above the header left out")
    assert table.left_out == ("other sheets left out: Sheet, few, run 1",)
    assert read_table([tmp_path / "a.xlsx"], DataConfig(sheet="few")).rows == 2


@pytest.mark.parametrize(
    ("sheet", "words"), [("run1", "did you mean 'run 1'?"), ("empty", "sheet 'empty' of a.xlsx is empty")]
)
def test_a_sheet_without_a_table_is_refused(sheet: str, words: str, tmp_path: Path) -> None:
    with_notes(tmp_path / "a.xlsx")
    with pytest.raises(DataError) as raised:
        read_table([tmp_path / "a.xlsx"], DataConfig(sheet=sheet))
    assert words in str(raised.value)
