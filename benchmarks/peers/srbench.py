"""Is an equation solved? SRBench's own rule, and a strict one beside it.

``python -m benchmarks.peers.srbench`` shows that both credit the 14 Strogatz truths in equivalent forms, and refuse
others.

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
from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.command_line import option, program
from benchmarks.judging.equivalents import EQUIVALENTS, OTHERS, OVERCREDITED, UNCREDITED, rows_of
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

    Args:
        expression: the model, infix text over the names of `columns`; None where there is none.
        truth: the true expression, likewise.
        columns: the test rows: by name, R values each.
        labels: the true values on them (R,), without noise.
        by: who asks sympy; by default the one that this process shares.

    Raises:
        UsageError: `expression` is no expression over the names of `columns`.
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


def expectations(name: str) -> list[tuple[str, bool, bool]]:
    """Return forms for the truth of file `name`, and whether SRBench's and the strict rule are to credit them."""
    truth, *forms = EQUIVALENTS[name]
    rules = [*((form, True, True) for form in (truth, *forms)), *((form, False, False) for form in OTHERS[name])]
    rules += [(form, False, True) for form in (UNCREDITED.get(name),) if form]
    return rules + [(form, True, False) for form in (OVERCREDITED.get(name),) if form]


@program(
    "benchmarks.peers.srbench",
    __doc__,
    option("--file", choices=EQUIVALENTS, action="append", help="repeat for several; default: all 14"),
)
def main(options: Namespace) -> int:
    """Print how both rules judge equivalent forms and others; return 0 when each does what is known of it."""
    rows: list[tuple[str, ...]] = []
    credited, surprises = 0, 0
    names = options.file or list(EQUIVALENTS)
    for name in names:
        truth = EQUIVALENTS[name][0]
        note(f"{name}: {truth}")
        columns, labels = rows_of(name)
        for form, *expected in expectations(name):
            found = assess(form, truth, columns, labels)
            both = [found.is_right, compare_strictly(form, truth, columns).is_right]
            credited += all(both) and all(expected)
            surprises += both != expected
            rows.append((name, form, *("yes" if each else "no" for each in both), found.reason))
    say(table(("file", "form", "SRBench", "strict", "SRBench's reason"), rows))
    say(f"\n{credited} of {len(names) * 6} equivalent forms (the truth and five others) credited by both rules")
    say(f"{surprises} of {len(rows)} forms judged otherwise than is known")
    return 1 if surprises else 0


if __name__ == "__main__":
    sys.exit(main())
