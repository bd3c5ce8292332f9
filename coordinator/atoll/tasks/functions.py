"""The table of task functions by name: for each function its call and the modules and kernels that it needs."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from atoll_core.wire.messages.tasks import AnalysisFunction, TaskFunction

if TYPE_CHECKING:
    from atoll_coordinator.model.batches import Batches

_LOG = logging.getLogger(__name__)

Call = Callable[[Sequence[bytes], float | None, "Batches"], bytes]
"""Runs a function with its inputs, its time limit in seconds (None: no limit), and the team for its batches."""


@dataclass(frozen=True, slots=True)
class TaskHandler:
    """`call` runs the function; `load` loads modules and kernels; `ready` also compiles kernels, for timed tasks."""

    load: Callable[[], None]
    ready: Callable[[], None]
    call: Call


def load_ahead() -> Iterator[None]:
    """Load the modules for preparing, yield, and load those for refining, in steps; forks inherit what is loaded.

    Kernels are also loaded if they are compiled; otherwise they are left to the tasks, since compiling takes tens of
    seconds.
    """
    import atoll.tasks.process  # noqa: F401
    import atoll_coordinator.data.prepare
    import atoll_coordinator.tasks.preparing
    from atoll_core.compilation.cache import is_compiled

    has_kernels = is_compiled("atoll_coordinator")
    if has_kernels:
        ready_preparation()
    yield
    import scipy.special  # noqa: F401

    yield
    import atoll_coordinator.model.pipeline
    import atoll_coordinator.tasks.refining  # noqa: F401

    yield
    if has_kernels:
        load_refinement()


def load_preparation() -> None:
    """Load the modules for preparing; its kernels are loaded when they are needed."""
    import atoll_core.data.table  # noqa: F401


def load_refinement() -> None:
    """Load modules and kernels for refining, compiled if needed; errors are only logged: refining raises them again."""
    try:
        import scipy.special  # noqa: F401

        import atoll_coordinator.model.pipeline  # noqa: F401
        from atoll_coordinator.warmup import warm_up

        warm_up(_LOG.debug)
    except Exception:
        _LOG.exception("warm-up failed")


def ready_preparation() -> None:
    """Load modules and kernels for preparing, compiled if needed; errors are logged: preparing raises them again."""
    try:
        load_preparation()
        import atoll_coordinator.model.sparse.laws  # noqa: F401
        from atoll_coordinator.data.differentiation.derivatives import warm_up as warm_up_data
        from atoll_coordinator.model.sparse.warmup import warm_up as warm_up_sparse

        warm_up_data()
        warm_up_sparse()
    except Exception:
        _LOG.exception("warm-up failed")


def _prepare(inputs: Sequence[bytes], seconds: float | None, team: "Batches") -> bytes:
    from atoll_coordinator.tasks.preparing import prepare

    table, specification = inputs
    return prepare(table, specification, batches=team)


def _refine(inputs: Sequence[bytes], seconds: float | None, team: "Batches") -> bytes:
    from atoll_coordinator.model.pipeline import refine_all
    from atoll_coordinator.tasks.refining import refine

    prepared, pools = inputs
    return refine(prepared, pools, seconds, partial(refine_all, batches=team))


def load_analyses() -> None:
    """Load the modules of all analyses; kernels are loaded when they are needed."""
    import atoll.tasks.analyses  # noqa: F401


def _analysis(function: AnalysisFunction) -> TaskHandler:
    def call(inputs: Sequence[bytes], seconds: float | None, team: "Batches") -> bytes:
        from atoll.tasks.analyses import analyse
        from atoll_coordinator.model.batches import spreading
        from atoll_coordinator.model.deadline import Deadline

        result, question, *tables = inputs
        with spreading(team, team.threads, Deadline(seconds)) as spread:
            return analyse(function, result, question, tables[0] if tables else None, spread)

    return TaskHandler(load_analyses, load_analyses, call)


FUNCTIONS: Final[Mapping[TaskFunction, TaskHandler]] = {
    "prepare": TaskHandler(load_preparation, ready_preparation, _prepare),
    "refine": TaskHandler(load_refinement, load_refinement, _refine),
    "analyse": _analysis("analyse"),
    "profile": _analysis("profile"),
    "suggest": _analysis("suggest"),
    "report": _analysis("report"),
}
