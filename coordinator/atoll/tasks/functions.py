"""The table of task functions by name: for each function its call and the modules and kernels that it needs."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from atoll_core.compilation.progress import Report, count_of
from atoll_core.wire.messages.tasks import AnalysisFunction, TaskFunction

if TYPE_CHECKING:
    from atoll_coordinator.model.batches import Batches

_LOG = logging.getLogger(__name__)

Call = Callable[[Sequence[bytes], float | None, "Batches"], bytes]
"""Runs a function with its inputs, its time limit in seconds (None: no limit), and the team for its batches."""


@dataclass(frozen=True, slots=True)
class TaskHandler:
    """`call` runs the function; `load` loads modules and compiles kernels; `ready` also loads them, for timed tasks.

    If kernels are not compiled, one process of the machine compiles them, and the others wait for its files.
    """

    load: Callable[[], None]
    ready: Callable[[], None]
    call: Call


def load_ahead() -> Iterator[None]:
    """Load the modules for preparing, yield, and load those for refining, in steps; forks inherit what is loaded.

    Kernels are also loaded if they are compiled; otherwise the tasks compile them, since this takes tens of seconds.
    """
    import atoll.tasks.process  # noqa: F401
    import atoll_coordinator.data.prepare
    import atoll_coordinator.tasks.preparing
    from atoll_core.compilation.cache import is_compiled

    has_kernels = is_compiled("atoll_coordinator")
    if has_kernels or is_compiled("atoll_coordinator", "preparing"):
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
    """Load the modules for preparing, and compile its kernels if needed; they are loaded when they are used."""
    import atoll_core.data.table  # noqa: F401
    from atoll_core.compilation.cache import is_compiled

    if not is_compiled("atoll_coordinator", "preparing"):
        ready_preparation()


def load_refinement() -> None:
    """Load modules and kernels for refining, compiled if needed; errors are only logged: refining raises them again."""
    try:
        import scipy.special  # noqa: F401

        import atoll_coordinator.model.pipeline  # noqa: F401
        from atoll_coordinator.warmup import warm_up

        warm_up(_log_of_progress())
    except Exception:
        _LOG.exception("warm-up failed")


def ready_preparation() -> None:
    """Load modules and kernels for preparing, compiled if needed; errors are logged: preparing raises them again."""
    try:
        import atoll_coordinator.model.sparse.laws  # noqa: F401
        from atoll_coordinator.warmup import warm_up_preparing

        warm_up_preparing(_log_of_progress())
    except Exception:
        _LOG.exception("warm-up failed")


def _log_of_progress() -> Report:
    """Return a function that logs messages of a warm-up: the counts between the first and the last for debugging only.

    So a log says whether this process compiles kernels, or waits while another process does so.
    """
    counts: set[tuple[int, int]] = set()

    def log(sentence: str) -> None:
        count = count_of(sentence)
        is_news = count is None or (not counts or count[0] == count[1])
        counts.update(() if count is None else (count,))
        _LOG.log(logging.INFO if is_news else logging.DEBUG, sentence)

    return log


def load_kernels_of_batches(function: str) -> None:
    """Compile the kernels for batches of other workers' tasks if needed; the batches of epochs load their own.

    Batches of preparing and of refining have the same functions, and most need only the kernels of preparing.
    """
    if function != "epochs":
        load_preparation()


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
