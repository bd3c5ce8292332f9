"""What several scores choose from one pool, and tables of many."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.corpus.cases import Key
from benchmarks.harness.tables import grouped, markdown, share
from benchmarks.scores.description import by_innovations, by_pieces, by_pieces_and_evidence
from benchmarks.scores.filtering import by_evidence, by_filter, by_tempered_filter
from benchmarks.scores.pools import Pool, Scored, make_pool

SCORES: Final[Mapping[str, Callable[[Pool], Scored]]] = {
    "pieces": by_pieces,
    "pieces, evidence": by_pieces_and_evidence,
    "innovations": by_innovations,
    "filter": by_filter,
    "tempered": by_tempered_filter,
    "evidence": by_evidence,
}
_TEMPERED: Final = ("tempered", "evidence")
SAME: Final = 1e-3
"""Nats: two systems whose misfits differ by less are the same function in other words."""
REACH: Final = 1.96


@dataclass(frozen=True)
class Choice:
    """What one score says: the kind of system that is the shortest, and by how many nats the law is shorter than the
    best of each kind: negative where it is not, -inf where it cannot be fitted, None where none of that kind can be.

    `covered` of `intervals` of the law's constants (95 %) hold the truth. `seconds` are of the processor.
    """

    chosen: str
    margins: Mapping[str, float | None]
    covered: int
    intervals: int
    seconds: float
    note: str = ""

    @property
    def margin(self) -> float:
        """By how many nats the law is shorter than the best that is none; infinite without one."""
        return min((margin for margin in self.margins.values() if margin is not None), default=math.inf)


@dataclass(frozen=True)
class Outcome:
    """The choices by score of one table; none where it is refused or its law cannot be known."""

    key: Key
    choices: Mapping[str, Choice]


def choose(key: Key, names: Sequence[str] = tuple(SCORES)) -> Outcome:
    """Return what scores of these names choose for one table of the corpus."""
    pool = make_pool(key)
    if pool is None or not pool.is_identifiable:
        return Outcome(key, {})
    scored, seconds = {}, {}
    with np.errstate(all="ignore"):
        for name in names:
            begun = time.process_time()
            scored[name] = _finite(SCORES[name](pool))
            seconds[name] = time.process_time() - begun
        is_law = laws_of(pool, scored)
    return Outcome(key, {name: choice_of(pool, is_law, scored[name], seconds[name]) for name in names})


def _finite(scored: Scored) -> Scored:
    """Return the same, infinite where there is no number."""
    return replace(scored, nats=tuple(nats if math.isfinite(nats) else math.inf for nats in scored.nats))


def laws_of(pool: Pool, scored: Mapping[str, Scored]) -> list[bool]:
    """Return which systems are the law in other words: with as many constants they have the same misfit, by some score.

    Tempered misfits, of which nats are fewer, are left out.
    """
    beyond = [np.subtract(one.misfits, one.misfits[0]) for name, one in scored.items() if name not in _TEMPERED]
    is_same = np.any(np.abs(np.nan_to_num(beyond, nan=math.inf, posinf=math.inf)) < SAME, axis=0)
    return [bool(same) and pool.count(place) == pool.count(0) for place, same in enumerate(is_same)]


def choice_of(pool: Pool, is_law: Sequence[bool], scored: Scored, seconds: float) -> Choice:
    """Return what a score chooses, given which systems are the law in whatever words."""
    law = min((nats for nats, is_same in zip(scored.nats, is_law, strict=True) if is_same), default=math.inf)
    others = [(nats, kind) for nats, kind, same in zip(scored.nats, pool.kinds, is_law, strict=True) if not same]
    least, kind = min(others, default=(math.inf, "law"))
    margins: dict[str, float | None] = {}
    for other in ("extended", "reduced", "exchanged"):
        margin = min((nats for nats, kind in others if kind == other), default=math.inf) - law
        margins[other] = float(margin) if math.isfinite(margin) else None if law < math.inf else -math.inf
    errors = np.array(scored.errors)
    known = errors > 0.0
    off = np.abs(np.array(scored.estimates) - np.array(pool.constants)[: len(errors)])
    covered = int((off[known] <= REACH * errors[known]).sum())
    chosen = "law" if law < least else kind if math.isfinite(least) else "none"
    return Choice(chosen, margins, covered, int(known.sum()), seconds, scored.note)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each quality and score: right choices, wrong ones by kind, margins, coverage and seconds.

    The margin is by how many nats the law is shorter than the best that is none.
    """
    judged = [outcome for outcome in outcomes if outcome.choices]
    rows = []
    for quality, alike in [*grouped(judged, lambda outcome: outcome.key.quality).items(), ("all", judged)]:
        for score in SCORES:
            choices = [outcome.choices[score] for outcome in alike if score in outcome.choices]
            if not choices:
                continue
            counts = {kind: sum(choice.chosen == kind for choice in choices) for kind in (*_WRONG, "law")}
            covered, intervals = (sum(getattr(choice, name) for choice in choices) for name in ("covered", "intervals"))
            seconds = [choice.seconds for choice in choices]
            margin = f"{np.median([choice.margin for choice in choices]):.1f}"
            wrong = (str(counts[kind]) for kind in _WRONG)
            times = f"{np.median(seconds):.2f} / {np.quantile(seconds, 0.95):.1f}"
            known = share(covered, intervals)
            rows.append((quality, score, share(counts["law"], len(choices)), *wrong, margin, known, times))
    return markdown(
        ("quality", "score", "law chosen", *_WRONG, "median margin", "95 % intervals", "cpu s median / 95 %"), rows
    )


_WRONG: Final = ("extended", "reduced", "exchanged", "none")


def line(outcome: Outcome) -> str:
    """Return how one table came out."""
    if not outcome.choices:
        return f"{outcome.key.title}: refused, or the law cannot be known"
    parts = [f"{name} {choice.chosen} ({choice.seconds:.1f} s)" for name, choice in outcome.choices.items()]
    return f"{outcome.key.title}: {', '.join(parts)}"
