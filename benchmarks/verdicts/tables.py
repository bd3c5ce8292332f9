"""Tables of what the campaigns came to: false verdicts, right laws that are doubted, and each case of either."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from atoll.terminal.output import clip, table
from benchmarks.first_hour.outcomes import CONFIDENT
from benchmarks.harness.tables import grouped
from benchmarks.verdicts.autonomous import FULL, LIMITED
from benchmarks.verdicts.drawn import Drawn
from benchmarks.verdicts.judging import EquationOutcome, Key, Outcome, is_same_model, rank

MOST_FALSE: Final = 0.02
"""Share of the verdicts "good" of one campaign that may be false; in all campaigns together half of it."""

LONGEST: Final = 110

HEADS: Final = (
    "tables", "broke, late", "refused", "equations", "exact", "false", "good", "false", "other form", "wrong beyond",
    "saturated", "doubtful, none", "identified", "of these right", "right, doubted",
    "decided, right", "of these doubted", "intervals hold", "cut", "s: median, most",
)  # fmt: skip
"""Of "exact" and "good" equations together: ``other form`` than the law's; of these ``wrong beyond`` what was measured,
although they predict from other initial states; ``saturated``: of models with as many numbers as the table has values.
``identified``: a shorter law would not do; ``decided``: nor would another textbook form, where these were compared.
Of the constants of right equations: in how many 95 % intervals the true value lies.
"""

Pair = tuple[Outcome, EquationOutcome]
TableOf = Callable[[Key], Drawn]


def line(outcome: Outcome) -> str:
    """Return how one job came out, for following a long run."""
    marks = [f"{equation.variable} {_mark(equation)}" for equation in outcome.equations]
    end = "" if outcome.end == "done" else f", {outcome.end}: {outcome.sentence}"
    limit = f" of {outcome.limit:g}" if outcome.limit and outcome.is_cut else ""
    which = f"{outcome.key.title} ({outcome.kind}, {outcome.rows} rows)"
    return f"{which}: {', '.join(marks)}; {outcome.seconds:.1f} s{limit}{end}"


def _mark(equation: EquationOutcome) -> str:
    form = "no law" if equation.law is None else equation.form
    r2 = "-" if equation.r2 is None else f"{equation.r2:.2f}"
    return f"{'FALSE ' if equation.is_false else ''}{equation.grade}, {form}, R2 {r2}"


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each campaign and one for all."""
    rows = [_row(name, those) for name, those in grouped(outcomes, lambda outcome: outcome.key.campaign).items()]
    return table(("campaign", *HEADS), [*rows, _row("all", outcomes)] if len(rows) > 1 else rows)


def by_kind(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each kind of table, whatever its noise."""

    def kind(outcome: Outcome) -> str:
        return f"{outcome.key.campaign} {outcome.key.variant} {outcome.kind.partition(',')[0]}"

    return table(("kind", *HEADS), [_row(name, those) for name, those in sorted(grouped(outcomes, kind).items())])


def _row(title: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    equations = [equation for _, equation in _pairs(outcomes)]
    exact, good = ([one for one in equations if one.grade == grade] for grade in CONFIDENT)
    identified = [one for one in equations if one.is_identified]
    right = [one for one in identified if one.is_right]
    decided = [one for one in right if one.is_decided]
    seconds = [outcome.seconds for outcome in outcomes]
    return (
        title,
        str(len(outcomes)),
        str(sum(outcome.end in ("broke", "late") for outcome in outcomes)),
        str(sum(outcome.end == "refused" for outcome in outcomes)),
        str(len(equations)),
        str(len(exact)),
        str(sum(one.is_false for one in exact)),
        str(len(good)),
        str(sum(one.is_false for one in good)),
        str(sum(not one.is_right for one in (*exact, *good))),
        str(sum(one.is_wrong_beyond for one in equations)),
        str(sum(one.grade in CONFIDENT for outcome, one in _pairs(outcomes) if outcome.is_saturated)),
        str(len(equations) - len(exact) - len(good)),
        str(len(identified)),
        str(len(right)),
        str(sum(one.grade not in CONFIDENT for one in right)),
        str(len(decided)),
        str(sum(one.grade not in CONFIDENT for one in decided)),
        f"{sum(one.covered for one in equations)}/{sum(one.intervals for one in equations)}",
        str(sum(outcome.is_cut for outcome in outcomes)),
        f"{np.median(seconds):.1f}, {max(seconds):.0f}",
    )


def _pairs(outcomes: Iterable[Outcome]) -> list[Pair]:
    return [(outcome, equation) for outcome in outcomes for equation in outcome.equations]


def cases(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a line for each false verdict, each identified law that is right and doubted, and each fault."""
    lines = []
    for outcome, equation in _pairs(outcomes):
        where = f"{outcome.key.title} ({outcome.kind}, {outcome.rows} rows)"
        r2 = "-" if equation.r2 is None else f"{equation.r2:.3g}"
        text = clip(equation.expression or "-", LONGEST)
        if equation.is_false:
            lines.append(f"FALSE {equation.grade}: {where}: {equation.variable} = {text}, not {equation.law}; R2 {r2}")
        elif equation.is_identified and equation.is_right and equation.grade not in CONFIDENT:
            lead = "" if equation.lead is None else f" (leads by {equation.lead:.2g})"
            lines.append(f"DOUBTED: {where}: {equation.variable} = {text}{lead}; {equation.reason}")
    lines += [f"{outcome.end.upper()}: {outcome.key.title} ({outcome.kind}): {outcome.sentence}" for outcome in outcomes
              if outcome.end != "done"]  # fmt: skip
    return sorted(lines)


def limits(outcomes: Sequence[Outcome], table_of: TableOf) -> list[str]:
    """Return a line for each verdict that is better with a limit of time than without, of another model."""
    lines = []
    for full, limited in _variants(outcomes, "limits", (FULL, LIMITED)):
        for one, other in zip(full.equations, limited.equations, strict=True):
            if rank(other.grade) < rank(one.grade) and not is_same_model(one, other, table_of(full.key)):
                lines.append(
                    f"BETTER for a limit: {limited.key.title} ({limited.kind}, {limited.limit:g} s): {one.variable} is "
                    f"{other.grade} as {clip(other.expression or '-', LONGEST)}; without a limit {one.grade} as "
                    f"{clip(one.expression or '-', LONGEST)}"
                )
    return lines


def rates(outcomes: Sequence[Outcome], table_of: TableOf) -> list[str]:
    """Return a line for each equation that is another one, or has another verdict, when sampled faster."""
    lines = []
    chosen = [outcome for outcome in outcomes if outcome.key.campaign == "rates"]
    for same in grouped(chosen, lambda outcome: outcome.key.seed).values():
        for slow, fast in pairwise(same):
            for one, other in zip(slow.equations, fast.equations, strict=True):
                where = f"{slow.key.title} and {fast.key.variant} ({slow.kind}): {one.variable}"
                if not is_same_model(one, other, table_of(slow.key)):
                    shown = (clip(each.expression or "-", LONGEST) for each in (one, other))
                    lines.append(f"OTHER MODEL: {where} = {' and '.join(shown)} ({one.grade}, {other.grade})")
                elif one.grade != other.grade:
                    lines.append(f"OTHER VERDICT: {where} is {one.grade} and {other.grade}")
    return lines


def _variants(
    outcomes: Sequence[Outcome], campaign: str, variants: tuple[str, str]
) -> list[tuple[Outcome, Outcome]]:  # fmt: skip
    by_key = {outcome.key: outcome for outcome in outcomes}
    seeds = dict.fromkeys(outcome.key.seed for outcome in outcomes if outcome.key.campaign == campaign)
    pairs = [tuple(by_key.get(Key(campaign, seed, variant)) for variant in variants) for seed in seeds]
    return [(one, other) for one, other in pairs if one is not None and other is not None]


def is_as_promised(outcomes: Sequence[Outcome]) -> bool:
    """Tell whether nothing broke, no "exact" is false, and no more of "good" than `MOST_FALSE` allows."""
    campaigns = [*grouped(outcomes, lambda outcome: outcome.key.campaign).values()]
    if any(outcome.end in ("broke", "late") for outcome in outcomes) or _false(outcomes, "exact") > 0.0:
        return False
    is_few = len(campaigns) <= 1 or _false(outcomes, "good") <= 0.5 * MOST_FALSE
    return is_few and all(_false(those, "good") <= MOST_FALSE for those in campaigns)


def _false(outcomes: Sequence[Outcome], grade: str) -> float:
    graded = [equation for _, equation in _pairs(outcomes) if equation.grade == grade]
    return sum(equation.is_false for equation in graded) / max(len(graded), 1)
