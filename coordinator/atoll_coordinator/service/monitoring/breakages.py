"""Breakages: internal errors of the coordinator, which must not end its loop.

Breakages are counted. The first breakage at each place in the code is logged with its traceback and recorded as an
event.
"""

import contextlib
import logging
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Final

from atoll_core import VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.logs import fields

_LOG = logging.getLogger(__name__)

MAX_PLACES: Final = 1000
"""Largest number of places that are distinguished; errors at further places are only counted."""


def ask_for_report(config: JobConfig, *, is_certain: bool = True) -> str:
    """Return the end of a sentence about an error in a job. It lists what a bug report needs to reproduce the error.

    Args:
        config: the configuration of the job.
        is_certain: whether Atoll is certainly the cause; otherwise the machine may have too little memory.
    """
    blame = f"this is a bug in Atoll {VERSION}, not an error in the data:" if is_certain else "if this happens again,"
    version = "" if is_certain else f"Atoll {VERSION}, "
    return (
        f"; {blame} please report it with this sentence, {version}the command or call, seed {config.seed} and the data "
        "as a file, or the rows that show it (from Python: pandas.DataFrame(data).to_csv('data.csv', index=False))"
    )


JobGuard = Callable[[str], AbstractContextManager[None]]
"""Returns a context for the id of a job; an error within this context ends only that job."""


def unguarded(job_id: str) -> AbstractContextManager[None]:
    """Return a context that does not catch errors."""
    return contextlib.nullcontext()


class Breakages:
    """A counter of internal errors. `note` is called with a sentence about the first error at each place."""

    def __init__(self, note: Callable[[str], object] = lambda sentence: None) -> None:
        self.total = 0
        self._note = note
        self._places: set[tuple[str, ...]] = set()

    def add(self, task: str, error: Exception, config: JobConfig | None = None) -> str:
        """Count an error during `task`, such as "adding a report"; return a sentence about the error.

        With the `config` of a job that fails by this error, the sentence lists what a bug report needs.
        """
        self.total += 1
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno}" if frames else "nowhere"
        sentence = f"{task} failed ({type(error).__name__}: {error})"[:1000] + f" at {where}"
        if config is None:
            sentence += ", which is a bug in Atoll; please report it with the log of the coordinator"
        else:
            sentence += ask_for_report(config)
        place = (task, type(error).__name__, where)
        if place not in self._places and len(self._places) < MAX_PLACES:
            self._places.add(place)
            _LOG.error("internal error", extra=fields(task=task), exc_info=error)
            with contextlib.suppress(Exception):  # an error in recording this must not end the loop
                self._note(sentence)
        return sentence

    @contextlib.contextmanager
    def tolerated(self, task: str) -> Iterator[None]:
        """Count errors in `task` instead of raising them, except a StoreError: without its store the coordinator
        ends."""
        try:
            yield
        except StoreError:
            raise
        except Exception as error:
            self.add(task, error)
