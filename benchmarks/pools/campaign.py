"""All stored pools: their titles, and refining and judging one of them."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from atoll_coordinator.settings import VARIABLE, Settings
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.tables import grouped
from benchmarks.pools.cases import Folders, job_of
from benchmarks.pools.outcomes import PoolOutcome, seconds_of
from benchmarks.pools.stored import Request, file_of, read_pools, refine_stored

HERE: Final = Path(__file__).parent
POOLS: Final = HERE / "pools"
REFERENCE: Final = HERE / "reference.json"


def titles() -> list[str]:
    """Return the titles of all stored pools, in the order in which they are reported."""
    lines = (HERE / "titles.txt").read_text("utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def judge_pool(title: str, folders: Folders) -> PoolOutcome:
    """Refine a stored pool and judge the result; an error becomes the outcome's failure."""
    try:
        job = job_of(title, folders)
        refined = refine_stored(title, job.table, job.config, read_pools(file_of(POOLS, title)))
    except AtollError as error:
        return PoolOutcome(title, (), 0.0, 0.0, str(error))
    return PoolOutcome(title, tuple(job.judge(refined.result)), refined.preparing_s, refined.refining_s)


def requests(wanted: list[str], folders: Folders, max_time: float) -> dict[str, Request]:
    """Return the generators of the tables, with a search that ends after `max_time` seconds."""

    def request(title: str) -> tuple[Table, JobConfig]:
        job = job_of(title, folders)
        budget = job.config.budget.model_copy(update={"max_time": max_time})
        return job.table, job.config.model_copy(update={"budget": budget})

    return {title: partial(request, title) for title in wanted}


def sample(reference: Mapping[str, PoolOutcome], number: int, most_s: float) -> list[str]:
    """Return titles whose tables are drawn: of each kind by turns the quickest, none of more processor seconds."""
    drawn = [
        title
        for title in titles()
        if title.partition(" ")[0] not in ("case", "real") and seconds_of(reference.get(title)) <= most_s
    ]
    kinds = grouped(sorted(drawn, key=lambda title: seconds_of(reference[title])), lambda title: reference[title].kind)
    turns = zip_longest(*kinds.values())
    return [title for turn in turns for title in turn if title is not None][:number]


@dataclass(frozen=True)
class Change:
    """One setting with another value, as `atoll_coordinator.settings.with_changes` reads it."""

    name: str
    value: int | float | tuple[float, ...]

    @property
    def text(self) -> str:
        """The change as text."""
        return f"{self.name}={self.value!r}".replace(" ", "")


def changes_of(settings: Settings) -> list[Change]:
    """Return each number of the settings halved and doubled; whole numbers stay whole, and above 0."""
    return [
        Change(f"{stage}.{field}", _scaled(value, factor))
        for stage, part in vars(settings).items()
        for field, value in vars(part).items()
        for factor in (0.5, 2.0)
        if _scaled(value, factor) != value
    ]


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled(one, factor) for one in value)
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def with_settings(change: str, wanted: Sequence[str], workers: int) -> list[PoolOutcome]:
    """Refine pools with other settings, in processes that begin with these."""
    os.environ[VARIABLE] = change
    try:
        return list(in_parallel(_judge_tried, wanted, workers))
    finally:
        del os.environ[VARIABLE]


def _judge_tried(title: str) -> PoolOutcome:
    """Refine and judge a pool; any error counts as a failure, since settings may contradict each other."""
    try:
        return judge_pool(title, Folders())
    except Exception as error:
        return PoolOutcome(title, (), 0.0, 0.0, f"{type(error).__name__}: {error}")


def has_table(title: str, folders: Folders) -> bool:
    """Tell whether the table of a title can be drawn, or read from a folder that was named."""
    needed = {"case": folders.listed, "real": folders.real}
    kind = title.partition(" ")[0]
    return kind not in needed or needed[kind] is not None
