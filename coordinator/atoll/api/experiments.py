"""What `atoll.Model` asks of fits: identifiability of constants, and the next experiment."""

from atoll.api.tables import python_words, table_of
from atoll.experiments.comparison import Comparison, compare
from atoll.experiments.designs import DesignRequest
from atoll.experiments.fits import config_of
from atoll.experiments.identifiability import Identifiability, identify
from atoll.experiments.suggestion import Suggestions, suggest
from atoll.model.model import Model
from atoll_coordinator.result.result import Result
from atoll_core.data.table import Table


def identifiability(model: Model, data: object, level: float) -> Identifiability:
    """Return what the data determine of the constants of a model; see `atoll.Model.identifiability`."""
    model.require_one_group()
    with python_words():
        return identify(model.result, _table(model.result, data), level)


def suggestions(model: Model, data: object, request: DesignRequest) -> Suggestions:
    """Return the experiments that would tell most; see `atoll.Model.suggest`."""
    with python_words():
        return suggest(model.result, request, _table(model.result, data))


def comparison(first: Model, second: Model, data: object) -> Comparison:
    """Return two models beside each other; see `atoll.Model.compare`."""
    with python_words():
        return compare(first.result, second.result, table=_table(first.result, data))


def _table(result: Result, data: object) -> Table | None:
    return None if data is None else table_of(data, config_of(result).data)
