"""SRBench's comparison of a model with the truth by sympy, as a process of its own that no expression can hold up.

``python -m benchmarks.peers.simplification LIMIT`` reads one JSON object per line (``model``, ``truth``, ``symbols``)
and writes one per question (``difference`` and ``ratio``: whether it is constant, ``text``: what is left of the
difference). sympy may take forever, or die, on a large expression: a question that is not answered within LIMIT seconds
ends the process, by a timer that no code of sympy's can hold off. `benchmarks.peers.srbench` starts it and asks.

The rule is that of W. La Cava et al., *Contemporary Symbolic Regression Methods and their Relative Performance* (2021),
as the program does it (github.com/cavalab/srbench, ``experiment/assess_symbolic_model.py`` and ``symbolic_utils.py``):
decimal numbers are rounded to three places and kept in three digits, those below 1e-4 become 0; the rounded model is
simplified; difference and quotient are rounded again, and the difference simplified unless it is seen to be constant.
"""

import json
import signal
import sys
from collections.abc import Sequence
from typing import Any, Final

import sympy
from sympy.core.random import seed
from sympy.parsing.sympy_parser import parse_expr

PLACES: Final = 3
NOTHING: Final = 1e-4
"""Decimal numbers below this are taken for 0."""

_TEXT_LIMIT: Final = 200
_FUNCTIONS: Final = {"inverse": lambda a: 1 / a, "square": lambda a: a**2, "pow": sympy.Pow, "abs": sympy.Abs}


def rounded(expression: sympy.Expr) -> sympy.Expr:
    """Return `expression` with its decimal numbers rounded, those in exponents and functions as well."""
    result = expression
    for part in sympy.preorder_traversal(expression):
        if isinstance(part, sympy.Float):
            near = sympy.Integer(0) if abs(part) < NOTHING else sympy.Float(round(part, PLACES), PLACES)
            result = result.subs(part, near)
    return result


def parsed(text: str, symbols: Sequence[str]) -> sympy.Expr:
    """Return the rounded expression that `text` means; names not among `symbols` are functions."""
    return rounded(parse_expr(text, local_dict={**_FUNCTIONS, **{name: sympy.Symbol(name) for name in symbols}}))


def compared(model: str, truth: str, symbols: Sequence[str]) -> dict[str, Any]:
    """Return what is left between `model` and `truth` once both are rounded and simplified.

    ``difference`` and ``ratio`` say whether model minus truth and model over truth are constant. A model that is a
    constant or undefined solves nothing.
    """
    sought = parsed(truth, symbols)
    answer = sympy.simplify(parsed(model, symbols), ratio=1)
    if answer.is_number:
        return {"difference": False, "ratio": False, "text": f"the model is the constant {answer}"}
    difference, ratio = rounded(sought - answer), rounded(answer / sought)
    if not difference.is_constant() or ratio.is_constant():
        difference = rounded(sympy.simplify(difference, ratio=1))
    text = str(difference)
    return {
        "difference": difference.is_constant() is True,
        "ratio": ratio.is_constant() is True,
        "text": text if len(text) <= _TEXT_LIMIT else f"{text[:_TEXT_LIMIT]} …",
    }


def answered(line: str) -> dict[str, Any]:
    """Return the answer to one question, a line of JSON; what sympy cannot do counts as different."""
    question = json.loads(line)
    seed(0)  # sympy tries numbers at random where it sees no other way
    try:
        return compared(question["model"], question["truth"], question["symbols"])
    except Exception as error:  # sympy raises whatever it likes
        return {"difference": False, "ratio": False, "text": f"sympy failed: {type(error).__name__}: {error}"}


def main() -> None:
    """Answer the questions on stdin until it ends."""
    limit = float(sys.argv[1])
    for line in sys.stdin:
        signal.setitimer(signal.ITIMER_REAL, limit)
        answer = answered(line)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
