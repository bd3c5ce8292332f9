"""What searches on noisy data are expected to show, and whether they do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from benchmarks.harness.tables import Columns, percent
from benchmarks.noise.judging import Outcome
from benchmarks.noise.tables import Summary, summarized

EQUATIONS: Final = 14
FOUND: Final = {0.0: 14, 0.01: 13, 0.05: 11, 0.1: 10, 0.2: 8}
"""By level of noise: equations found, of 14, in the median over seeds; without noise with every seed."""

CONSTANTS: Final = {0.0: 1e-4, 0.01: 0.006, 0.05: 0.026, 0.1: 0.051, 0.2: 0.1}
"""Largest relative error of a constant, in the median over all equations found: what maximum likelihood reaches."""

FORETOLD: Final = {0.0: 13, 0.01: 13, 0.05: 12, 0.1: 10}
"""Variables, of 14, whose R² from fresh initial conditions exceeds 0.9, in the median over seeds; without noise with
every seed."""

COVERAGE: Final = (0.9, 0.97)
"""Share of the 95 % intervals that hold the truth, over all levels with noise."""


@dataclass(frozen=True)
class Goal:
    """One figure beside what was expected of it."""

    figure: str
    expected: str
    measured: str
    is_met: bool


def goals(outcomes: Sequence[Outcome]) -> list[Goal]:
    """Return what was expected of the searches of one method and manner of sampling, and what came out.

    Levels at which not all 14 equations were sought are left out.
    """
    whole = [each for each in summarized(outcomes) if each.equations == EQUATIONS]
    found = [goal for each in whole for goal in _of_level(each)]
    noisy = [each for each in whole if each.level > 0.0]
    intervals, covered = sum(each.intervals for each in noisy), sum(each.covered for each in noisy)
    if noisy:
        low, high = COVERAGE
        share = covered / intervals if intervals else None
        measured = f"{percent(share)} of {intervals}"
        is_met = share is not None and low <= share <= high
        found.append(Goal("intervals that hold the truth", f"{percent(low)} to {percent(high)}", measured, is_met))
    return found


def _of_level(its: Summary) -> list[Goal]:
    found: list[Goal] = []
    counts = (its.found, its.foretold) if its.level > 0.0 else (its.least_found, its.least_foretold)
    for name, expected, measured in zip(("found", "foretold"), (FOUND, FORETOLD), counts, strict=True):
        if its.level in expected:
            least = expected[its.level]
            text = f"at least {least} of {EQUATIONS}"
            found.append(Goal(f"{name} at noise {its.level:g}", text, f"{measured:g}", measured >= least))
    if its.level in CONSTANTS:
        most, error = CONSTANTS[its.level], its.constants_error
        is_met = error is not None and error <= most
        found.append(Goal(f"constants at noise {its.level:g}", f"within {percent(most)}", percent(error), is_met))
    return found


def shown(found: Sequence[Goal]) -> str:
    """Return the goals as a table."""
    return Columns("figure | expected | measured | ={is_met:met}").table(found)
