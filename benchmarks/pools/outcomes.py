"""Outcomes of the refined pools next to the reference: forms, grades, processor seconds, each change."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Final

from scipy.stats import binomtest

from atoll.terminal.output import clip, table
from benchmarks.first_hour.outcomes import CONFIDENT
from benchmarks.harness.tables import grouped
from benchmarks.pools.cases import Judged

CHANCE: Final = 0.05
"""Probability of as large a difference by chance below which fewer right equations or more false grades count."""

LONGEST: Final = 90


@dataclass(frozen=True)
class PoolOutcome:
    """The outcome of one pool: its equations, and the processor seconds of preparing and refining; or a failure."""

    title: str
    equations: tuple[Judged, ...]
    preparing_s: float
    refining_s: float
    failure: str | None = None

    @property
    def line(self) -> str:
        """Return the outcome in a line."""
        marks = [f"{one.variable} {_mark(one)}" for one in self.equations]
        return f"{self.title}: {self.failure or ', '.join(marks)}; {self.preparing_s:.1f} + {self.refining_s:.1f} s"

    @property
    def kind(self) -> str:
        """The kind of the pool, and the campaign of a verdict's table."""
        words = self.title.split()
        return " ".join(words[:2]) if words[0] == "verdicts" else words[0]


def _mark(one: Judged) -> str:
    form = "no law known" if one.is_right is None else "right" if one.is_right else "other form"
    return f"{form}, {one.grade}" + (", FALSE" if one.is_false else "")


def seconds_of(outcome: PoolOutcome | None) -> float:
    """Return the processor seconds of a pool; infinite where they are not known."""
    return math.inf if outcome is None else outcome.preparing_s + outcome.refining_s


def read_reference(path: Path) -> dict[str, PoolOutcome]:
    """Return the outcomes of the reference by title, empty where there is no file yet."""
    if not path.exists():
        return {}
    listed = json.loads(path.read_text("utf-8"))
    return {
        one["title"]: PoolOutcome(**{**one, "equations": tuple(Judged(**equation) for equation in one["equations"])})
        for one in listed
    }


def write_reference(path: Path, outcomes: Iterable[PoolOutcome]) -> None:
    """Write outcomes as the reference; outcomes of other titles stay."""
    merged = {**read_reference(path), **{one.title: _rounded(one) for one in outcomes if one.failure is None}}
    lines = ",\n".join(json.dumps(asdict(merged[title])) for title in sorted(merged))
    path.write_text(f"[\n{lines}\n]\n", "utf-8")


def _rounded(outcome: PoolOutcome) -> PoolOutcome:
    return replace(outcome, preparing_s=round(outcome.preparing_s, 2), refining_s=round(outcome.refining_s, 2))


def report(outcomes: Sequence[PoolOutcome], reference: Mapping[str, PoolOutcome]) -> tuple[str, bool]:
    """Return the table and the changes as text, and whether the outcomes are as good as the reference.

    They are unless a pool failed, or a sign test over the equations that changed says that fewer are right, or more
    grades are false, with less than `CHANCE` of as large a difference by chance.
    """
    known = [(one, reference[one.title]) for one in outcomes if one.title in reference and one.failure is None]
    rows = [_row(kind, those, reference) for kind, those in grouped(outcomes, lambda one: one.kind).items()]
    heads = ("pools", "number", "equations", "right", "exact", "good", "doubtful", "right but doubtful", "false",
             "processor s")  # fmt: skip
    lines = [table(heads, [*rows, _row("all", outcomes, reference)]), "(in brackets: the reference)", ""]
    pairs = [pair for now, before in known for pair in _pairs(now, before)]
    lines += chain.from_iterable(_changes(now, before) for now, before in known)
    right = _test([(bool(now.is_right), bool(before.is_right)) for now, before in pairs])
    honest = _test([(not now.is_false, not before.is_false) for now, before in pairs])
    relied = _test([(_is_relied(now), _is_relied(before)) for now, before in pairs])
    lines += [f"right: {right}", f"grades that hold: {honest}", f"right and relied on: {relied}"]
    failures = [f"FAILED {one.title}: {one.failure}" for one in outcomes if one.failure is not None]
    unknown = [one.title for one in outcomes if one.title not in reference]
    if unknown:
        lines.append(f"not in the reference: {len(unknown)} pools, {unknown[0]} for one")
    return "\n".join([*lines, *failures]), not failures and not (right.is_worse or honest.is_worse)


def effect(outcomes: Sequence[PoolOutcome], reference: Mapping[str, PoolOutcome]) -> tuple[str, ...]:
    """Return the effects of a change as cells: forms gained and lost, grades changed, false ones, ratio of seconds."""
    pairs = [pair for one in outcomes if one.failure is None for pair in _pairs(one, reference[one.title])]
    right = _test([(bool(now.is_right), bool(before.is_right)) for now, before in pairs])
    grades = sum(now.grade != before.grade for now, before in pairs)
    false = sum(now.is_false and not before.is_false for now, before in pairs)
    failed = sum(one.failure is not None for one in outcomes)
    seconds = sum(map(seconds_of, outcomes)) / sum(seconds_of(reference[one.title]) for one in outcomes)
    return f"{right.gained}", f"{right.lost}", f"{grades}", f"{false}", f"{failed}", f"{seconds:.2f}"


def _row(name: str, outcomes: Sequence[PoolOutcome], reference: Mapping[str, PoolOutcome]) -> tuple[str, ...]:
    before = [reference[one.title] for one in outcomes if one.title in reference]
    now, then = _counts(outcomes), _counts(before)
    seconds, earlier = (sum(one.preparing_s + one.refining_s for one in those) for those in (outcomes, before))
    cells = [f"{count} ({earlier_count})" for count, earlier_count in zip(now, then, strict=True)]
    return name, str(len(outcomes)), *cells, f"{seconds:.0f} ({earlier:.0f})"


def _counts(outcomes: Sequence[PoolOutcome]) -> tuple[int, ...]:
    equations = [one for outcome in outcomes for one in outcome.equations]
    grades = [one.grade for one in equations]
    return (
        len(equations),
        sum(bool(one.is_right) for one in equations),
        grades.count("exact"),
        grades.count("good"),
        len(grades) - grades.count("exact") - grades.count("good"),
        sum(bool(one.is_right) and one.grade not in CONFIDENT for one in equations),
        sum(one.is_false for one in equations),
    )


def _pairs(now: PoolOutcome, before: PoolOutcome) -> list[tuple[Judged, Judged]]:
    earlier = {one.variable: one for one in before.equations}
    return [(one, earlier[one.variable]) for one in now.equations if one.variable in earlier]


def _changes(now: PoolOutcome, before: PoolOutcome) -> list[str]:
    return [
        f"{now.title}: {one.variable}: {_mark(then)} -> {_mark(one)}: {clip(one.expression or '-', LONGEST)}"
        for one, then in _pairs(now, before)
        if (one.is_right, one.grade, one.is_false) != (then.is_right, then.grade, then.is_false)
    ]


def _is_relied(one: Judged) -> bool:
    return bool(one.is_right) and one.grade in CONFIDENT


@dataclass(frozen=True)
class SignTest:
    """How many equations gained and lost a property, and the probability of as many losses among the changes by chance.

    The test is one-sided, of losses.
    """

    gained: int
    lost: int

    @property
    def p(self) -> float:
        """Probability of at least as many losses where gains and losses are as likely."""
        changed = self.gained + self.lost
        return float(binomtest(self.lost, changed, alternative="greater").pvalue) if changed else 1.0

    @property
    def is_worse(self) -> bool:
        """Whether there are more losses than chance allows."""
        return self.p < CHANCE

    def __str__(self) -> str:
        """Return the counts as text."""
        return f"{self.gained} gained, {self.lost} lost (p of as many losses by chance {self.p:.2g})"


def _test(pairs: Iterable[tuple[bool, bool]]) -> SignTest:
    listed = list(pairs)
    return SignTest(sum(now and not then for now, then in listed), sum(then and not now for now, then in listed))
