"""Compares what a worker holds with what is placed on it, and returns the messages that set it right. Pure."""

from collections.abc import Collection, Container, Mapping

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import JobGuard, unguarded
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_core.wire.messages.epochs import PullReports
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    CloseJob,
    Commit,
    Placement,
    Placements,
    WorkerStatus,
)

Correction = Close | CloseJob | Commit | Placements | PullReports


def corrections(
    jobs: Mapping[str, Job],
    begun: Mapping[str, Job],
    worker: str,
    status: WorkerStatus,
    guarded: JobGuard = unguarded,
    ending: Container[str] = (),
) -> list[Correction]:
    """Return what a worker is sent after a heartbeat: what it may forget, what it lacks, pulls of lost reports.

    Of all live `jobs`, those that have `begun` can have placements. Of those that are `ending` nothing is said: they go
    on if we are killed before their ends are in the store.
    Each job is looked at under `guarded`, so that one over which something breaks leaves no other uncorrected.
    """
    messages: list[Correction] = []
    for assignment_status in status.holdings:
        if assignment_status.job in ending:
            continue
        with guarded(assignment_status.job):
            messages += _correct_assignment(jobs, worker, assignment_status)
    messages += [CloseJob(job=job) for job in status.jobs if job not in ending and not _is_open(jobs, job)]
    held = {(assignment_status.job, assignment_status.variable) for assignment_status in status.holdings}
    missing: list[Placement] = []
    for job_id, job in tuple(begun.items()):
        with guarded(job_id):
            missing += _missing(job, worker, held)
    return [*messages, Placements(placements=tuple(missing))] if missing else messages


def _missing(job: Job, worker: str, held: Collection[ArchipelagoKey]) -> list[Placement]:
    """Return the placements of a job that a worker has islands of and does not hold."""
    return [
        archipelago.placement
        for archipelago in job.open_archipelagos
        if archipelago.placement is not None and worker in archipelago.workers and archipelago.key not in held
    ]


def _correct_assignment(jobs: Mapping[str, Job], worker: str, assignment_status: AssignmentStatus) -> list[Correction]:
    job = jobs.get(assignment_status.job)
    if job is None or not _is_open(jobs, assignment_status.job):
        return [CloseJob(job=assignment_status.job)]
    archipelago = job.archipelagos.get(assignment_status.variable)
    if archipelago is None or job.state != "running":
        return []
    if archipelago.cut is not None:
        return [Close(job=assignment_status.job, variable=assignment_status.variable, term=assignment_status.term)]
    placement = archipelago.placement
    if placement is None or assignment_status.term > placement.term:
        return []
    if assignment_status.term < placement.term:
        return [Placements(placements=(placement,))]
    return _catch_up(worker, archipelago, assignment_status)


def _catch_up(worker: str, archipelago: Archipelago, assignment_status: AssignmentStatus) -> list[Correction]:
    """Return the pull of reports that were lost, and a commit that was."""
    messages: list[Correction] = []
    pull, commit = archipelago.missing_reports(worker, assignment_status), archipelago.commit()
    if pull is not None:
        messages.append(pull)
    if commit is not None and assignment_status.commit < commit.epoch:
        messages.append(commit)
    return messages


def _is_open(jobs: Mapping[str, Job], job_id: str) -> bool:
    """Tell whether islands of a job are computed now or will be."""
    job = jobs.get(job_id)
    return job is not None and job.state in ("queued", "preparing", "running")
