"""All tables of the campaigns one after the other, each as the command line would hand it over."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from atoll.cli.parser import parse
from atoll.cli.request import JobRequest, request_of
from atoll_coordinator.data.reading.files import read_table
from atoll_core.errors import AtollError, DataError, UsageError
from benchmarks.harness import campaign
from benchmarks.harness.campaign import Answer, Service, work_off
from benchmarks.harness.journal import Journal
from benchmarks.harness.service import JobEndedError, Searches
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.verdicts import few_rows, groups, inputs, targets
from benchmarks.verdicts.autonomous import FACTORS, FULL, LIMITED, draw_at_rate, draw_limited, draw_noisy
from benchmarks.verdicts.drawn import Drawn
from benchmarks.verdicts.judging import End, Key, Outcome, judge, numbers_of, values_of
from benchmarks.verdicts.tables import line

LIMITS_S: Final = (1.0, 60.0)
"""Least and largest --max-time of the campaign of limits."""

SHARES: Final = (0.15, 0.3, 0.5, 0.8)
"""Of the time that a job takes without a limit: limits, seed by seed in turn."""


@dataclass(frozen=True)
class Campaign:
    """One kind of table: how it is drawn from a seed and a variant, its variants, and the --max-time of its jobs."""

    draw: Callable[[int, str], Drawn]
    max_time: float | None
    variants: tuple[str, ...] = ("",)


CAMPAIGNS: Final = {
    "few-rows": Campaign(few_rows.draw, 60.0),
    "targets": Campaign(targets.draw, 30.0),
    "groups": Campaign(groups.draw, 120.0),
    "inputs": Campaign(inputs.draw, 60.0, ("", "hold")),
    "limits": Campaign(draw_limited, None, (FULL, LIMITED)),
    "rates": Campaign(draw_at_rate, 120.0, FACTORS),
    "strong-noise": Campaign(draw_noisy, 120.0),
}


def keys(names: Sequence[str], seeds: Sequence[int]) -> list[Key]:
    """Return all jobs, campaign by campaign; inputs that are said to be held only where they are and can be."""
    return [
        Key(name, seed, variant)
        for name in names
        for seed in seeds
        for variant in CAMPAIGNS[name].variants
        if variant != "hold" or (seed % 2 and inputs.has_hold())
    ]


def table_of(key: Key) -> Drawn:
    """Return the table of a job; equal keys give equal tables."""
    return CAMPAIGNS[key.campaign].draw(key.seed, key.variant)


def run(
    wanted: Sequence[Key], journal: Journal[Outcome], workers: int, max_time: float | None, patience_s: float
) -> list[Outcome]:
    """Do what the journal does not have; return the outcomes of all. `max_time` replaces that of the campaigns."""

    def do(service: Service, key: Key) -> tuple[Outcome, Answer]:
        limit = max_time or CAMPAIGNS[key.campaign].max_time
        if key.campaign == "limits":
            limit = None if key.variant == FULL else limit_of(key, journal)
        return _one(service(), key, limit, patience_s)

    return work_off(wanted, journal, do, line, workers)


def limit_of(key: Key, journal: Journal[Outcome]) -> float:
    """Return the --max-time of a limited job, a share of what the same job took without a limit."""
    full = journal.outcomes[replace(key, variant=FULL)]
    least, largest = LIMITS_S
    return float(f"{min(max(SHARES[key.seed % len(SHARES)] * full.seconds, least), largest):.3g}")


def judge_again(wanted: Sequence[Key], journal: Journal[Outcome]) -> None:
    """Judge the answers that the journal has by the present rules and tables."""

    def again(key: Key, old: Outcome, answer: Mapping[str, Any]) -> Outcome:
        drawn = table_of(key)
        numbers, values = numbers_of(drawn, answer), values_of(drawn)
        return replace(old, equations=judge(drawn, answer), numbers=numbers, values=values)

    campaign.judge_again(wanted, journal, again)


def request(text: str, words: Sequence[str], folder: Path, name: str = "table.csv") -> JobRequest:
    """Write a table into `folder` and return what the command line makes of it."""
    path = folder / name
    path.write_text(text, "utf-8")
    return request_of(parse(["run", str(path), *words]))


def _one(searches: Searches, key: Key, limit: float | None, patience_s: float) -> tuple[Outcome, Answer]:
    drawn = table_of(key)
    words = (*drawn.words, *(("--max-time", f"{limit:g}") if limit else ()))
    with TemporaryDirectory() as folder:
        asked = run_job(searches, key.title, lambda: request(drawn.csv(), words, Path(folder)), patience_s)
    outcome = Outcome(
        key, drawn.kind, drawn.rows, asked.end, asked.sentence, judge(drawn, asked.result), asked.seconds, limit,
        is_cut(asked.result), asked.result.get("digest"), numbers_of(drawn, asked.result),
        values_of(drawn),
    )  # fmt: skip
    return outcome, asked.result or None


@dataclass(frozen=True)
class JobEnd:
    """What came of one job: its result.json, empty where there is none, and how it ended."""

    result: dict[str, Any]
    end: End
    sentence: str
    seconds: float


def run_job(searches: Searches, name: str, request: Callable[[], JobRequest], patience_s: float) -> JobEnd:
    """Read the files of a request and run its job; raises AtollError where a process of the service has ended."""
    begun = time.monotonic()
    result: dict[str, Any] = {}
    end: End = "done"
    sentence = ""
    try:
        asked = request()
        table = read_table(asked.files, asked.config.data)
        result = searches.solve(name, table, asked.config, Stopwatch(limit_s=patience_s).watch)
    except (DataError, UsageError) as error:
        end, sentence = "refused", str(error)
    except JobEndedError as error:
        end, sentence = "refused" if error.view.fault == "data" else "broke", str(error)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        end, sentence = "late", str(error)
    return JobEnd(result, end, sentence, time.monotonic() - begun)


def is_cut(result: dict[str, Any]) -> bool:
    """Tell whether the --max-time of a job ended its search or the choice of its equations."""
    whys = [equation.get("why") for equation in result.get("equations", ())]
    return result.get("refining") == "max-time" or any(why == "max-time" for why in whys)
