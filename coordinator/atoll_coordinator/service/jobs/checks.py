"""Sentences on why a stored or prepared job cannot be searched. Pure."""

from collections.abc import Mapping
from typing import Final

from pydantic import ValidationError

from atoll_coordinator.service.search.checkpoint_schedule import StoredSearchState
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core import ENGINE_REVISION, VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError

DAMAGED_RECORD: Final = "its record in the coordinator's store is damaged; submit it again under another id"


def settings_reason(error: ValidationError) -> str:
    """Return why the settings of a stored job cannot be used."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"]) or "all of them"
    return (
        f"its settings in the store are not understood by version {VERSION} ({where}: {first['msg']}); "
        "submit it again under another id"
    )


def stored_search_reason(error: RemoteProtocolError) -> str:
    """Return why the stored search cannot be continued."""
    return f"the stored search cannot be read by version {VERSION} ({error}); submit it again under another id"


def lost_states_reason(variable: str) -> str:
    """Return why a search cannot continue if durable states are missing in the store."""
    return (
        f"states of the last checkpoint of {variable} are missing or damaged in the coordinator's store; check that "
        "its disk is sound, and submit the job again under another id"
    )


def epoch_limit_reason(config: JobConfig, prepared: Prepared) -> str | None:
    """Return why `--max-epochs` does not fit the variables whose equations are searched; None: it fits."""
    sought = [target.variable for target in prepared.sought]
    unknown = sorted(set(config.budget.max_epochs_of) - set(sought))
    if not unknown:
        return None
    there = ", ".join(sought) or "none"
    return f"--max-epochs names {unknown[0]!r}, for which no equation is searched; equations are searched for: {there}"


def resume_reason(
    prepared: Prepared, dataset_digest: str | None, has_cuts: bool, resumed: Mapping[str, StoredSearchState]
) -> str | None:
    """Return why a stored search does not fit the prepared data; None: it fits.

    `dataset_digest` is the digest of the dataset that was prepared earlier; None: no dataset was prepared earlier.
    """
    if (has_cuts or resumed) and dataset_digest not in (None, prepared.blob):
        return (
            "its data were prepared again after a restart, and came out differently; submit it again under another id"
        )
    engines = {state.engine for state in resumed.values()} - {ENGINE_REVISION}
    if engines:
        return (
            f"it was begun by engine revision {min(engines)}, and this is revision {ENGINE_REVISION}, which "
            "computes other numbers; submit it again under another id"
        )
    return None
