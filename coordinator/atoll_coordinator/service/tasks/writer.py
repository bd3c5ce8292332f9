"""Makes checkpoints durable, one after the other, away from the service's loop."""

from collections.abc import Callable

from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.outcomes import CheckpointWritten


class CheckpointWriter:
    """Writes checkpoints where `act` does what it is given, in the order in which it came; posts the outcomes."""

    def __init__(
        self, act: Callable[[Callable[[], None]], object], store: Store, post: Callable[[object], None]
    ) -> None:
        self._act = act
        self._store = store
        self._post = post

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable after those that came before it; `CheckpointWritten` is posted."""
        self._act(lambda: self._post(self._write(checkpoint, progress, elapsed)))

    def _write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> CheckpointWritten:
        """Make a checkpoint durable; runs in the writer's thread."""
        key = checkpoint.job, checkpoint.variable, checkpoint.epoch
        try:
            self._store.commit_checkpoint(*key, progress, checkpoint.states, elapsed)
        except Exception as error:  # ends the service's loop
            return CheckpointWritten(checkpoint, error)
        return CheckpointWritten(checkpoint)
