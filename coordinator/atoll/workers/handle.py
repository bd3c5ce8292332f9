"""What `start_on` returns: the island workers of a cluster, which can be looked at and ended."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from atoll.workers.program import ending
from atoll_core.errors import AtollError


@dataclass(frozen=True)
class MachineWorkers:
    """The program on one machine: how many worker processes it keeps, and its exit code, None while it runs."""

    processes: int
    exit_code: int | None


class Handle(ABC):
    """Island workers that were started on a cluster; a context manager that ends them."""

    @abstractmethod
    def machines(self) -> Mapping[str, MachineWorkers]:
        """Return the programs by the machine's name in the cluster: a Dask worker's address, a Ray node's id."""

    @abstractmethod
    def close(self) -> None:
        """End all of them: each hands over its islands first. Repeatable; machines that come later get none."""

    def check(self) -> None:
        """Raise AtollError when the program has ended on a machine, with the reason that its exit code gives."""
        for name, workers in self.machines().items():
            if workers.exit_code is not None:
                raise AtollError(
                    f"the island workers of {name} have {ending(workers.exit_code)}; the log of that machine's process "
                    "in the cluster says more"
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
