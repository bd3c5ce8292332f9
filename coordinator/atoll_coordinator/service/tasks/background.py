"""Work on large values, done in turn on a thread of its own: checkpoints are written, tables checked, results of tasks
read, and results of jobs composed that are not refined.

The service's loop answers everybody, so that it handles no more bytes at a time than one message has.
"""

from collections.abc import Callable
from dataclasses import replace

from atoll_coordinator.service.monitoring.drafts import Draft
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.outcomes import CheckpointWritten, JobPrepared, ResultComposed, TableChecked
from atoll_coordinator.service.tasks.results import ResultRead, TaskResult, read_result


class Background:
    """Has work done where `act` does what it is given, in the order in which it came; posts what comes of it."""

    def __init__(
        self, act: Callable[[Callable[[], None]], object], store: Store, post: Callable[[object], None]
    ) -> None:
        self._act = act
        self._store = store
        self._post = post

    def write_checkpoint(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable after those that came before it; `CheckpointWritten` is posted."""
        self._act(lambda: self._post(self._write_checkpoint(checkpoint, progress, elapsed)))

    def check_table(self, job: str, digest: str) -> None:
        """Read the table of a job, which takes a second for 100 MB; `TableChecked` is posted."""
        self._act(lambda: self._post(self._check_table(job, digest)))

    def read_result(self, result: TaskResult) -> None:
        """Read what came of a task, and keep what preparing a job gave; `ResultRead` is posted."""
        self._act(lambda: self._post(self._read_result(result)))

    def compose_result(self, draft: Draft) -> None:
        """Compose the result of a job, for which equations are judged on all rows; `ResultComposed` is posted."""
        self._act(lambda: self._post(self._compose_result(draft)))

    def _compose_result(self, draft: Draft) -> ResultComposed:
        try:
            return ResultComposed(draft, draft.compose())
        except Exception as error:  # ends the job
            return ResultComposed(draft, error=error)

    def _read_result(self, result: TaskResult) -> ResultRead:
        unread = replace(result, parts=())
        try:
            read = read_result(result)
            if isinstance(read.outcome, JobPrepared):
                made = read.outcome
                former = self._store.keep_prepared(made.job, made.data, made.encoded)
                read = replace(read, outcome=replace(made, data=b"", former=former))
            return replace(read, result=unread)
        except Exception as error:  # one of the store ends the service's loop, another one the job
            return ResultRead(unread, error=error)

    def _check_table(self, job: str, digest: str) -> TableChecked:
        try:
            return TableChecked(job, self._store.is_sound(digest))
        except Exception as error:  # ends the service's loop
            return TableChecked(job, False, error)

    def _write_checkpoint(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> CheckpointWritten:
        key = checkpoint.job, checkpoint.variable, checkpoint.epoch
        try:
            self._store.commit_checkpoint(*key, progress, checkpoint.states, elapsed)
        except Exception as error:  # ends the service's loop
            return CheckpointWritten(checkpoint, error)
        return CheckpointWritten(checkpoint)
