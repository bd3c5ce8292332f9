"""What broke: errors of ours that the coordinator met while it handled one event, and that end nothing but that.

They are counted; the first of each place in the code is logged with its traceback and noted among the events.
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
"""Places told apart at most, as in `atoll_core.wire.rejects`; what breaks elsewhere is counted alone."""


def what_to_send(config: JobConfig, *, is_certain: bool = True) -> str:
    """Return the end of a sentence: what a report of a job that broke must hold so that it can be repeated to the bit.

    Args:
        config: of the job.
        is_certain: whether a mistake of ours broke it, and not perhaps the machine, which may be short of memory.
    """
    blame = f"this is a mistake of Atoll {VERSION}, not of the data:" if is_certain else "if it does so again,"
    version = "" if is_certain else f"Atoll {VERSION}, "
    return (
        f"; {blame} please report it with this sentence, {version}the command or call, seed {config.seed} and the data "
        "as a file, or the rows that show it (from Python: pandas.DataFrame(data).to_csv('data.csv', index=False))"
    )


JobGuard = Callable[[str], AbstractContextManager[None]]
"""Given a job's id, lets what breaks end that job and nothing else."""


def unguarded(job_id: str) -> AbstractContextManager[None]:
    """Let what breaks over a job pass."""
    return contextlib.nullcontext()


class Breakages:
    """A counter of what broke. `note` is told a sentence of each new place."""

    def __init__(self, note: Callable[[str], object] = lambda sentence: None) -> None:
        self.total = 0
        self._note = note
        self._places: set[tuple[str, ...]] = set()

    def add(self, task: str, error: Exception, config: JobConfig | None = None) -> str:
        """Count an error that ended `task`, such as "taking in a report"; return the sentence for people.

        `config` is that of the job that ends by it, if one does: the sentence says what a report of that must hold.
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
            with contextlib.suppress(Exception):  # a note is good to have, and nothing more may break over it
                self._note(sentence)
        return sentence

    @contextlib.contextmanager
    def tolerated(self, task: str) -> Iterator[None]:
        """Let what breaks in `task` end nothing else, but a store that fails: then nothing can go on."""
        try:
            yield
        except StoreError:
            raise
        except Exception as error:
            self.add(task, error)
