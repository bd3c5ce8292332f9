"""``coordinator report``: a page beside the result or where it is wanted, and a sentence for what is no result."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from atoll.cli.main import main
from tests.unit.library.report.results import regression


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text(json.dumps(regression()), "utf-8")
    return tmp_path


def test_the_page_stands_beside_the_result_or_where_it_is_wanted(
    saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(saved)]) == 0
    assert capsys.readouterr() == ("", f"report in {saved / 'report.html'}\n")
    assert main(["report", str(saved / "result.json"), "-o", str(saved / "page.html")]) == 0
    assert (saved / "page.html").read_text("utf-8") == (saved / "report.html").read_text("utf-8")


def test_several_results_have_a_page_each_and_one_that_is_none_keeps_no_other_from_it(
    saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (saved / "result.json").read_text("utf-8")
    for name, contents in (("a", text), ("b", "no JSON"), ("c", text)):
        (saved / name).mkdir()
        (saved / name / "result.json").write_text(contents, "utf-8")
    runs = [str(saved / name) for name in "abc"]
    assert main(["report", *runs]) == 2
    printed = capsys.readouterr().err.splitlines()
    assert printed[0] == f"report in {saved / 'a' / 'report.html'}"
    assert printed[1].startswith(f"coordinator: {saved / 'b'}")
    assert (saved / "c" / "report.html").exists()
    assert main(["report", "nothing", runs[2]]) == 2
    printed = capsys.readouterr().err.splitlines()
    assert printed[0].startswith("coordinator: nothing is no saved result")
    assert printed[1] == f"report in {saved / 'c' / 'report.html'}"
    assert main(["report", runs[0], runs[2]]) == 0
    assert main(["report", runs[0], runs[2], "-o", "page.html"]) == 2
    assert "--output names one place, but 2 results were given" in capsys.readouterr().err
    assert main(["report", runs[0], f"{runs[0]}/result.json"]) == 2
    assert "two of these results would be written to" in capsys.readouterr().err


def test_a_result_whose_texts_no_page_can_hold_has_one(saved: Path) -> None:
    contents = regression()
    contents["equations"][0]["lhs"] = "dy\x01/dt"
    (saved / "result.json").write_text(json.dumps(contents), "utf-8")
    assert main(["report", str(saved)]) == 0
    assert r"dy\x01/dt" in (saved / "report.html").read_text("utf-8")


def test_pictures_are_files_that_need_no_page(saved: Path) -> None:
    assert main(["report", str(saved), "--pictures", str(saved / "pictures")]) == 0
    assert sorted(path.name for path in (saved / "pictures").iterdir()) == ["fit-1.svg", "fit-2.svg", "front-1.svg"]
    root = ElementTree.parse(saved / "pictures" / "fit-1.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert ".line" in (root[0].text or "")


def test_a_group_that_is_none_is_refused(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(saved), "--group", "a"]) == 2
    assert "there is no group 'a'" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"schema": 1}', '{"schema": 2, "equations": []}'])
def test_what_is_no_result_ends_with_a_sentence(saved: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (saved / "result.json").write_text(text, "utf-8")
    assert main(["report", str(saved)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"coordinator: {saved / 'result.json'}")
    assert printed.err.count("\n") == 1
    assert not (saved / "report.html").exists()


def test_a_page_that_cannot_be_written_is_refused(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(saved), "-o", str(saved / "none" / "page.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err
