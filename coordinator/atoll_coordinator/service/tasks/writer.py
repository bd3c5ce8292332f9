"""What is done with the store away from the service's loop, in turn: checkpoints are written, tables checked."""

from collections.abc import Callable

from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.outcomes import CheckpointWritten, TableChecked


class CheckpointWriter:
    """Writes checkpoints and checks tables where `act` does what it is given, in its order; posts the outcomes."""

    def __init__(
        self, act: Callable[[Callable[[], None]], object], store: Store, post: Callable[[object], None]
    ) -> None:
        self._act = act
        self._store = store
        self._post = post

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable after those that came before it; `CheckpointWritten` is posted."""
        self._act(lambda: self._post(self._write(checkpoint, progress, elapsed)))

    def check_table(self, job: str, digest: str) -> None:
        """Read the table of a job, which takes a second for 100 MB; `TableChecked` is posted."""
        self._act(lambda: self._post(self._check_table(job, digest)))

    def _check_table(self, job: str, digest: str) -> TableChecked:
        try:
            return TableChecked(job, self._store.is_sound(digest))
        except Exception as error:  # ends the service's loop
            return TableChecked(job, False, error)

    def _write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> CheckpointWritten:
        """Make a checkpoint durable; runs in the writer's thread."""
        key = checkpoint.job, checkpoint.variable, checkpoint.epoch
        try:
            self._store.commit_checkpoint(*key, progress, checkpoint.states, elapsed)
        except Exception as error:  # ends the service's loop
            return CheckpointWritten(checkpoint, error)
        return CheckpointWritten(checkpoint)
