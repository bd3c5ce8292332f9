"""Files as people have them, drawn: every column, row and sheet is read or named, and nothing breaks the reader.

``python -m benchmarks.operations.files --cases 5000`` draws a table from each seed and hides it: below a preamble or
names of groups, above a footer, without a header, with times as columns or in several columns, in long form, among
sheets, in an encoding, with separators and decimal commas, in arrays, frames and records. A fifth of the files is
damaged as well. A case is refused with one sentence, or all values come back; what does not is named in what is said of
the reading.
``--seed 7`` shows one case. Returns 1 where anything was lost silently or broke.
"""

import tempfile
import traceback
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import polars

from atoll.api.tables import table_of
from atoll.terminal.output import note, say
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError
from benchmarks.harness.command_line import option, program, whole

Row = list[str]
PREAMBLES: Final[Sequence[list[Row]]] = (
    [["Run 3 of Monday"], []],
    [["Device", "FM-1"], ["Rate", "100"], []],
    [["Device", "FM-1"], ["Rate", "100"]],
    [["[Header]"], ["version=2"], ["[Data]"]],
    [["Experiment", " run 3", " by me"]],
)
FOOTERS: Final[Sequence[list[Row]]] = (
    [["Total", "45.25", "33.5", "12.125"]],
    [["Mean", "4.5", "3.25", "2.5"], ["SD", "1.5", "0.25", "0.5"], ["n = 20"]],
    [[], ["Source: Institute of Fisheries", " 2020", " page 3"]],
    [["n = 20"]],
    [["-----"], ["end of file"]],
    [["20 observations"]],
    [[], ["* p < 5 %"], ["(c) 2020 by me"]],
)
SHAPES: Final = ("plain", "no header", "years", "quarters", "months", "long", "groups", "short header", "dates")


@dataclass(frozen=True)
class Case:
    """What was drawn: `data` as `table_of` takes it, how, the numbers that it holds, and names that may be left out.

    `values` are columns (N,) by name, and `others` columns and sheets beside them. It `is_damaged` where cells or lines
    were changed.
    """

    data: object
    how: str
    values: Mapping[str, FloatArray]
    others: Sequence[str] = ()
    is_damaged: bool = False
    options: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Content:
    """The rows of a drawn table: those `above` the header, the `header`, and the `body` with its footer.

    `shape` is one of `SHAPES`; `values` and `others` are as of `Case`.
    """

    shape: str
    above: Sequence[Row]
    header: Sequence[Row]
    body: Sequence[Row]
    values: Mapping[str, FloatArray]
    others: Sequence[str]

    @property
    def lines(self) -> list[Row]:
        """All rows of the file."""
        return [*self.above, *self.header, *self.body]


def drawn(seed: int, folder: Path) -> Case:
    """Draw a case; its file, if it has one, is written into `folder`."""
    draw = np.random.default_rng(seed)
    rows, count = int(draw.integers(6, 16)), int(draw.integers(1, 4))
    values = {f"v{place}": np.round(draw.normal(0.0, 20.0, rows), 3) + 0.001 for place in range(count)}
    shape, kind = str(draw.choice(SHAPES)), str(draw.choice(["text", "text", "text", "workbook", "python", "arrays"]))
    header, body, others = _shaped(draw, shape, rows, values)
    if kind == "arrays":
        return _arrays(draw, folder, rows, values)
    below = _footer(draw, shape, len(body[0]))
    body, others = [*body, *below], [*others, *(cells[0] for cells in below if cells)]
    if kind == "python" and shape in ("no header", "groups", "short header"):
        kind = "text"
    above = [] if draw.random() < 0.5 or shape == "no header" else PREAMBLES[int(draw.integers(len(PREAMBLES)))]
    content = Content(shape, above, header, body, values, others)
    if kind == "python":
        return _in_python(draw, content)
    return _workbook(draw, folder, content) if kind == "workbook" else _text(draw, folder, content)


def _shaped(
    draw: np.random.Generator, shape: str, rows: int, values: Mapping[str, FloatArray]
) -> tuple[list[Row], list[Row], list[str]]:
    """Return rows of the header and of the body, and names of columns beside the values."""
    columns = {name: [f"{value:.3f}" for value in column] for name, column in values.items()}
    names: Row = [*columns]
    others: list[str] = []
    if shape == "years":
        return [["name", *(str(1990 + row) for row in range(rows))]], [[name, *columns[name]] for name in names], others
    if shape == "months":
        first = columns[names[0]]
        cells = ["", *first, *[""] * (24 - 1 - len(first))]
        months = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
        return [["year", *months]], [["2001", *cells[:12]], ["2002", *cells[12:]]], others
    if shape == "long":
        long = [[name, str(row), columns[name][row]] for name in names for row in range(rows)]
        return [["variable", "time", "value"]], long, others
    heads: Row = {"quarters": ["year", "quarter"], "dates": ["date"]}.get(shape, ["t"])
    times = {
        "quarters": [[str(2000 + row // 4), str(1 + row % 4)] for row in range(rows)],
        "dates": [[f"2021-03-{row + 1:02}"] for row in range(rows)],
    }.get(shape, [[f"{0.5 * row:.1f}"] for row in range(rows)])
    heads = [*heads, *names]
    body = [[*times[row], *(columns[name][row] for name in names)] for row in range(rows)]
    if draw.random() < 0.4 and shape not in ("no header", "short header"):
        heads, body, others = (
            [*heads, "remark"],
            [[*cells, str(draw.choice(["ok", "bad"]))] for cells in body],
            ["remark"],
        )
    if draw.random() < 0.2 and shape not in ("no header", "short header"):
        heads, body = [*heads, "unused"], [[*cells, ""] for cells in body]
        others = [*others, "unused"]
    if shape == "no header":
        return [], body, others
    if shape == "short header":
        return [heads], [[*cells, "ok"] for cells in body], [f"column {len(heads) + 1}"]
    groups = [["", *[""] * (len(heads) - 2), "ball"]] if shape == "groups" and len(heads) > 2 else []
    return [*groups, heads], body, others


def _footer(draw: np.random.Generator, shape: str, width: int) -> list[Row]:
    """Return rows of a footer, none in most cases; where rows begin with names, a row of sums is one of data."""
    if draw.random() < 0.7:
        return []
    drawn_rows = FOOTERS[int(draw.integers(len(FOOTERS)))]
    if shape in ("years", "long") and len(drawn_rows[0]) > 3:
        return []
    return [cells[:width] for cells in drawn_rows]


def _text(draw: np.random.Generator, folder: Path, content: Content) -> Case:
    lines, others = content.lines, content.others
    separator = str(draw.choice([",", ";", "\t"]))
    has_commas = separator != "," and draw.random() < 0.4
    encoding = str(draw.choice(["utf-8", "utf-8-sig", "utf-16", "latin-1"]))
    end = str(draw.choice(["\n", "\r\n"]))
    comments = ["# made by a recorder"] if draw.random() < 0.2 else []
    written = [separator.join(cell.replace(".", ",") if has_commas and cell[-1:].isdigit() else cell for cell in cells)
               for cells in lines]  # fmt: skip
    is_damaged = draw.random() < 0.2
    if is_damaged:
        place = int(draw.integers(len(written)))
        change: Callable[[str], str] = [
            lambda line: line[: len(line) // 2], lambda line: "", lambda line: f"{line}{separator}7",
            lambda line: line + end + line, lambda line: '"' + line, lambda line: line.replace("1", "x", 1),
        ][int(draw.integers(6))]  # fmt: skip
        written[place] = change(written[place])
        others = [name for name in others if not lines[place] or name != lines[place][0]]
    path = folder / str(draw.choice(["a.csv", "a.txt", "a.dat", "a.tsv"]))
    path.write_bytes(end.join([*comments, *written, ""]).encode(encoding))
    how = f"text, {content.shape}, {separator!r}, {'decimal commas, ' if has_commas else ''}{encoding}"
    return Case(path, how, content.values, others, is_damaged)


def _workbook(draw: np.random.Generator, folder: Path, content: Content) -> Case:
    import openpyxl

    book = openpyxl.Workbook()
    titles = ["cover", "data", "notes"] if draw.random() < 0.5 else ["data"]
    for place, title in enumerate(titles):
        sheet = book.active if not place else book.create_sheet()
        sheet.title = title
        for cells in content.lines if title == "data" else [["Made", "by me"], ["k", "1.5"]]:
            sheet.append([_number(cell) for cell in cells])
    book.save(folder / "a.xlsx")
    how = f"workbook, {content.shape}, {len(titles)} sheets"
    return Case(folder / "a.xlsx", how, content.values, [*content.others, *titles[:-1][:1], *titles[2:]])


def _number(cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        return cell or None


def _in_python(draw: np.random.Generator, content: Content) -> Case:
    has_texts = draw.random() < 0.5
    names, body = content.header[-1], content.body
    width = len(names)
    cells = [[cell.replace(".", ",") if has_texts else _number(cell) for cell in row] for row in body]
    cells = [[*row, *[None] * (width - len(row))] for row in cells]
    named = {name: [row[place] for row in cells] for place, name in enumerate(names)}
    kind = str(draw.choice(["arrays by name", "frame", "frame of pandas", "records"]))
    data: object = named
    if kind == "frame" and len(body[-1]) == len(body[0]) and not body[-1][0].isalpha():
        data = polars.DataFrame(named, strict=False)
    elif kind.startswith("frame"):  # polars makes nothing of texts among numbers
        import pandas

        data = pandas.DataFrame(named)
    if kind == "records":
        data = [dict(zip(named, row, strict=True)) for row in cells]
    how = f"{kind}, {content.shape}{', decimal commas' if has_texts else ''}"
    return Case(data, how, content.values, content.others)


def _arrays(draw: np.random.Generator, folder: Path, rows: int, values: Mapping[str, FloatArray]) -> Case:
    named = {"t": 0.5 * np.arange(rows), **values}
    kind = str(draw.choice(["npz", "structured", "matrix", "mat"]))
    if kind == "matrix":
        np.save(folder / "a.npy", np.column_stack([*named.values()]))
        return Case(folder / "a.npy", kind, values)
    if kind == "structured":
        array = np.array([*zip(*named.values(), strict=True)], dtype=[(name, "f8") for name in named])
        np.save(folder / "a.npy", array)
        return Case(folder / "a.npy", kind, values)
    if kind == "mat":
        import scipy.io

        scipy.io.savemat(folder / "a.mat", {**named, "gain": 2.5})
        return Case(folder / "a.mat", kind, values, ["gain"])
    arrays: dict[str, Any] = {**named, "gain": np.array(2.5), "offsets": np.zeros(rows + 1)}  # keywords of numpy
    np.savez(folder / "a.npz", **arrays)
    return Case(folder / "a.npz", kind, values, ["gain", "offsets"])


# ---------------------------------------------------------------------------------------------------- what came of it


@dataclass(frozen=True)
class Outcome:
    """How a case ended: "read", "refused", "lost" or "broke", and a sentence."""

    seed: int
    how: str
    end: str
    sentence: str


def play(seed: int) -> Outcome:
    """Play one case; nothing that it raises gets out."""
    with tempfile.TemporaryDirectory() as folder:
        case = drawn(seed, Path(folder))
        how = case.how + (", damaged" if case.is_damaged else "")
        try:
            table = table_of(case.data, DataConfig())
        except (DataError, UsageError) as error:
            end = "refused" if "\n" not in str(error) else "broke"
            return Outcome(seed, how, end, str(error))
        except Exception:
            return Outcome(seed, how, "broke", traceback.format_exc(limit=-3))
        lost = _lost(case, table)
        return Outcome(seed, how, "lost" if lost else "read", f"{', '.join(lost)} not named in: {table.read_as}")


def _lost(case: Case, table: Table) -> list[str]:
    """Return names of what is neither in the table nor named."""
    said = f"{table.read_as}; {', '.join(table.skipped)}"
    left_out = "; ".join((*table.left_out, *table.skipped))
    others = [name for name in case.others if name not in table.names and name not in said]
    if case.is_damaged:  # without its header a column has another name
        is_headed = "no header" not in said
        return [name for name in others if is_headed and not name.startswith("column ") and name != "unused"]
    held = [column[np.isfinite(column)] for column in table.columns]
    values = [*case.values.items()][:1] if "months" in case.how else [*case.values.items()]
    lost = [
        name
        for name, column in values
        if not any(len(kept) == len(column) and np.allclose(kept, column, rtol=0, atol=1e-9) for kept in held)
    ]
    return [*others, *(name for name in lost if name not in left_out)]


@program(
    "benchmarks.operations.files",
    __doc__,
    option("--cases", type=whole, default=5000, help="how many (default: %(default)s)"),
    option("--seed", type=int, help="play one case and show it"),
)
def main(options: Namespace) -> int:
    """Play the cases; return 1 where anything was lost silently or broke."""
    seeds = range(options.cases) if options.seed is None else [options.seed]
    outcomes = [play(seed) for seed in seeds]
    bad = [outcome for outcome in outcomes if outcome.end in ("lost", "broke") or options.seed is not None]
    for outcome in bad:
        note(f"{outcome.seed}: {outcome.end}, {outcome.how}: {outcome.sentence}")
    counts = Counter(outcome.end for outcome in outcomes)
    whole_files = Counter(outcome.end for outcome in outcomes if "damaged" not in outcome.how)
    say(f"{len(outcomes)} files: {dict(counts)}; of those not damaged {dict(whole_files)}")
    return int(counts["lost"] + counts["broke"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
