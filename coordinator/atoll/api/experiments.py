"""What `atoll.Model` asks of fits: identifiability of constants, and the next experiment."""

from collections.abc import Mapping
from typing import Any

from atoll.api.tables import table_of
from atoll.api.wording import python_words
from atoll.experiments.determination import Identifiability
from atoll.experiments.identifiability import identify
from atoll.experiments.measured import config_of
from atoll.experiments.space import Request
from atoll.experiments.suggestion import Suggestions
from atoll.experiments.suggestions import suggest
from atoll_core.data.table import Table


def identifiability(found: Mapping[str, Any], data: Any, level: float) -> Identifiability:
    """Return what the data determine of the constants of a result; see `atoll.Model.identifiability`."""
    with python_words():
        return identify(found, _table(found, data), level)


def suggestions(found: Mapping[str, Any], data: Any, **request: Any) -> Suggestions:
    """Return the experiments that would tell most; see `atoll.Model.suggest`."""
    with python_words():
        return suggest(found, Request(**request), _table(found, data))


def _table(found: Mapping[str, Any], data: Any) -> Table | None:
    return None if data is None else table_of(data, config_of(found).data)
