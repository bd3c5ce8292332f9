"""Methods of `atoll.Model` that fit again: identifiability of constants, and the next experiment."""

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
    """Return which constants of a model the data determine; see `atoll.Model.identifiability`."""
    model.require_one_group()
    with python_words():
        return identify(model.result, _table(model.result, data), level)


def suggestions(model: Model, data: object, request: DesignRequest) -> Suggestions:
    """Return the most informative experiments; see `atoll.Model.suggest`."""
    with python_words():
        return suggest(model.result, request, _table(model.result, data))


def comparison(first: Model, second: Model, data: object) -> Comparison:
    """Return a comparison of two models; see `atoll.Model.compare`."""
    with python_words():
        return compare(first.result, second.result, table=_table(first.result, data))


def _table(result: Result, data: object) -> Table | None:
    return None if data is None else table_of(data, config_of(result).data)
