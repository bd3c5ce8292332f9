"""Preparing a job as a task: from its table and configuration to the inputs of the search and of refining."""

import hashlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.pools import LawsByGroup
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import DataError, RemoteProtocolError, UsageError
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.codec import dataset_to_bytes
from atoll_core.wire.values import decode_value, encode_value

if TYPE_CHECKING:
    from atoll_coordinator.model.batches import Batches

_LOG = logging.getLogger(__name__)

Preparer = Callable[[bytes, JobConfig], Preparation]
"""Turns an uploaded table into regression problems and a recording; raises DataError or UsageError with a sentence for
the user."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """The preparation, the resolved configuration, and digest and size of the dataset's bytes.

    `known` has the known equations by variable, each as a member of its own front. `settled` are the variables with
    laws by regression (`atoll_coordinator.model.sparse.laws.settled_variables`). `laws` are laws of equations with many
    variables, which refining uses (None: refining searches for them itself).
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
        """The dataset of the search."""
        return self.preparation.dataset


@dataclass(frozen=True, slots=True)
class PreparationOutcome:
    """The result of the task: the `prepared` job with its dataset's bytes, or a sentence on why preparing failed.

    `blob` and `data` belong to `prepared`; `encoded` is the rest of the prepared job, which is an input of refining.
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
        """The prepared job; raises RemoteProtocolError if preparing failed."""
        return decode_value(self.encoded, Prepared)


def prepare_table(table: bytes, config: JobConfig) -> Preparation:
    """Smooth and differentiate an uploaded table.

    Raises:
        DataError: The measurements cannot be used as they are.
        UsageError: Options contradict each other or name columns that are not there.
        RemoteProtocolError: The bytes are not a table.
    """
    from atoll_coordinator.data.prepare import prepare
    from atoll_core.data.table import Table

    return prepare(Table.from_bytes(table), config)


def prepare(
    table: bytes, specification: bytes, preparer: Preparer = prepare_table, batches: "Batches | None" = None
) -> bytes:
    """Return the encoded `PreparationOutcome` of a table under a job's configuration as JSON.

    `batches` computes searches of laws on other workers, too. The result does not depend on it.
    """
    config = JobConfig.model_validate_json(specification)
    try:
        prepared, data = prepare_job(table, config, preparer, batches)
    except (DataError, UsageError, RemoteProtocolError) as error:
        return encode_value(PreparationOutcome(sentence=str(error)))
    return encode_value(PreparationOutcome(encode_value(prepared), data))


def prepare_job(
    table: bytes, config: JobConfig, preparer: Preparer = prepare_table, batches: "Batches | None" = None
) -> tuple[Prepared, bytes]:
    """Return the prepared job and the bytes of its dataset; raises the errors of `prepare_table`."""
    from atoll_coordinator.model.batches import spreading
    from atoll_coordinator.model.deadline import Deadline
    from atoll_coordinator.model.hidden.alternation import with_hidden_states, with_proposed_states
    from atoll_coordinator.model.result.known_equations import known_entries, warn_of_missing_values
    from atoll_coordinator.model.sparse.laws import (  # loads kernels
        find_laws_among_many,
        screen_variables,
        settled_variables,
    )
    from atoll_coordinator.model.template.unknown_targets import with_unknown_targets
    from atoll_coordinator.tasks.defaults import resolve, with_units

    preparation = preparer(table, config)
    if config.prior.equations or config.data.observe:
        given = resolve(config, preparation.dataset)
        with spreading(batches, batches.threads if batches else 1, Deadline()) as spread:
            preparation = with_hidden_states(preparation, given, spread)
        preparation = with_unknown_targets(preparation, given)
    of_hidden: LawsByGroup | None = None
    if config.data.hidden_count:
        with spreading(batches, batches.threads if batches else 1, Deadline()) as spread:
            preparation, of_hidden = with_proposed_states(preparation, resolve(config, preparation.dataset), spread)
    data = dataset_to_bytes(preparation.dataset)
    blob = hashlib.sha256(data).hexdigest()
    resolved = screen_variables(preparation, resolve(config, preparation.dataset))
    known = known_entries(preparation.dataset, resolved, preparation.parameters)
    preparation = warn_of_missing_values(preparation, resolved)
    resolved = with_units(resolved, preparation.source)
    with spreading(batches, batches.threads if batches else 1, Deadline()) as spread:
        laws = of_hidden or find_laws_among_many(preparation, resolved, spread)
        settled = settled_variables(preparation, resolved, laws, spread)
    return Prepared(preparation, resolved, blob, len(data), known, settled, laws), data
