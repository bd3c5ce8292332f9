"""What the result of a job is composed of, and the jobs whose results are composed before their ends take effect."""

from dataclasses import dataclass

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.result import Account, VariableOutcome, build_result
from atoll_coordinator.result.result import UNTIMED
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.views import outcomes_of
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.wire.messages.views import FINAL_STATES, JobState


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What the result of a prepared job is composed of. Nothing of it changes: another thread may compose it.

    `submitted_at` is when the job was submitted, in the bus's seconds.
    """

    job: str
    prepared: Prepared
    outcomes: tuple[VariableOutcome, ...]
    account: Account
    refinement: Refinement
    submitted_at: float

    @property
    def is_final(self) -> bool:
        """Whether it is that of a job that ends; else of one that goes on."""
        return self.account.state in FINAL_STATES

    def compose(self) -> str:
        """Return the result as JSON, but for the seconds that the job took (`result.result.timed`).

        It judges equations on all rows and loads kernels for that, which takes seconds for a million rows.
        """
        prepared = self.prepared
        made = build_result(
            self.job, prepared.config, prepared.preparation, self.outcomes, self.account, self.refinement
        )  # fmt: skip
        return made.to_json()


@dataclass(frozen=True, slots=True, eq=False)
class Ending:
    """A job whose end is decided and takes effect when its result is composed; until then it is shown as it `was`.

    `sentence` says what broke over the job, None: nothing did.
    """

    job: Job
    was: JobState
    draft: Draft
    sentence: str | None = None


def draft_of(job: Job) -> Draft | None:
    """Return what the result of a job is composed of as it stands; None: its data are not prepared."""
    if job.prepared is None:
        return None
    outcomes = tuple(outcomes_of(job))
    search_seconds = max((outcome.seconds for outcome in outcomes), default=0.0)
    account = Account(job.state, UNTIMED, search_seconds, job.reason)
    return Draft(job.id, job.prepared, outcomes, account, job.refinement, job.submitted_at)
