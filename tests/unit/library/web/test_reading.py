"""Files that are sent to do harm: each ends as a sentence, in a process of its own, and the next file is read."""

import asyncio
import io
import os
import pickle
import signal
import tempfile
import zipfile
from collections.abc import Callable
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atoll.web import operations
from atoll.web.access import LOCAL_HOSTS, Access, digest_of
from atoll.web.api import MAX_COMING
from atoll.web.reading import Readers
from atoll.web.reading_task import LATE, ReadingLimits
from atoll.web.server import build_application
from tests.http import LOCAL, Answer, ask, ask_async
from tests.unit.library.web.made import AUTHORIZED, READERS, Asked, AtHand, access

CSV = b"t,x\n" + b"".join(b"%d,%f\n" % (row, 0.9**row) for row in range(30))
LITTLE = ReadingLimits(memory=32 * 10**6)
SHORT = ReadingLimits(processor_s=1)
BOMB = 48 * 10**6


def zipped(**members: tuple[bytes, int]) -> bytes:
    """Return an archive of members by name, each a beginning and how many zeros or blanks follow."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, (beginning, more) in members.items():
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(beginning)
                for _ in range(more // 10**6):
                    member.write(bytes(10**6))
    return made.getvalue()


def header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    made = io.BytesIO()
    np.lib.format.write_array_header_2_0(made, {"descr": kind, "fortran_order": False, "shape": shape})
    return made.getvalue()


def bomb_npz(size: int = BOMB) -> bytes:
    return zipped(**{"t.npy": (header((size // 8,)), size)})


def claim_npz() -> bytes:
    return zipped(**{"t.npy": (header((10**12,)), 0)})


def pickle_npz() -> bytes:
    return zipped(**{"t.npy": (header((1,), "|O") + pickle.dumps(Evil()), 0)})


class Evil:
    """Makes a file where somebody unpickles it."""

    place = "/nowhere"

    def __reduce__(self) -> tuple[Callable[[str], object], tuple[str]]:
        return Path.touch, (Path(self.place),)  # type: ignore[return-value]


def book(sheet: str, text: str = "") -> bytes:
    """Return a workbook with this XML as rows of its sheet, and a text."""
    import openpyxl

    written, made = io.BytesIO(), io.BytesIO()
    openpyxl.Workbook().save(written)
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    with zipfile.ZipFile(written) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new:
        for name in old.namelist():
            content = old.read(name).decode()
            if name == "xl/worksheets/sheet1.xml":
                content = f"<worksheet {main}><sheetData>{sheet}</sheetData></worksheet>"
            new.writestr(name, content)
        if text:
            new.writestr("xl/sharedStrings.xml", f"<sst {main}><si><t>{text}</t></si></sst>")
    return made.getvalue()


def long_book(rows: int = 250_000) -> bytes:
    return book("<row><c><v>1</v></c><c><v>2</v></c></row>" * rows)


def wide_text_book(size: int = BOMB) -> bytes:
    return book(f'<row><c t="inlineStr"><is><t>{"a" * size}</t></is></c></row>')


def one_line(size: int = BOMB) -> bytes:
    return b"t,x\n1," + b"2" * size


def columns(number: int = 200_000) -> bytes:
    return b",".join(b"c%d" % place for place in range(number)) + b"\n" + (b"1," * number)[:-1] + b"\n"


def parquet() -> bytes:
    import polars

    made = io.BytesIO()
    polars.DataFrame({"t": range(1000), "x": [row * row for row in range(1000)]}).write_parquet(made)
    return made.getvalue()


def broken_parquet() -> bytes:
    whole = parquet()
    half = len(whole) // 2
    return whole[:half] + bytes(len(whole) - half - 8) + whole[-8:]


def matlab() -> bytes:
    import scipy.io

    made = io.BytesIO()
    scipy.io.savemat(made, {"t": np.arange(30.0), "x": 0.9 ** np.arange(30.0)})
    return made.getvalue()


@pytest.fixture
def readers(monkeypatch: pytest.MonkeyPatch) -> Readers:
    monkeypatch.setattr(READERS, "limits", ReadingLimits())
    return READERS


def sent(readers: Readers, name: str, body: bytes, what: str = "outline") -> Answer:
    app = build_application(access(AtHand(Asked())), readers)
    return ask(app, "POST", f"/api/v1/{what}", body, {"filename": name}, authorization=AUTHORIZED)


@pytest.mark.parametrize(
    ("name", "made", "limits", "status", "said"),
    [
        ("a.npz", bomb_npz, LITTLE, 413, "a.npz takes more than 32 MB"),
        ("a.npz", claim_npz, ReadingLimits(), 413, "a.npz takes more than"),
        ("a.npz", pickle_npz, ReadingLimits(), 422, "is not an NPZ file of plain arrays"),
        ("a.xlsx", wide_text_book, LITTLE, 413, "a.xlsx takes more than 32 MB"),
        ("a.xlsx", long_book, SHORT, 422, "a.xlsx takes more than 1 processor seconds"),
        ("a.csv", one_line, LITTLE, 413, "a.csv takes more than 32 MB"),
        ("a.csv", columns, SHORT, 422, "a.csv takes more than 1 processor seconds"),
        ("a.csv", lambda: CSV, ReadingLimits(total_s=0.0), 422, "or 0 s in total"),
        ("a.parquet", parquet, ReadingLimits(), 200, ""),
        ("a.mat", matlab, ReadingLimits(), 200, ""),
        ("a.parquet", broken_parquet, ReadingLimits(), 422, "cannot be read as a Parquet file"),
        ("a.json", lambda: b"[" * 10**6, ReadingLimits(), 422, "is not valid JSON"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_a_file_that_does_harm_is_refused_in_a_sentence_and_the_next_is_read(
    readers, name, made, limits, status, said
) -> None:
    readers.limits = limits
    answer = sent(readers, name, made())
    assert (answer.status, said in answer.json.get("detail", "")) == (status, True), answer.body[:300]
    readers.limits = ReadingLimits()
    assert sent(readers, "a.csv", CSV).status == 200


def test_a_refused_table_has_its_columns_in_the_answer_whatever_stands_above_them(readers) -> None:
    """A page lets one of them be chosen: of Windows' letters, behind a preamble, of text, too."""
    lines = ["Messung von Müller", "", "Standort;Füchse;Hasen"] + [
        f"{site};{k},5;{k * k}" for site in "ab" for k in range(8)
    ]
    answer = sent(readers, "a.csv", "\n".join(lines).encode("cp1252"))
    assert (answer.status, "no time column" in answer.json["detail"]) == (422, True), answer.json
    columns = {column["name"]: column for column in answer.json["columns"]}
    assert set(columns) == {"Standort", "Füchse", "Hasen"}
    assert (columns["Füchse"]["role"], columns["Füchse"]["first"][:2]) == (None, ["0.5", "1.5"])
    assert "columns" not in sent(readers, "a.csv", b"\x00").json, "nothing was read"


def test_what_is_pickled_in_a_file_is_not_run(readers, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(Evil, "place", str(tmp_path / "was here"))
    sent(readers, "a.npz", pickle_npz())
    assert [*tmp_path.iterdir()] == []
    pickle.loads(pickle.dumps(Evil()))
    assert [*tmp_path.iterdir()] != [], "it would have shown"


@pytest.mark.parametrize(
    ("code", "status", "said"),
    [
        (-signal.SIGKILL, 413, "more than"),
        (-signal.SIGABRT, 413, "more than"),
        (-signal.SIGXCPU, 422, "processor seconds"),
        (LATE, 422, "processor seconds"),
        (-signal.SIGSEGV, 422, "crashed; save the file again"),
        (1, 422, "crashed; save the file again"),
    ],
)
def test_however_a_reader_ends_a_sentence_says_it(code, status, said) -> None:
    assert (ReadingLimits().of_code(code, "a.csv")[0], said in ReadingLimits().of_code(code, "a.csv")[1]) == (
        status,
        True,
    )


def test_a_process_that_has_died_is_started_anew(readers) -> None:
    assert sent(readers, "a.csv", CSV).status == 200
    pid = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    answers = [sent(readers, "a.csv", CSV).status for _ in range(2)]
    assert answers[-1] == 200


def test_nothing_is_left_of_what_was_sent(readers, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for body in (CSV, b"\x00", pickle_npz()):
        sent(readers, "a.csv", body)
    assert [*tmp_path.iterdir()] == []


def test_a_cancelled_request_ends_its_reader_before_it_has_read(readers, tmp_path) -> None:
    """The fork is killed even before it has a process group; otherwise the loop waits until the file is read."""
    file = tmp_path / "files" / "a.csv"
    file.parent.mkdir()
    file.write_bytes(CSV)

    async def go() -> None:
        readers.start()
        task = asyncio.create_task(readers.read([file], "{}", "text/csv", "outline"))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(go())
    assert not (tmp_path / "answer").exists()


def test_one_user_sends_few_files_at_a_time_and_others_go_on(readers) -> None:
    """Bodies that never end keep their places; whoever else sends a file has others."""

    async def go() -> None:
        gateways = {digest_of(name * 16): AtHand(Asked()) for name in "ab"}
        app = build_application(Access(gateways, None, LOCAL_HOSTS), readers)  # type: ignore[arg-type]

        def send(name: str, body: list[bytes]) -> Any:
            headers = LOCAL | {"authorization": f"Bearer {name * 16}"}
            return ask_async(app, "POST", "/api/v1/outline", body, {"filename": "a.csv"}, headers)

        waiting = [asyncio.create_task(send("a", [])) for _ in range(MAX_COMING)]
        await asyncio.sleep(0)
        late, other = await send("a", [CSV]), await send("b", [CSV])
        assert (late.status, late.headers["retry-after"], other.status) == (429, "1", 200)
        for task in waiting:
            task.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)
        assert (await send("a", [CSV])).status == 200

    asyncio.run(go())


def test_a_body_that_comes_too_slowly_is_cut_off(readers, monkeypatch) -> None:
    monkeypatch.setattr(operations, "PATIENCE_S", 0.0)
    app = build_application(access(AtHand(Asked())), readers)

    async def go() -> Answer:
        headers = LOCAL | {"authorization": AUTHORIZED}
        return await ask_async(app, "POST", "/api/v1/outline", [], {"filename": "a.csv"}, headers)

    answer = asyncio.run(go())
    assert (answer.status, "too slowly" in answer.json["detail"], answer.headers["connection"]) == (408, True, "close")
