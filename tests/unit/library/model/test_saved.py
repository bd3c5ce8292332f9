"""Saved results that others have written: every text of them can be shown, written and searched for."""

import json
from pathlib import Path

import pytest
from tests.unit.common.model.results import result

from atoll.model.saved import check_result, read_result


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        ("a\x01b", r"a\x01b"),
        ("\x1b[2J", r"\x1b[2J"),
        ("\x9b2J", r"\x9b2J"),
        ("\ud800", r"\ud800"),
        ("\uffff", r"\uffff"),
        ("größe θ 𝛼\tin\nlines", "größe θ 𝛼\tin\nlines"),
    ],
)
def test_characters_that_cannot_be_written_are_escaped_in_texts_and_names(given: str, taken: str) -> None:
    found = result({"x": "-x"}, reason=given, symbols={"x": "x", given: "u"}, chaos={"said": [[given]]})
    found["equations"][0]["lhs"] = given
    checked = check_result(found)
    assert (checked["reason"], checked["equations"][0]["lhs"]) == (taken, taken)
    assert (checked["symbols"], checked["chaos"]) == ({"x": "x", taken: "u"}, {"said": [[taken]]})


def test_a_file_that_holds_such_characters_is_read(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result({"x": "-x"}, reason="a\ud800b")), "utf-8")
    assert read_result(path)["reason"] == r"a\ud800b"
