"""Notes are sentences that the coordinator writes; all others beside a result are warnings."""

from pathlib import Path

import pytest

import atoll_coordinator
from atoll_coordinator.result.notes import PHRASES, is_note

SOURCES = Path(atoll_coordinator.__file__).parent


@pytest.mark.parametrize("phrase", PHRASES)
def test_each_phrase_is_one_that_is_written(phrase: str) -> None:
    texts = [path.read_text("utf-8") for path in SOURCES.rglob("*.py") if path.name != "notes.py"]
    assert sum(phrase in text for text in texts) == 1


def test_what_asks_for_something_is_a_warning() -> None:
    assert not is_note("Some measurements of x look like outliers; --robust takes their weight away.")
    assert is_note("The search sees 8 of 80 rows, spread evenly; models are judged by all.")
