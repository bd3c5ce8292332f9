"""Sentences for the user about a job: warnings, and notes, which report what was done by rule and ask for nothing."""

from collections.abc import Iterable


class Note(str):
    """A sentence that is a note; any other among warnings is a warning.

    It is one where it is written. What travels or is stored are texts, with those that are notes beside them.
    """

    __slots__ = ()


def notes_of(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return the texts of the notes among sentences, each once."""
    return tuple(dict.fromkeys(str(sentence) for sentence in sentences if isinstance(sentence, Note)))
