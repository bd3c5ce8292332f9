"""Sentences for the user about a job: warnings, and notes, which only report steps taken by rule."""

from collections.abc import Container, Iterable


class Note(str):
    """A sentence that is a note, in a list in which all other sentences are warnings.

    Messages and the store hold plain texts and a list of the texts that are notes.
    """

    __slots__ = ()


def notes_of(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return the texts of the notes in a list of sentences, each once."""
    return tuple(dict.fromkeys(str(sentence) for sentence in sentences if isinstance(sentence, Note)))


def with_kind(sentence: str, notes: Container[str]) -> str:
    """Return a sentence after ``note:`` or ``warning:``, as terminals show it."""
    return f"{'note' if sentence in notes else 'warning'}: {sentence}"
