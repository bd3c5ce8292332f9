"""A sentence is a note where it is written, and stays one in what travels and in a result."""

import json
from dataclasses import replace

import numpy as np

from atoll.text.render import render_text
from atoll.web.pictures import progress
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import Dataset
from atoll_core.data.notes import Note, notes_of
from atoll_core.wire.values import decode_value, encode_value
from tests.unit.library.model.results import result

NOTE, WARNING = Note("The search sees 8 of 80 rows."), "Some measurements of x look like outliers."


def test_notes_are_told_by_what_they_are_and_not_by_their_words() -> None:
    assert notes_of([WARNING, NOTE, str(NOTE), NOTE]) == (str(NOTE),)
    assert [type(note) for note in notes_of([NOTE])] == [str]


def test_datasets_know_their_notes_after_they_have_travelled() -> None:
    dataset = Dataset(("x",), np.zeros((1, 3)), (), {"x": "x"}, (WARNING, NOTE))
    more = replace(dataset, warnings=(*dataset.warnings, "Another one."))
    for value in (dataset, more):
        made = decode_value(encode_value(value), type(value))
        assert made.warnings == value.warnings
        assert made.notes == value.notes == (str(NOTE),)


def test_a_result_lists_its_notes_among_its_warnings() -> None:
    contents = {**result({"x": "-x"}), "warnings": [WARNING, str(NOTE)], "notes": [str(NOTE)]}
    made = Result.of(contents)
    assert (made.warnings, made.proper_warnings) == ((WARNING, str(NOTE)), (WARNING,))
    assert json.loads(made.to_json())["notes"] == [str(NOTE)]
    text = render_text(made)
    assert f"warning: {WARNING}" in text
    assert f"note: {NOTE}" in text
    shown = progress(made)
    assert (shown["warnings"], shown["notes"]) == ([WARNING], [str(NOTE)])


def test_a_result_of_an_earlier_version_has_warnings_only() -> None:
    made = Result.of({**result({"x": "-x"}), "warnings": [WARNING]})
    assert (made.proper_warnings, made.notes) == ((WARNING,), ())
