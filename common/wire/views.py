"""What the coordinator tells its clients about jobs and workers; the shapes behind `status`, `jobs` and `workers`."""

from typing import Literal

from common.config import Model

JobState = Literal["queued", "preparing", "running", "refining", "done", "failed", "cancelled"]
FINAL_STATES: frozenset[JobState] = frozenset({"done", "failed", "cancelled"})
WorkerState = Literal["compiling", "ready", "computing", "waiting", "leaving", "lost"]


class VariableView(Model):
    """Progress of one equation. `epoch` counts completely reported epochs; `why` says how its search ended.

    A known equation is not searched: `why` is "known" from the beginning. `verdict` is given when the job has ended:
    how far the equation can be trusted.
    """

    variable: str
    lhs: str
    epoch: int
    error: float | None = None
    normalized_error: float | None = None
    complexity: int | None = None
    expression: str | None = None
    point_evaluations: int = 0
    converged: bool = False
    finished: bool = False
    why: Literal["target", "stagnation", "max-epochs", "max-time", "cancelled", "known"] | None = None
    verdict: Literal["exact", "good", "doubtful", "no model"] | None = None


class JobView(Model):
    """One job as `jobs` and `status` show it. Times are seconds; `reason` says why it failed or what it waits for.

    `fault` of a failed job: the data could not be used, two workers diverged, or something of ours broke.
    """

    job: str
    name: str
    state: JobState
    seed: int
    preset: str
    reason: str | None = None
    fault: Literal["data", "diverged", "internal"] | None = None
    warnings: tuple[str, ...] = ()
    submitted: str
    elapsed: float
    workers: int
    point_evaluations: int
    point_evaluations_per_second: float | None = None
    variables: tuple[VariableView, ...] = ()


class WorkerView(Model):
    """One worker as `workers` shows it; `silent` is seconds since it was last heard of, `detail` for a person."""

    worker: str
    host: str
    pid: int
    state: WorkerState
    islands: int
    silent: float
    version: str
    detail: str = ""
