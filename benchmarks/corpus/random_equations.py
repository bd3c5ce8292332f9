"""Right-hand sides as sums of random terms, as nature might have them: two to four terms, one of them a loss."""

import re
from collections.abc import Iterator
from typing import Final

import numpy as np

from benchmarks.corpus.families import Box, Family

STATES: Final = ("x", "y", "z", "u", "v")

_LOSSES: Final = ("-{k}*{s}", "-{k}*{s}", "-{k}*{s}**2", "-{k}*{s}**3", "-{k}*{s}/({k} + {s})")
_OWN: Final = (
    "{k}", "{k}*{s}", "{k}*{s}**2", "{k}*sin({k}*{s})", "{k}*cos({s})", "{k}*exp(-{k}*{s})", "{k}*{s}/({k} + {s}**2)",
    "{k}*sqrt({s})", "{k}*log({s})", "{k}*{s}**{p}",
)  # fmt: skip
_FOREIGN: Final = (
    "{k}*{o}", "-{k}*{o}", "{k}*{s}*{o}", "-{k}*{s}*{o}", "{k}*{o}**2", "{k}*sin({o})", "-{k}*cos({o})",
    "{k}*{o}/({k} + {o})", "-{k}*{s}*{o}/({k} + {s})", "{k}/(1.0 + {o}**2)", "{k}*{s}*exp(-{o})", "{k}*sin({o} - {s})",
)  # fmt: skip
_POSITIVE: Final = ("sqrt", "log", "**{p}", "/({k} + {s})", "/({k} + {o})")
"""Parts of terms that ask for states above zero."""


def random_family(rng: np.random.Generator, states: int) -> Family:
    """Return a family of `states` equations; whether it has plausible solutions is for the caller to see."""
    names = STATES[:states]
    numbers = iter(range(1, 100))
    terms = {name: _terms(rng, name, names) for name in names}
    needs_positive = any(part in term for those in terms.values() for term in those for part in _POSITIVE)
    equations = {name: _sum([_numbered(term, numbers) for term in those]) for name, those in terms.items()}
    exponents = {name for text in equations.values() for name in re.findall(r"\*\*(k\d+)", text)}
    constants = {f"k{number}": (0.2, 3.0) for number in range(1, next(numbers))}
    constants |= dict.fromkeys(exponents, (0.4, 0.9))
    box: Box = (0.3, 3.0, None) if needs_positive else (-2.0, 2.0, None)
    return Family(equations, constants, (box,) * states)


def _terms(rng: np.random.Generator, name: str, names: tuple[str, ...]) -> list[str]:
    """Return two to four terms, one of them a loss and, with other states, at least one with another state."""
    others = [other for other in names if other != name]
    terms = [_filled(rng, _LOSSES, name, others)]
    terms.append(_filled(rng, _FOREIGN if others else _OWN, name, others))
    for _ in range(int(rng.choice(3, p=(0.5, 0.35, 0.15)))):
        pool = _FOREIGN if others and rng.random() < 0.5 else _OWN
        terms.append(_filled(rng, pool, name, others))
    return list(dict.fromkeys(terms))


def _filled(rng: np.random.Generator, pool: tuple[str, ...], name: str, others: list[str]) -> str:
    term = pool[int(rng.integers(len(pool)))]
    other = others[int(rng.integers(len(others)))] if others else name
    return term.replace("{s}", name).replace("{o}", other)


def _numbered(term: str, numbers: Iterator[int]) -> str:
    """Name the constants of a term, `{k}`, and its exponent, `{p}`."""
    return re.sub(r"\{[kp]\}", lambda _: f"k{next(numbers)}", term)


def _sum(terms: list[str]) -> str:
    text = terms[0]
    for term in terms[1:]:
        text += f" - {term[1:]}" if term.startswith("-") else f" + {term}"
    return text
