"""Takes one job from its table to its result, with the tasks on an executor. The driver runs in the caller's thread.

How it works. The states of the job, the end of its search and its result are those of the service: `Job`, `Collector`
and `draft_of` are used as they are, and `JobDriver` carries out their actions. Preparing and refining run in one task
process next to the driver, which gives batches of its work to the executor, as a worker of the service gives them to
helpers. The islands of each archipelago are divided into as many groups as there are workers for them; one epoch of one
group is a batch, too. When all groups have finished an epoch, the driver passes the emigrants on, and the next epoch
begins. All events arrive in one inbox: finished calls, messages of the task process, written equations, and the passing
of time. The equations of the display are written by a thread, as on the service (`view_equations`).

An epoch begins when the epoch before it is merged. So no epoch is computed in vain, and there is neither a checkpoint
nor a commit: the driver has the states of all islands. *Doubts.* They are lost with the caller's process.
"""

import contextlib
import hashlib
import itertools
import os
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from atoll.client.follower import KEEPING, Display
from atoll.executors.dispatcher import Computed, Dispatcher, Finished
from atoll.executors.epochs import EPOCHS, JOB, ComputedEpoch, SearchedJob
from atoll.executors.tasks import StopSign, borrowed_process, what_to_do
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.result.result import timed
from atoll_coordinator.service.jobs.checks import epoch_limit_reason
from atoll_coordinator.service.jobs.job import Job, JobAction, Refine
from atoll_coordinator.service.monitoring.breakages import ask_for_report
from atoll_coordinator.service.monitoring.job_views import (
    draft_of,
    job_view,
    outcomes_of,
    variable_views,
    with_equations,
)
from atoll_coordinator.service.monitoring.view_equations import FrontWritten, ViewEquations, ViewFront
from atoll_coordinator.service.scheduling.job_queue import JobQueue
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.tasks.background import iso_now
from atoll_coordinator.service.tasks.task_controller import HELP_AFTER_S
from atoll_coordinator.service.tasks.task_table import MOST_THREADS
from atoll_coordinator.tasks.preparing import PreparationOutcome
from atoll_coordinator.tasks.refining import Searched
from atoll_core import task_frames as frames
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError, DataError
from atoll_core.machine import usable_cores
from atoll_core.wire.messages.epochs import EpochReport
from atoll_core.wire.messages.tasks import TaskFunction
from atoll_core.wire.messages.views import JobCounters, TaskView, Workforce
from atoll_core.wire.messages.workers import Placement
from atoll_core.wire.values import decode_value, encode_value
from atoll_island_worker.session.interface import EpochTask, TaskKey
from atoll_island_worker.tasks.task_process import TaskProcess

_TICK_S: Final = 0.2
"""Longest interval between two looks at the clock, in seconds."""

_EXECUTOR: Final = "executor"
"""The name of the worker that has all islands, for the collector."""


_TERM: Final = 1
"""The term of all placements: the executor keeps all islands to the end."""


_tokens: Final = itertools.count()
"""Numbers of requests for a batch; an answer to a request for an earlier task is ignored."""


class _EpochTag(NamedTuple):
    """One epoch of some islands of an archipelago."""

    variable: str
    epoch: int
    islands: tuple[int, ...]


class _BatchTag(NamedTuple):
    """A batch of a task: its number, unique among the batches of all task processes."""

    number: int


@dataclass(frozen=True, slots=True)
class SubmittedTable:
    """A job: its id, the name of its data for the result, its configuration, and its encoded table."""

    job: str
    name: str
    config: JobConfig
    table: bytes


def solve(
    submitted: SubmittedTable, executor: object, workers: int | None = None, display: Display | None = None,
    stop: StopSign | None = None,
) -> str:  # fmt: skip
    """Return the result of a job as JSON; after Ctrl-C, the result with the best equations so far.

    Args:
        submitted: the job.
        executor: see `executors.adapted`.
        workers: the number of calls at the same time; None: as many as the executor has workers.
        display: shows the progress; None: the progress is not shown.
        stop: ends the job with an AtollError when it is set.

    Raises:
        DataError: the data cannot be used.
        AtollError: the job failed, or the executor is broken.
        KeyboardInterrupt: before the data were prepared.
    """
    with Dispatcher(executor, workers) as dispatcher:
        return JobDriver(submitted, dispatcher, display, stop).solve()


class _TaskFailedError(AtollError):
    """Raised when a task of the task process has failed twice; `failure` is its kind."""

    def __init__(self, failure: frames.Failure, sentence: str) -> None:
        super().__init__(sentence)
        self.failure: Final = failure


class JobDriver:
    """One job on an executor."""

    def __init__(
        self, submitted: SubmittedTable, dispatcher: Dispatcher, display: Display | None = None,
        stop: StopSign | None = None,
    ) -> None:  # fmt: skip
        """See `solve`."""
        self._spec, self._table = submitted.config.model_dump_json(), submitted.table
        record = JobRecord(
            submitted.job, submitted.name, self._spec, hashlib.sha256(self._table).hexdigest(), iso_now()
        )
        self.job: Final = Job(record, submitted.config, time.monotonic())
        self._encoded = self._searched = b""
        self._dispatcher: Final = dispatcher
        self._inbox: Final = dispatcher.inbox
        self._display = display
        self._stop = stop
        self._shown_at = 0.0
        self._equations = ViewEquations(self._write_front)
        self._task: TaskView | None = None
        self._refine_within: float | None = None
        self._waiting: dict[str, set[int]] = {}
        self._states: dict[str, dict[int, bytes]] = {}
        self._emigrants: dict[str, dict[int, Mapping[int, bytes]]] = {}

    def solve(self) -> str:
        """See the function `solve`."""
        try:
            self._prepare()
            self._search()
            self._refine()
        except KeyboardInterrupt:
            self._carry_out(self.job.cancel())
            if self.job.prepared is None:
                raise
            if self._display is not None:
                self._display.print_note(KEEPING)
        text = None if self.job.state == "failed" else self._result()
        self._show_progress(text, is_last=True)
        if text is None:
            raise (DataError if self.job.fault == "data" else AtollError)(str(self.job.reason))
        return text

    # ------------------------------------------------------------------------------------------- the three stages

    def _prepare(self) -> None:
        config = self.job.config
        self.job.start_preparing()
        try:
            inputs = (self._table, self._spec.encode())
            data = self._run_task("prepare", inputs, config.budget.max_time)
        except _TaskFailedError as error:
            self.job.fail("internal", f"preparing the data failed ({error}){self._advice(error.failure)}")
            return
        if data is None:
            return
        outcome = decode_value(data, PreparationOutcome)
        if not outcome.is_prepared:
            self.job.fail("data", outcome.sentence)
            return
        prepared = outcome.prepared
        self._encoded = outcome.encoded
        self._searched = encode_value(SearchedJob(prepared.config, outcome.data))
        unknown = epoch_limit_reason(config, prepared)
        actions = self.job.start(prepared, {}, self._now()) if unknown is None else self.job.fail("data", unknown)
        self._carry_out(actions)

    def _search(self) -> None:
        now = self._now()
        for archipelago in self.job.open_archipelagos:
            limits = archipelago.collector.limits
            workers = (_EXECUTOR,) * limits.islands
            archipelago.place(Placement(
                incarnation=1, term=_TERM, job=self.job.id, variable=archipelago.variable, workers=workers,
                epochs=limits.epochs, interval=limits.epochs, commit_order=limits.commit_order,
            ), now)  # fmt: skip
        if self.job.state == "running":
            self.job.start_search(now)
        while self.job.state == "running":
            for archipelago in self.job.open_archipelagos:
                if not self._waiting.get(archipelago.variable):
                    self._begin_epoch(archipelago)
            match self._next():
                case Computed(tag=_EpochTag() as tag) as computed:
                    self._add_epoch(tag, computed)
        self._dispatcher.cancel()

    def _refine(self) -> None:
        if self.job.state != "refining":
            return
        searched = Searched(self.job.id, tuple(outcomes_of(self.job)))
        try:
            text = self._run_task("refine", (self._encoded, searched.to_bytes()), self._refine_within)
        except _TaskFailedError as error:
            warning = f"Refining failed ({error}); equations are as the search found them{self._advice(error.failure)}."
            self.job.finish_unrefined(Refinement(warnings=(warning,), end="not refined"))
            return
        if text is not None:
            self.job.finish(text.decode())

    def _result(self) -> str:
        job = self.job
        text = job.result_text
        if text is None:
            draft = draft_of(job)
            assert draft is not None
            text = draft.compose()
        return timed(text, self._now() - job.submitted_at)

    def _advice(self, failure: frames.Failure) -> str:
        """Return the end of a sentence about a failure: what to do."""
        return what_to_do(failure) or ask_for_report(self.job.config, is_certain=failure == "error")

    # ------------------------------------------------------------------------------------------------- the search

    def _begin_epoch(self, archipelago: Archipelago) -> None:
        """Submit the next epoch of an archipelago, in groups of islands."""
        limits, variable = archipelago.collector.limits, archipelago.variable
        epoch = archipelago.collector.state.epochs
        states, emigrants = self._states.pop(variable, {}), self._emigrants.pop(variable, {})
        groups = min(limits.islands, -(-self._dispatcher.workers // len(self.job.open_archipelagos)))
        self._waiting[variable] = set(range(limits.islands))
        for group in range(groups):
            islands = range(group * limits.islands // groups, (group + 1) * limits.islands // groups)
            tasks = tuple(
                EpochTask(
                    TaskKey(JOB, variable, _TERM, island, epoch),
                    {source: blocks[island] for source, blocks in emigrants.items() if island in blocks} or None,
                    epoch + 1 >= limits.epochs, limits.commit_order, states.get(island),
                )
                for island in islands
            )  # fmt: skip
            tag = _EpochTag(variable, epoch, tuple(islands))
            self._dispatcher.submit(tag, "batch", (EPOCHS.name, EPOCHS.encode([tasks])), self._searched)

    def _add_epoch(self, tag: _EpochTag, computed: Computed) -> None:
        """Add the result of a group of islands."""
        archipelago = self.job.open_archipelago(tag.variable)
        if archipelago is None:
            return
        epoch = ComputedEpoch(sentence=computed.sentence) if computed.sentence else EPOCHS.decode(computed.value)[0]
        if epoch.sentence:
            self._carry_out(self.job.fail("internal", epoch.sentence + self._advice(computed.failure)))
            return
        self._waiting[tag.variable] -= set(tag.islands)
        self._states.setdefault(tag.variable, {}).update(epoch.states)
        self._emigrants.setdefault(tag.variable, {}).update({one.key.island: one.emigrants for one in epoch.islands})
        islands = tuple(one.report for one in epoch.islands)
        report = EpochReport(job=self.job.id, variable=tag.variable, term=_TERM, epoch=tag.epoch, islands=islands)
        self._carry_out(self.job.add_report(_EXECUTOR, report, self._now()))
        archipelago.collector.forget(archipelago.collector.state.epochs)
        if archipelago.cut is not None:
            self._dispatcher.cancel(lambda other: other.variable != tag.variable)

    # -------------------------------------------------------------------------------------------------- the tasks

    def _run_task(self, function: TaskFunction, inputs: tuple[bytes, ...], seconds: float | None) -> bytes | None:
        """Return the result of a task; None: the job has ended before, by its time limit.

        A task is tried twice, as on the service. Raises _TaskFailedError after the second failure.
        """
        failed: list[frames.Failure] = []
        while True:
            with borrowed_process(self._inbox) as process:
                threads = min(MOST_THREADS, self._dispatcher.workers, usable_cores(os.environ)[0])
                life = process.send(frames.Run(function, function, inputs, seconds, threads, self.job.id))
                end = self._follow_task(process, function, life)
                self._task = None
                if end is None:
                    process.stop()
            self._dispatcher.cancel()
            match end:
                case frames.Failed(failure=failure, sentence=sentence) | frames.Ended(failure=failure, why=sentence):
                    failed.append(failure)
                    if len(failed) > 1:
                        raise _TaskFailedError(failure, sentence + (", twice" if len({*failed}) == 1 else ""))
                case _:
                    return None if end is None else end.result

    def _follow_task(
        self, process: TaskProcess, function: TaskFunction, life: int
    ) -> frames.TaskFinished | frames.Failed | frames.Ended | None:
        """Give batches of a task to the executor until the task ends, and return its end; None: the job has ended."""
        begun_at: float | None = None
        helpers = self._dispatcher.workers if self._dispatcher.workers > 1 else 0
        asked: set[int] = set()
        given: set[int] = set()
        self._task = TaskView(function=function)
        while not self.job.has_ended:
            if begun_at is not None and self._now() - begun_at >= HELP_AFTER_S:
                for token in itertools.islice(_tokens, helpers - len(asked) - len(given)):
                    process.send(frames.Ask(token))
                    asked.add(token)
            match self._next():
                case Computed(tag=_BatchTag(number=number), value=value, sentence=sentence):
                    given.discard(number)
                    process.send(frames.Take(number, None if sentence else value))
                case frames.ProcessMessage(life=of, message=message) if of == life:
                    match message:
                        case frames.Begun():
                            begun_at = self._now()
                            self._carry_out(self.job.start_clock(begun_at))
                        case frames.Give(token=token, batch=batch) if token in asked:
                            asked.remove(token)
                            if batch is not None:
                                given.add(batch.number)
                                self._submit_batch(batch)
                        case frames.TaskFinished() | frames.Failed() | frames.Ended():
                            return message
        return None

    def _submit_batch(self, batch: frames.TaskBatch) -> None:
        self._dispatcher.submit(_BatchTag(batch.number), "batch", (batch.function, batch.item), batch.context)

    # ------------------------------------------------------------------------------------------------- the events

    def _next(self) -> object:
        """Return the next event, None if there is none for a while; let time pass."""
        if self._stop is not None and self._stop.is_set:
            raise AtollError("the caller has ended before the result was ready")
        event: object = None
        with contextlib.suppress(queue.Empty):
            event = self._inbox.get(timeout=_TICK_S)
        match event:
            case Finished():
                event = self._dispatcher.take(event)
            case FrontWritten():
                self._equations.add_written(event, self.job)
            case frames.ProcessMessage(message=frames.Progressed(compared=compared)) if self._task is not None:
                self._task = self._task.model_copy(update={"compared": compared})
        self._carry_out(self.job.tick(self._now()))
        self._show_progress()
        return event

    def _carry_out(self, actions: Sequence[JobAction]) -> None:
        """Note within which time the job is to be refined; the other actions concern stores and workers."""
        for action in actions:
            if isinstance(action, Refine):
                self._refine_within = action.seconds

    def _show_progress(self, result: str | None = None, *, is_last: bool = False) -> None:
        """Show the job, at most once in `_TICK_S`, or, if `is_last`, at its end with its `result`."""
        now = self._now()
        if self._display is None or not (is_last or now - self._shown_at >= _TICK_S):
            return
        self._shown_at = now
        view = job_view(self.job, JobQueue(), now, None, JobCounters(), ())
        if result is not None:
            view = with_equations(view, result)
        elif not is_last:
            tasks = () if self._task is None else (self._task,)
            variables = variable_views(self.job, self._equations)
            view = view.model_copy(update={"variables": variables, "tasks": tasks})
        # The islands have one worker for the collector; shown are the workers of the executor.
        workforce = Workforce(alive=self._dispatcher.workers)
        self._display.show(view.model_copy(update={"workers": 0}), workforce, now)

    def _write_front(self, front: ViewFront) -> None:
        """Write an equation for the display in a thread, because this takes 0.1 to 0.25 s."""
        thread = threading.Thread(target=lambda: self._inbox.put(front.write()), name="writing equations", daemon=True)
        thread.start()

    def _now(self) -> float:
        return time.monotonic()
