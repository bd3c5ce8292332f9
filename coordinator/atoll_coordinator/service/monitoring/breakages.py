"""Breakages: errors of this program while the coordinator handled an event, which end nothing else.

They are counted; the first one at each place in the code is logged with its traceback and recorded as an event.
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
"""Places that are distinguished, as in `atoll_core.wire.rejects`; errors at further places are only counted."""


def what_to_send(config: JobConfig, *, is_certain: bool = True) -> str:
    """Return the end of a sentence that lists the contents of a bug report, so that the error in a job can be
    reproduced.

    Args:
        config: of the job.
        is_certain: whether this program is certainly the cause; otherwise it may be a machine that is short of memory.
    """
    blame = f"this is a mistake of Atoll {VERSION}, not of the data:" if is_certain else "if it does so again,"
    version = "" if is_certain else f"Atoll {VERSION}, "
    return (
        f"; {blame} please report it with this sentence, {version}the command or call, seed {config.seed} and the data "
        "as a file, or the rows that show it (from Python: pandas.DataFrame(data).to_csv('data.csv', index=False))"
    )


JobGuard = Callable[[str], AbstractContextManager[None]]
"""Context for the id of a job, in which an error ends that job and nothing else."""


def unguarded(job_id: str) -> AbstractContextManager[None]:
    """Let errors pass."""
    return contextlib.nullcontext()


class Breakages:
    """A counter of errors. `note` gets a sentence about the first error at each place."""

    def __init__(self, note: Callable[[str], object] = lambda sentence: None) -> None:
        self.total = 0
        self._note = note
        self._places: set[tuple[str, ...]] = set()

    def add(self, task: str, error: Exception, config: JobConfig | None = None) -> str:
        """Count an error that ended `task`, such as "adding a report"; return a sentence about it.

        With the `config` of a job that ends by it, the sentence lists the contents of a bug report.
        """
        self.total += 1
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno}" if frames else "nowhere"
        sentence = f"{task} broke ({type(error).__name__}: {error})"[:1000] + f" at {where}"
        if config is None:
            sentence += ", which is a mistake of ours; please report it with the log of the coordinator"
        else:
            sentence += what_to_send(config)
        place = (task, type(error).__name__, where)
        if place not in self._places and len(self._places) < MAX_PLACES:
            self._places.add(place)
            _LOG.error("broke", extra=fields(task=task), exc_info=error)
            with contextlib.suppress(Exception):  # an error in this report must not end anything
                self._note(sentence)
        return sentence

    @contextlib.contextmanager
    def tolerated(self, task: str) -> Iterator[None]:
        """Let an error in `task` end nothing else, except a StoreError: without a store the coordinator cannot
        continue."""
        try:
            yield
        except StoreError:
            raise
        except Exception as error:
            self.add(task, error)
