"""Preparing a job as a task: its table and configuration in, what the search and refining need out."""

import hashlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.pools import LawsByGroup
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import DataError, RemoteProtocolError, UsageError
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.codec import dataset_to_bytes
from atoll_core.wire.values import decode_value, encode_value

_LOG = logging.getLogger(__name__)

Preparer = Callable[[bytes, JobConfig], Preparation]
"""Turns an uploaded table into regression problems and a recording; raises DataError or UsageError with a sentence for
the user."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """What preparing gave, the resolved configuration, and the dataset's bytes by digest and size.

    `known` has the known equations by variable, as members of fronts of their own; `settled` are the variables
    that have laws by regression (`atoll_coordinator.model.sparse.laws.settled_variables`), `laws` those among
    many variables, which refining takes over (None: it seeks them itself).
    """

    preparation: Preparation
    config: JobConfig
    blob: str
    size: int
    known: Mapping[str, FrontEntry] = field(default_factory=dict)
    settled: frozenset[str] = frozenset()
    laws: LawsByGroup | None = None

    @property
    def sought(self) -> tuple[Target, ...]:
        """The targets whose equations are searched."""
        return tuple(target for target in self.dataset.targets if target.variable not in self.known)

    @property
    def dataset(self) -> Dataset:
        """What the search sees."""
        return self.preparation.dataset


@dataclass(frozen=True, slots=True)
class PreparationOutcome:
    """The result of the task: what was `prepared`, with its dataset's bytes, or a sentence on why the data cannot be.

    `blob` and `data` are those of `prepared`; the rest of it, which refining takes as an input, is `encoded`.
    """

    encoded: bytes = b""
    data: bytes = b""
    sentence: str = ""

    @property
    def is_prepared(self) -> bool:
        """Whether the data could be prepared."""
        return bool(self.encoded)

    @property
    def prepared(self) -> Prepared:
        """What was prepared; raises RemoteProtocolError where nothing was."""
        return decode_value(self.encoded, Prepared)


def prepare_table(table: bytes, config: JobConfig) -> Preparation:
    """Smooth and differentiate an uploaded table.

    Raises:
        DataError: The measurements cannot be used as they are.
        UsageError: Options contradict each other or name columns that are not there.
        RemoteProtocolError: The bytes are not those of a table.
    """
    from atoll_coordinator.data.prepare import prepare
    from atoll_core.data.table import Table

    return prepare(Table.from_bytes(table), config)


def prepare(table: bytes, specification: bytes, preparer: Preparer = prepare_table) -> bytes:
    """Return the encoded `PreparationOutcome` of a table under a job's configuration as JSON."""
    config = JobConfig.model_validate_json(specification)
    try:
        prepared, data = prepare_job(table, config, preparer)
    except (DataError, UsageError, RemoteProtocolError) as error:
        return encode_value(PreparationOutcome(sentence=str(error)))
    return encode_value(PreparationOutcome(encode_value(prepared), data))


def prepare_job(table: bytes, config: JobConfig, preparer: Preparer = prepare_table) -> tuple[Prepared, bytes]:
    """Return what a table gives, and the bytes of its dataset; raises what `prepare_table` does."""
    from atoll_coordinator.model.result.known import known_entries, with_remarks
    from atoll_coordinator.model.sparse.laws import (  # loads kernels
        find_laws_among_many,
        screen_variables,
        settled_variables,
    )
    from atoll_coordinator.tasks.defaults import resolve, with_units

    preparation = preparer(table, config)
    data = dataset_to_bytes(preparation.dataset)
    blob = hashlib.sha256(data).hexdigest()
    resolved = screen_variables(preparation, resolve(config, preparation.dataset))
    known = known_entries(preparation.dataset, resolved)
    preparation = with_remarks(preparation, resolved)
    resolved = with_units(resolved, preparation.source)
    laws = find_laws_among_many(preparation, resolved)
    settled = settled_variables(preparation, resolved, laws)
    return Prepared(preparation, resolved, blob, len(data), known, settled, laws), data
