"""All tables one after the other, each as the command line would hand it over, and the figures of what came of them."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from atoll.cli.parser import parse
from atoll.cli.request import JobRequest, request_of
from atoll.terminal.output import table
from atoll_coordinator.data.reading.files import read_table
from atoll_core.errors import AtollError, DataError, UsageError
from benchmarks.first_hour.cases import CASES, GROUPS, Case
from benchmarks.first_hour.outcomes import End, EquationOutcome, Outcome, judge
from benchmarks.first_hour.tables import csv_of
from benchmarks.harness import campaign
from benchmarks.harness.campaign import Answer, work_off
from benchmarks.harness.journal import Journal
from benchmarks.harness.service import JobEndedError, Searches
from benchmarks.harness.stopwatch import Stopwatch

BROKE = "failed ("
"""What a sentence or warning says when something of ours failed."""


def run(names: Sequence[str], journal: Journal[Outcome], workers: int, limit_s: float) -> list[Outcome]:
    """Do what the journal does not have; return the outcomes of all."""
    return work_off(names, journal, lambda service, name: _one(service(), CASES[name], limit_s), line, workers)


def judge_again(names: Sequence[str], journal: Journal[Outcome]) -> None:
    """Judge the answers that the journal has by the present rules and cases."""
    campaign.judge_again(names, journal, lambda name, old, answer: replace(old, equations=judge(CASES[name], answer)))


def request(case: Case, folder: Path) -> JobRequest:
    """Write the file of a case into `folder` and return what the command line makes of it."""
    path = folder / "table.csv"
    path.write_text(csv_of(case.make(), case.header), "utf-8")
    return request_of(parse(["run", str(path), *case.words]))


def _one(searches: Searches, case: Case, limit_s: float) -> tuple[Outcome, Answer]:
    stopwatch, begun = Stopwatch(limit_s=limit_s, counts=True), time.monotonic()
    answer: dict[str, Any] = {}
    end: End
    with TemporaryDirectory() as folder:
        try:
            asked = request(case, Path(folder))
            begun = time.monotonic()
            answer = searches.solve(
                case.name, read_table(asked.files, asked.config.data), asked.config, stopwatch.watch
            )
            broken = [warning for warning in answer["warnings"] if BROKE in warning]
            end, sentence = ("broke", broken[0]) if broken else ("done", "")
        except (DataError, UsageError) as error:
            end, sentence = "refused", str(error)
        except JobEndedError as error:
            end, sentence = "refused" if error.view.fault == "data" else "broke", str(error)
        except AtollError as error:
            searches.check()  # without a coordinator no job is to blame
            end, sentence = "late", str(error)
    seconds = time.monotonic() - begun
    outcome = Outcome(
        case.name, end, sentence, judge(case, answer), seconds, sum(stopwatch.processor.values()),
        answer.get("digest"),
    )  # fmt: skip
    return outcome, answer or None


def line(outcome: Outcome) -> str:
    """Return how one table came out."""
    marks = [f"{equation.state}' = {equation.expression} ({_mark(equation)})" for equation in outcome.equations]
    said = f": {outcome.sentence}" if outcome.sentence else ""
    return f"{outcome.case}, {outcome.seconds:.1f} s, {outcome.end}{said}; {'; '.join(marks)}"


def _mark(equation: EquationOutcome) -> str:
    kind = (
        "none to find"
        if equation.law is None
        else "FOUND"
        if equation.is_found
        else f"not {equation.law}, {equation.form}"
    )
    return f"{kind}, {equation.verdict or '-'}"


def figures(outcomes: Sequence[Outcome]) -> str:
    """Return the table by groups, and below it what must not be."""
    group_of = {case.name: title for title, cases in GROUPS.items() for case in cases}
    rows = [
        _row(title, [outcome for outcome in outcomes if group_of[outcome.case] == title])
        for title in GROUPS
        if any(group_of[outcome.case] == title for outcome in outcomes)
    ]
    heads = ("tables", "number", "broke", "refused", "identified laws found", "right ones relied on",
             "others relied on", "no law, relied on", "median s", "longest s")  # fmt: skip
    return "\n".join([table(heads, [*rows, _row("all", outcomes)]), "", *_faults(outcomes)])


def _row(title: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    identified = [equation for equation in equations if equation.is_identified]
    right = [equation for equation in identified if equation.is_found]
    others = [equation for equation in equations if equation.law is not None and not equation.is_found]
    lawless = [equation for equation in equations if equation.law is None]
    seconds = [outcome.seconds for outcome in outcomes]
    return (
        title,
        str(len(outcomes)),
        str(sum(outcome.end in ("broke", "late") for outcome in outcomes)),
        str(sum(outcome.end == "refused" for outcome in outcomes)),
        _share(len(right), len(identified)),
        _share(sum(equation.is_confident for equation in right), len(right)),
        _share(sum(other.is_confident for other in others), len(others)),
        _share(sum(equation.is_confident for equation in lawless), len(lawless)),
        f"{np.median(seconds):.1f}",
        f"{max(seconds):.0f}",
    )


def _share(count: int, whole: int) -> str:
    return f"{count} of {whole}" if whole else "-"


def _faults(outcomes: Iterable[Outcome]) -> list[str]:
    """Return lines on every table that broke, law that was missed, and equation that is wrongly relied on."""
    lines = []
    for outcome in outcomes:
        if outcome.end in ("broke", "late"):
            lines.append(f"{outcome.end.upper()} {outcome.case}: {outcome.sentence}")
        for equation in outcome.equations:
            if equation.is_confident and not equation.is_found:
                lines.append(f"WRONGLY {equation.verdict} {outcome.case}: {equation.miss_text}")
            elif equation.is_identified and not equation.is_found:
                why = f" ({outcome.sentence})" if outcome.sentence else ""
                lines.append(f"MISSED {outcome.case}: {equation.miss_text}{why}")
    return lines


def is_as_it_should_be(outcomes: Sequence[Outcome]) -> bool:
    """Tell whether nothing broke, and nothing is relied on where there is no law."""
    return not any(
        outcome.end in ("broke", "late")
        or any(equation.is_confident and equation.law is None for equation in outcome.equations)
        for outcome in outcomes
    )
