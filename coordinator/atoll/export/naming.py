"""Names that a language takes, from names that people have given to columns. Pure."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

_LETTER: Final = re.compile(r"(?:GREEK|CYRILLIC) (SMALL|CAPITAL) LETTER (?:FINAL )?(\w+)")


@dataclass(frozen=True)
class Naming:
    """What a language takes as a name: ASCII letters, digits and _, a letter first, at most `longest` of them.

    `reserved` are words that mean something else, and no name begins with one of `prefixes`; where the language
    `is_caseless`, case tells no names apart.
    """

    reserved: frozenset[str]
    prefixes: tuple[str, ...] = ()
    longest: int = 60
    is_caseless: bool = False

    def assign(self, wanted: Mapping[str, str]) -> dict[str, str]:
        """Return what each key is called: what is wanted where it can be, else something like it; all are different.

        Of those that want the same, the first gets it.
        """
        names: dict[str, str] = {}
        taken: set[str] = set()
        for key in sorted(wanted, key=lambda wish: not self._is_good(wanted[wish])):
            name = wanted[key]
            names[key] = self._unique(name if self._is_good(name) else self._rewritten(name), taken)
            taken.add(self._key(names[key]))
        return {key: names[key] for key in wanted}

    def _key(self, name: str) -> str:
        return name.lower() if self.is_caseless else name

    def _is_good(self, name: str) -> bool:
        is_plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is not None and len(name) <= self.longest
        return is_plain and not self._is_reserved(name) and not name.startswith(self.prefixes)

    def _is_reserved(self, name: str) -> bool:
        return self._key(name) in {self._key(word) for word in self.reserved}

    def _rewritten(self, name: str) -> str:
        text = re.sub(r"_+", "_", spelled(name)).strip("_")
        if not text[:1].isalpha() or text.startswith(self.prefixes):
            text = "x" + text
        text = text[: self.longest]
        return text[: self.longest - 1] + "_" if self._is_reserved(text) else text

    def _unique(self, name: str, taken: set[str]) -> str:
        number, chosen = 2, name
        while self._key(chosen) in taken or self._is_reserved(chosen):
            ending = f"_{number}"
            chosen = name[: self.longest - len(ending)] + ending
            number += 1
        return chosen


def spelled(name: str) -> str:
    """Return `name` in ASCII letters, digits and _: without accents, letters of Greek and Cyrillic by their names."""
    return "".join(map(_spelled, unicodedata.normalize("NFKC", name)))


def _spelled(character: str) -> str:
    plain = unicodedata.normalize("NFKD", character)[0]
    if plain.isascii():
        return plain if plain.isalnum() else "_"
    if letter := _LETTER.match(unicodedata.name(plain, "")):
        return letter[2].lower() if letter[1] == "SMALL" else letter[2].capitalize()
    return "_"


def harmless(text: str) -> str:
    """Return `text` as it may stand in a comment of any language: one line, no backslash, no invisible character."""
    kept = (
        character if unicodedata.category(character)[0] not in "CZ" else " "
        for character in text.replace("\\", "/").replace("*/", "* /")
    )
    return " ".join("".join(kept).split())
