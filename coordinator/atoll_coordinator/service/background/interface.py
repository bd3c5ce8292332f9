"""Where errands are done: what takes long for one job, and must not keep the service's loop waiting."""

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from atoll.errors import AtollError

T = TypeVar("T")


class StoppedError(AtollError):
    """Raised when an errand was stopped: nobody waits for what would have come of it."""


class LostError(AtollError):
    """Raised when an errand cannot be done because its process died, and again; a few words that name the cause."""


class Errands(Protocol):
    """A place where errands are done: functions of modules with what they are called with, as `functools.partial`.

    Its methods may be called from any thread.
    """

    def do(self, job: str, errand: Callable[[], T]) -> T:
        """Do it, wait for it and return what it returns; raises StoppedError and LostError."""

    def do_in_turn(self, job: str, errand: Callable[[], T]) -> T:
        """Do the same, after those that came before where the machine has not room for all."""

    def expect(self, errand: Callable[[], None]) -> None:
        """Do what makes later errands quicker; another thread may do it, and nobody waits for it then."""

    def stop(self, job: str) -> None:
        """End the errands of a job at once."""

    def close(self) -> None:
        """End all errands at once; those that come later are stopped too."""


class Here:
    """Errands are done by the thread that wants them, and cannot be stopped."""

    def do(self, job: str, errand: Callable[[], T]) -> T:
        """See `Errands.do`."""
        return errand()

    def do_in_turn(self, job: str, errand: Callable[[], T]) -> T:
        """See `Errands.do_in_turn`."""
        return errand()

    def expect(self, errand: Callable[[], None]) -> None:
        """See `Errands.expect`."""
        errand()

    def stop(self, job: str) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


HERE: Final = Here()
