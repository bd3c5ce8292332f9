"""Which sentences beside a result are notes: they report what was done by rule, and ask nothing of the reader."""

from typing import Final

PHRASES: Final = (
    " were tried as well, since ",
    " were tried; with ",
    "rows, spread evenly; models are judged by all",
    "Data without noise are interpolated, not smoothed",
    "States change little from row to row: means of ",
)
"""A phrase of each sentence that is a note, as the module has it that writes the sentence."""


def is_note(sentence: str) -> bool:
    """Tell whether a sentence among the warnings of a result is a note."""
    return any(phrase in sentence for phrase in PHRASES)


def with_kind(sentence: str) -> str:
    """Return a sentence among the warnings of a result with what it is before it, as terminals show it."""
    return f"{'note' if is_note(sentence) else 'warning'}: {sentence}"
