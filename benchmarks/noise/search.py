"""One search on noisy data through the service, judged."""

import time
from collections.abc import Mapping
from typing import Any

from atoll.config import PRESETS, JobConfig
from atoll.errors import AtollError
from benchmarks.harness.service import Searches
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.noise.data import Case, Key
from benchmarks.noise.judging import Outcome, failed, outcome


def configured(seed: int, data: Mapping[str, Any], max_time: float | None) -> JobConfig:
    """Return the default configuration with a seed, fields of its data section and a limit of time."""
    config = PRESETS["default"]
    budget = config.budget.model_copy(update={"max_time": max_time})
    return config.model_copy(update={"seed": seed, "data": config.data.model_copy(update=dict(data)), "budget": budget})


def search(searches: Searches, key: Key, its: Case, max_time: float | None) -> tuple[Outcome, dict[str, Any] | None]:
    """Search one case and judge it; also the contents of result.json, None when the job failed.

    Raises:
        AtollError: the coordinator or a worker has ended.
    """
    stopwatch, begun = Stopwatch(), time.monotonic()
    try:
        result = searches.solve(key.title, its.table, configured(key.seed, its.data, max_time), stopwatch.watch)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        return failed(key, its, str(error), time.monotonic() - begun), None
    return outcome(key, its, result, stopwatch.seconds), result
