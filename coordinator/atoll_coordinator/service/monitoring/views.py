"""What people are shown of a job: its view, also while it runs. Pure."""

import json
from collections.abc import Sequence
from typing import Any, Literal, cast

from pydantic import ValidationError

from atoll_coordinator.model.result.result import KNOWN, VariableOutcome, equation_of
from atoll_coordinator.result.base import finite
from atoll_coordinator.service.jobs.checks import DAMAGED_RECORD
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.scheduling.job_queue import JobQueue
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.cut import Improvement
from atoll_coordinator.service.search.ending import Why
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core import VERSION
from atoll_core.config import JobConfig
from atoll_core.expression.text.infix import to_infix
from atoll_core.wire.messages.views import FINAL_STATES, JobCounters, JobState, JobView, VariableView


def outcomes_of(job: Job) -> list[VariableOutcome]:
    """Return how the searches of a job stand or ended; known equations as well.

    They come in the order of the dataset.
    """
    if job.prepared is None:
        return []
    outcomes = {name: outcome_of(archipelago) for name, archipelago in job.archipelagos.items()}
    outcomes |= {name: VariableOutcome(name, (entry,), 0, why=KNOWN) for name, entry in job.prepared.known.items()}
    order = [name for name in job.prepared.dataset.variables if name in outcomes]
    return [outcomes[name] for name in order]


def outcome_of(archipelago: Archipelago) -> VariableOutcome:
    """Return how the search of one equation ended, or how it stands after the epochs that are complete."""
    cut = archipelago.cut
    if cut is not None:
        pool = cut.pool()
        return VariableOutcome(
            archipelago.variable, pool.front, cut.epochs, cut.generation, cut.evaluations, cut.seconds, cut.why,
            runners_up=pool.runners_up,
            convergence={convergence.island: _steps(convergence.improvements) for convergence in cut.convergence},
        )  # fmt: skip
    state = archipelago.collector.state
    return VariableOutcome(
        archipelago.variable, state.front, state.epochs, None, state.evaluations, state.seconds,
        runners_up=state.runners_up,
        convergence={island: _steps(improvements) for island, improvements in state.convergence.items()},
    )  # fmt: skip


def _steps(improvements: Sequence[Improvement]) -> tuple[tuple[int, float], ...]:
    return tuple((improvement.generation, improvement.error) for improvement in improvements)


def job_view(
    job: Job, queue: JobQueue, now: float, waiting_reason: str | None, counters: JobCounters,
    stalls: tuple[str, ...],
) -> JobView:  # fmt: skip
    """Return what `jobs` and `status` show of a live job, or of one that ends now.

    Equations are not judged: that looks at every row of the data, and is done where the result is composed.

    Args:
        job: a live one, or one that ends now.
        queue: in which it waits, if it does.
        now: the bus's seconds.
        waiting_reason: what its archipelagos without workers wait for, in words, if there are any.
        counters: of this job.
        stalls: why its archipelagos stand still, in words.
    """
    outcomes = outcomes_of(job)
    evaluations = sum(sum(outcome.evaluations.values()) for outcome in outcomes)
    seconds = job.search_seconds(now)
    prepared = job.prepared if job.result_text is None else None  # else they are shown as the result has them
    variables = tuple(_variable_view(prepared, outcome) for outcome in outcomes) if prepared else ()
    return JobView(
        job=job.id,
        name=job.name,
        state=job.state,
        seed=job.config.seed,
        preset=job.config.preset,
        reason=job.reason or queue.waiting_reason(job.id) or waiting_reason,
        fault=job.fault,
        warnings=job.prepared.dataset.warnings if job.prepared else (),
        notes=job.prepared.dataset.notes if job.prepared else (),
        submitted=job.submitted,
        elapsed=now - job.submitted_at,
        workers=len({worker for archipelago in job.open_archipelagos for worker in archipelago.workers}),
        point_evaluations=evaluations,
        point_evaluations_per_second=evaluations / seconds if seconds > 0.0 and evaluations else None,
        variables=variables,
        priority=job.priority,
        ahead=queue.ahead_of(job.id),
        stalls=stalls,
        counters=counters,
        target_error=job.config.budget.target_error,
        submitter=job.submitter,
        shared=job.is_shared,
        paused=job.is_paused,
        held=job.is_held,
    )


def ended_view(record: JobRecord, result: str | None) -> JobView:
    """Return the view of a job that ended before this coordinator started, from what was stored.

    Without a result that this version can read, it has no equations, and a warning says so.
    """
    seed, preset, target_error = _stored_settings(record.spec)
    view = JobView(
        job=record.id,
        name=record.name,
        state=cast(JobState, record.state),
        seed=seed,
        preset=preset,
        reason=record.reason,
        submitted=record.submitted,
        elapsed=record.elapsed,
        workers=0,
        point_evaluations=0,
        variables=(),
        priority=record.priority,
        target_error=target_error,
        submitter=record.submitter,
        shared=bool(record.shared),
    )
    return view if result is None else with_equations(view, result)


def with_equations(view: JobView, result: str) -> JobView:
    """Return a view with the equations of a result, as JSON; one that this version cannot read gives a warning."""
    try:
        return JobView.model_validate(dict(view) | _stored_equations(json.loads(result)))
    except (ValueError, KeyError, TypeError):
        warning = f"the stored result of this job cannot be read by version {VERSION}"
        return view.model_copy(update={"warnings": (warning,)})


def view_of_record(record: JobRecord, warning: str) -> JobView:
    """Return the view of a job that cannot be shown whole, from its record alone; it never raises.

    Of a damaged record only what is sure is shown: one that says that its job goes on is of a job that failed.
    """
    try:
        return ended_view(record, None).model_copy(update={"warnings": (warning,)})
    except Exception:
        is_final = record.state in FINAL_STATES
        return JobView(
            job=str(record.id),
            name=str(record.name),
            state=cast(JobState, record.state) if is_final else "failed",
            seed=0,
            preset="default",
            reason=DAMAGED_RECORD,
            warnings=(warning,),
            submitted=str(record.submitted),
            elapsed=0.0,
            workers=0,
            point_evaluations=0,
        )


def _stored_equations(result: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a view that are in a result, which is read from JSON."""
    return {
        "warnings": tuple(result["warnings"]),
        "notes": tuple(result.get("notes", ())),
        "point_evaluations": result["point_evaluations"],
        "variables": tuple(_stored_variable_view(equation) for equation in result["equations"]),
    }


def _stored_settings(spec: str) -> tuple[int, str, float | None]:
    """Return seed, preset and target error of a stored job; defaults where another version wrote something else."""
    try:
        config = JobConfig.model_validate_json(spec)
    except ValidationError:
        config = JobConfig()
    return config.seed, config.preset, config.budget.target_error


def _variable_view(prepared: Prepared, outcome: VariableOutcome) -> VariableView:
    target = prepared.dataset.problem(outcome.variable).target
    target_error = prepared.config.budget.target_error
    view = VariableView(
        variable=outcome.variable,
        lhs=target.lhs,
        epoch=outcome.epoch,
        point_evaluations=sum(outcome.evaluations.values()),
        finished=outcome.why is not None,
        why=cast(Why | Literal["known"] | None, outcome.why),
    )
    shown = equation_of(outcome, None, prepared.dataset, prepared.config)
    if shown is None:
        return view
    normalized = finite(shown.error / target.standard_deviation) if target.standard_deviation else None
    return view.model_copy(
        update={
            "error": finite(shown.error),
            "normalized_error": normalized,
            "complexity": len(shown.program),
            "expression": to_infix(shown.program, prepared.dataset.names),
            "converged": normalized is not None and normalized <= target.convergence_threshold(target_error),
        }
    )


def _stored_variable_view(equation: dict[str, Any]) -> VariableView:
    fields = ("variable", "lhs", "epoch", "error", "normalized_error", "complexity", "expression", "converged", "why")
    known = {name: equation[name] for name in fields} | {"verdict": equation.get("verdict")}
    return VariableView.model_validate({**known, "point_evaluations": equation["point_evaluations"], "finished": True})
