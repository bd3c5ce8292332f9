"""What each number of the settings decides: kept pools refined again with it halved, doubled, or a stage left out.

``python -m benchmarks.corpus.ablations --pools DIR --out FILE.jsonl`` refines every pool there (see ``--keep-pools`` of
`benchmarks.corpus`) with the settings as they are, then once for each change, and prints for each how many equations
come out otherwise: in form, in verdict, right or wrong. A file that exists is gone on with.
"""

import pickle
import re
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note, say
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.text.infix import to_infix
from benchmarks.corpus.cases import Case, make_case
from benchmarks.corpus.pools import KeptPool, change_settings
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, program, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.tables import markdown
from benchmarks.judging.forms import judge_form

STAGES: Final = (
    "common", "effort", "criterion", "regression", "sparse", "rates", "windows", "shooting", "selection",
    "inference",
)  # fmt: skip
"""Of the settings, those that kept pools can tell of: no number of preparing, none of stochastic processes."""

LEFT_OUT: Final = ("propose_sums", "propose_all", "propose_further_sums", "with_laws")
"""Stages that may be left out."""


@dataclass(frozen=True)
class Outcome:
    """How the equations of a pool came out with one change; `key` is (change, file).

    `equations` has for each: what is shown without its numbers, verdict, right or not.
    """

    key: tuple[str, str]
    equations: tuple[tuple[str, str | None, bool], ...]
    seconds: float


def changes() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name of each change, and what it sets; the first changes nothing."""
    yield "as it is", {}
    for stage in LEFT_OUT:
        yield f"without {stage}", {f"without.{stage}": 1}
    for stage in STAGES:
        part = getattr(SETTINGS, stage)
        for field in fields(part):
            value = getattr(part, field.name)
            for factor in (0.5, 2.0):
                changed = _scaled(value, factor)
                if changed != value:
                    yield f"{stage}.{field.name} = {changed}", {f"{stage}.{field.name}": changed}


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled(number, factor) for number in value)
    scaled = value * factor
    return max(1, round(scaled)) if isinstance(value, int) else scaled


@cache
def _opened(file: Path) -> tuple[KeptPool, Case]:
    kept: KeptPool = pickle.loads(file.read_bytes())
    assert kept.key is not None
    return kept, make_case(kept.key, has_fresh=False)


def refine(task: tuple[str, Mapping[str, Any], Path]) -> Outcome:
    """Refine one pool with one change."""
    name, changed, file = task
    kept, case = _opened(file)
    before = change_settings(changed)
    begun = time.process_time()
    try:
        made = refine_all(kept.preparation, kept.config, kept.pools, Deadline(), kept.laws)
    finally:
        used = time.process_time() - begun
        change_settings(before)
    equations = []
    for variable, truth in case.system.truths.items():
        equation = made.equations.get(variable)
        text = "" if equation is None else to_infix(equation.program, kept.preparation.dataset.names)
        form = judge_form(text, truth, case.clean, with_extra=False) if text else None
        shown = re.sub(r"(?<![\w.])\d[\d.]*(?:e[-+]?\d+)?", "#", text)
        equations.append((shown, None if equation is None else equation.grade, form is not None and form.is_right))
    return Outcome((name, file.name), tuple(equations), used)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return what every change did beside the settings as they are, on the pools that both did."""
    plain = {outcome.key[1]: outcome for outcome in outcomes if outcome.key[0] == "as it is"}
    names = dict.fromkeys(outcome.key[0] for outcome in outcomes)
    rows = []
    for name in names:
        those = [outcome for outcome in outcomes if outcome.key[0] == name and outcome.key[1] in plain]
        pairs = [
            (before, after)
            for outcome in those
            for before, after in zip(plain[outcome.key[1]].equations, outcome.equations, strict=True)
        ]
        gained = sum(after[2] and not before[2] for before, after in pairs)
        lost = sum(before[2] and not after[2] for before, after in pairs)
        forms, verdicts = (sum(before[place] != after[place] for before, after in pairs) for place in (0, 1))
        seconds = sum(outcome.seconds for outcome in those)
        ratio = seconds / sum(plain[outcome.key[1]].seconds for outcome in those)
        good = sum(after[1] in ("good", "exact") for _, after in pairs)
        wrong = sum(after[1] in ("good", "exact") and not after[2] for _, after in pairs)
        rows.append((name, *map(str, (len(pairs), gained, lost, forms, verdicts, good, wrong)), f"{ratio:.2f}"))
    heads = ("change", "equations", "right gained", "lost", "other form", "other verdict", "good", "good but not right")
    return markdown((*heads, "processor time"), rows)


@program(
    "benchmarks.corpus.ablations",
    __doc__,
    option("--pools", type=Path, metavar="DIR", required=True, help="where --keep-pools has kept them"),
    option("--only", nargs="*", default=[], metavar="TEXT", help="changes whose names begin so"),
    option("--first", type=int, metavar="NUMBER", help="so many pools, those that are refined fastest"),
    workers(),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with if it exists"),
)
def main(options: Namespace) -> None:
    """Do what the options ask for."""
    journal = journal_of("ablations", Outcome, options)
    files = sorted(options.pools.glob("*.pickle"))
    chosen = [change for change in changes() if not options.only or change[0].startswith(tuple(options.only))]

    def work_off(some: Sequence[tuple[str, Mapping[str, Any]]], files: Sequence[Path]) -> None:
        tasks = [(*change, file) for change in some for file in files if (change[0], file.name) not in journal.outcomes]
        for number, outcome in enumerate(in_parallel(refine, tasks, options.workers), start=1):
            journal.add(outcome)
            note(f"{number} of {len(tasks)}: {': '.join(outcome.key)}, {outcome.seconds:.1f} s")

    work_off([("as it is", {})], files)
    took = {file: journal.outcomes["as it is", file.name].seconds for file in files}
    work_off(chosen, sorted(files, key=partial(dict.__getitem__, took))[: options.first])
    say(table(list(journal.outcomes.values())))


if __name__ == "__main__":
    sys.exit(main())
