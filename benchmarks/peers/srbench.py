"""Is an equation solved? SRBench's own rule, and a strict one beside it.

SRBench calls a model solved when, its numbers rounded to three places and sympy having simplified, model minus truth or
model over truth is a constant, and R² on the test rows exceeds 0.5 (`benchmarks.peers.simplification` has the source).
That is lenient where a constant is off (4e-4 too much is rounded away, however small the constant; any constant may
be added to a model) and harsh where a float survives that sympy will not cancel (``sin(1.0*x - y)`` is not
``sin(x - y)`` to it). The strict rule is that of `benchmarks.judging.forms`: the truth's terms and no others, and
every constant within `STRICT` of the truth's.
"""

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.judging.errors import values_on
from benchmarks.judging.forms import compare
from benchmarks.judging.rules import NO_EQUATION, Form

STRICT: Final = 1e-3
"""Largest relative difference of a constant by the strict rule."""

LEAST_R_SQUARED: Final = 0.5
LIMIT_S: Final = 30.0
"""What sympy gets for one comparison; a model on which it needs longer is not solved."""

_STOP_LIMIT_S: Final = 5.0


class Comparer:
    """A process of `benchmarks.peers.simplification`, started when it is first asked, and again after it has ended."""

    def __init__(self, limit: float = LIMIT_S) -> None:
        """Allow `limit` seconds for a comparison."""
        self._limit = limit
        self._process: subprocess.Popen[str] | None = None

    def ask(self, model: str, truth: str, symbols: Sequence[str]) -> dict[str, Any] | None:
        """Return what `benchmarks.peers.simplification.compared` says, or None when there was no answer in time."""
        if self._process is None:
            self._process = self._started()
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(json.dumps({"model": model, "truth": truth, "symbols": list(symbols)}) + "\n")
        stdin.flush()
        line = stdout.readline()
        if not line:
            self.close()
            return None
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the process."""
        if self._process is None:
            return
        process, self._process = self._process, None
        process.kill()
        process.communicate(timeout=_STOP_LIMIT_S)

    def _started(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "benchmarks.peers.simplification", str(self._limit)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONHASHSEED": "0"},  # the order in which sympy tries things
            start_new_session=True,  # a Ctrl-C on the terminal is this program's alone to handle
        )


@cache
def comparer() -> Comparer:
    """Return the one that this process shares, which ends with it."""
    shared = Comparer()
    atexit.register(shared.close)
    return shared


def assess(
    expression: str | None,
    truth: str,
    columns: Mapping[str, FloatArray],
    labels: FloatArray,
    by: Comparer | None = None,
) -> Form:
    """Judge `expression` by SRBench's rule: right or other, and why or by which of its two ways.

    `expression`, the model, and `truth` are infix text over the names of `columns`, the test rows (R,); `labels` (R,)
    are the true values on them without noise. `by` asks sympy, by default the one that this process shares. Raises
    UsageError where `expression` is none over these names.
    """
    if expression is None:
        return NO_EQUATION
    r_squared = coefficient_of_determination(expression, columns, labels)
    if not r_squared > LEAST_R_SQUARED:
        return Form("other", reason=f"R² is {r_squared:.3g}", r_squared=r_squared)
    answer = (by or comparer()).ask(expression, truth, tuple(columns))
    if answer is None:
        return Form("other", reason="sympy did not answer in time", r_squared=r_squared)
    ways = [way for way in ("difference", "ratio") if answer[way]]
    reason = f"a constant {' and '.join(ways)}" if ways else f"left of truth minus model: {answer['text']}"
    return Form("right" if ways else "other", reason=reason, r_squared=r_squared)


def compare_strictly(expression: str | None, truth: str, columns: Mapping[str, FloatArray]) -> Form:
    """Judge whether `expression` has the truth's terms and all its constants; arguments and errors as for `assess`."""
    return compare(expression, truth, columns, STRICT)


def coefficient_of_determination(expression: str, columns: Mapping[str, FloatArray], labels: FloatArray) -> float:
    """Return 1 - sum (label - value)² / sum (label - mean label)²; -inf when a value is not finite."""
    values = values_on(expression, columns)
    with np.errstate(all="ignore"):
        share = float(np.sum((labels - values) ** 2) / np.sum((labels - np.mean(labels)) ** 2))
    return 1.0 - share if np.isfinite(share) else -np.inf
