"""Sets right what a worker holds and should not, or should hold and does not. Knows no bus."""

from collections.abc import Mapping

from atoll.wire.messages.workers import Close, CloseJob, Holding, Placements, WorkerStatus
from atoll_coordinator.service.effects import Outlet
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.monitor import Watch
from atoll_coordinator.service.search.archipelago import Archipelago


class Holdings:
    """What workers hold, compared with what is placed on them."""

    def __init__(self, jobs: Mapping[str, Job], outlet: Outlet, watch: Watch) -> None:
        """`jobs` are the live ones, by id, as they come and go."""
        self._jobs = jobs
        self._outlet = outlet
        self._watch = watch

    def look(self, worker: str, status: WorkerStatus) -> None:
        """Compare what a heartbeat says, and tell the worker what it lacks or may forget."""
        held = {(each.job, each.variable): each for each in status.holdings}
        for holding in status.holdings:
            self._check_holding(worker, holding)
        for job in status.jobs:
            self._check_dataset(worker, job)
        self._send_missing_placements(worker, held)

    def is_current(self, job_id: str, variable: str, term: int) -> bool:
        """Tell whether this is the term under which an archipelago is placed now."""
        archipelago = self._archipelago(job_id, variable)
        placement = archipelago.placement if archipelago is not None and archipelago.cut is None else None
        return placement is not None and placement.term == term

    def _check_holding(self, worker: str, holding: Holding) -> None:
        archipelago = self._archipelago(holding.job, holding.variable)
        if archipelago is None or archipelago.cut is not None:
            if not self._is_open(holding.job):
                self._outlet.tell(CloseJob(job=holding.job), worker)
            elif archipelago is not None:
                self._outlet.tell(Close(job=holding.job, variable=holding.variable, term=holding.term), worker)
            return
        placement = archipelago.placement
        if placement is None:
            return
        if holding.term < placement.term:
            self._outlet.tell(Placements(placements=(placement,)), worker)
        elif holding.term == placement.term:
            self._catch_up(worker, archipelago, holding)

    def _check_dataset(self, worker: str, job_id: str) -> None:
        """Have a dataset forgotten that is needed no more."""
        if not self._is_open(job_id):
            self._outlet.tell(CloseJob(job=job_id), worker)

    def _is_open(self, job_id: str) -> bool:
        """Tell whether islands of a job are computed now or will be: what is said to be closed may arrive late."""
        job = self._jobs.get(job_id)
        return job is not None and job.state in ("queued", "preparing", "running")

    def _catch_up(self, worker: str, archipelago: Archipelago, holding: Holding) -> None:
        """Pull reports that were lost, and repeat a commit that was."""
        archipelago.note_holding(worker, holding)
        self._watch.waited(worker, holding)
        pull = archipelago.missing_reports(worker, holding)
        if pull is not None:
            self._outlet.pull(worker, pull)
        due = archipelago.forget_due()
        if due is not None:
            self._outlet.tell(due)
        commit = archipelago.commit()
        if commit is not None and holding.commit < commit.epoch:
            self._outlet.tell(commit, worker)

    def _send_missing_placements(self, worker: str, held: dict[tuple[str, str], Holding]) -> None:
        missing = [
            archipelago.placement
            for job in self._jobs.values()
            for archipelago in job.open_archipelagos
            if archipelago.placement is not None
            and worker in archipelago.placement.workers
            and (job.id, archipelago.variable) not in held
        ]
        if missing:
            self._outlet.tell(Placements(placements=tuple(missing)), worker)

    def _archipelago(self, job_id: str, variable: str) -> Archipelago | None:
        job = self._jobs.get(job_id)
        return job.archipelagos.get(variable) if job is not None and job.state == "running" else None
