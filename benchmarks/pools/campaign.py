"""All stored pools: their titles, and what refining and judging one of them gives."""

from functools import partial
from pathlib import Path
from typing import Final

from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.pools.cases import Folders, job_of
from benchmarks.pools.outcomes import PoolOutcome
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
    """Return what draws the table of each job, with a search that ends after `max_time` seconds."""

    def request(title: str) -> tuple[Table, JobConfig]:
        job = job_of(title, folders)
        budget = job.config.budget.model_copy(update={"max_time": max_time})
        return job.table, job.config.model_copy(update={"budget": budget})

    return {title: partial(request, title) for title in wanted}


def has_table(title: str, folders: Folders) -> bool:
    """Tell whether the table of a title can be drawn, or read from a folder that was named."""
    needed = {"case": folders.listed, "real": folders.real}
    kind = title.partition(" ")[0]
    return kind not in needed or needed[kind] is not None
