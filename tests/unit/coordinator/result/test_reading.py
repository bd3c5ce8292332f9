"""Saved results that others have written: every text of them can be shown, written and searched for."""

import json
from pathlib import Path

import pytest

from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from tests.unit.library.model.results import result


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
    contents = result({"x": "-x"}, reason=given, symbols={"x": "x", given: "u"}, said=[[given]])
    contents["equations"][0]["lhs"] = given
    read = Result.load(contents)
    assert (read.reason, read.equations[0].lhs) == (taken, taken)
    assert read.symbols == {"x": "x", taken: "u"}
    assert read.as_dict()["said"] == [[taken]]


def test_a_file_that_holds_such_characters_is_read(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result({"x": "-x"}, reason="a\ud800b")), "utf-8")
    assert Result.load(path).reason == r"a\ud800b"


FAULTS = {
    "job": (3, "this result has 3 as 'job', where text is expected; give the unchanged file"),
    "seed": ("x", "this result has 'x' as 'seed', where a whole number is expected; give the unchanged file"),
    "seconds": (True, "this result has True as 'seconds', where a number is expected; give the unchanged file"),
    "warnings": ([None], "this result has None as 'warnings', where text is expected; give the unchanged file"),
    "symbols": ([], "this is no result of this version; give the content of a saved result.json"),
    "covariance": ({"matrix": []}, "this result lacks 'constants'; give the unchanged result.json"),
    "process": (
        {"step": 0},
        "this result has 0 as 'step', where a number above 0 is expected; give the unchanged file",
    ),
    "groups": (None, "this result has None as 'groups', where a list is expected; give the unchanged file"),
    "simulation": ([1], "this result has [1] as 'simulation', where an object is expected; give the unchanged file"),
}


@pytest.mark.parametrize("key", FAULTS)
def test_what_is_of_another_kind_is_said_in_a_sentence(key: str) -> None:
    value, sentence = FAULTS[key]
    with pytest.raises(UsageError) as caught:
        Result.load(result({"x": "-x"}, **{key: value}))
    assert str(caught.value) == sentence


def test_a_covariance_is_square_and_curves_are_as_long_as_their_times() -> None:
    places = [{"variable": "x", "constant": 0}]
    for matrix in ([], [[1.0, 2.0]], [[1.0], [2.0]]):
        with pytest.raises(UsageError, match=r"^the covariance in this result does not match"):
            Result.load(result({"x": "-2*x"}, covariance={"constants": places, "matrix": matrix}))
    part = {"name": "1", "times": [0.0, 1.0], "values": {"x": [1.0]}}
    with pytest.raises(UsageError, match=r"^this result has a curve that is not as long as its 'times'"):
        Result.load(result({"x": "-x"}, simulation={"trajectories": [part]}))


@pytest.mark.parametrize("content", [None, [], {}, {"schema": 2}, {"schema": 1, "equations": [{}], "symbols": {}}])
def test_what_is_no_result_is_named_as_such(content: object) -> None:
    with pytest.raises(UsageError, match=r"^this is no result of this version"):
        Result.of(content)  # type: ignore[arg-type]


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    with pytest.raises(UsageError, match="cannot be read"):
        Result.load(path)
    path.write_text("{", "utf-8")
    with pytest.raises(UsageError, match="is not valid JSON"):
        Result.load(tmp_path)
    path.write_text("{}", "utf-8")
    with pytest.raises(UsageError, match=r"result\.json: this is no result of this version"):
        Result.load(tmp_path)
