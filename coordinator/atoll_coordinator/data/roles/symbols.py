"""From column names to the symbols of expressions.

A symbol must survive the way into an expression's text and back through sympy's parser, whose ``local_dict`` is made
from these symbols: so S, I, N, E and beta are fine, Python's keywords and the names of our functions are not.
"""

import keyword
import re
import unicodedata
from collections.abc import Sequence
from itertools import chain, count
from typing import Final

RESERVED: Final = frozenset(
    {"sin", "cos", "tan", "cot", "sec", "csc", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "ln"}
    | {"sqrt", "abs", "Abs", "pow", "Pow", "inverse", "square", "neg", "sign"}
    | {"Symbol", "Function", "Integer", "Float", "Rational", "Number"}
)
"""Functions of expressions, and the names that sympy's parser itself writes into what it evaluates."""


def assign_symbols(columns: Sequence[str]) -> dict[str, str]:
    """Return the symbol of each column: the name itself where it can be, else a rewritten one; all are unique. Pure."""
    symbols = {column: column for column in columns if _is_symbol(column)}
    taken = set(symbols.values())
    for column in columns:
        if column not in symbols:
            symbols[column] = _unique(_rewritten(column), taken)
            taken.add(symbols[column])
    return {column: symbols[column] for column in columns}


def _is_symbol(name: str) -> bool:
    """Say whether `name` reads as one identifier: to Python, which normalises to NFKC, and to sympy's tokenizer."""
    is_plain = unicodedata.normalize("NFKC", name) == name and re.fullmatch(r"\w+", name) is not None
    return is_plain and name.isidentifier() and not keyword.iskeyword(name) and name not in RESERVED


def _rewritten(name: str) -> str:
    """Return an identifier that resembles `name`: ``x-y`` gives x_y, ``2nd`` gives x2nd, ``lambda`` gives lambda_."""
    text = re.sub(r"\W+", "_", unicodedata.normalize("NFKC", name)).strip("_") or "x"
    if not text.isidentifier():
        text = "x" + text
    if not text.isidentifier():
        text = re.sub(r"[^A-Za-z0-9_]+", "_", text)
    return text if _is_symbol(text) else text + "_"


def _unique(name: str, taken: set[str]) -> str:
    candidates = chain([name], (f"{name}_{number}" for number in count(2)))
    return next(symbol for symbol in candidates if symbol not in taken)
