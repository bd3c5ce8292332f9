"""The library for users, and the command line ``coordinator``, which uses the library.

``api`` finds equations (`discover`, `submit`, `Discoverer`, `Regressor`) through ``client``. ``model`` has the model of
a result. ``analysis`` computes its dynamics, ``experiments`` suggests measurements for it, and ``export`` writes it for
other programs. ``display`` has notations and pictures of a model, ``report`` writes the HTML page of a result, ``text``
writes a result as text, and ``terminal`` prints on terminals. ``tasks`` has the tasks of workers. ``workers`` starts
workers on clusters of Dask and Ray, and ``executors`` computes jobs on an executor of another library. ``cli`` is the
command line.

This package imports `atoll_coordinator`, which imports `atoll_core`. Nothing is loaded before its first use.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:  # not from `typing`, which loads slowly: Ctrl-C must be handled soon after the start
    from atoll.api.campaign import discover_many
    from atoll.api.discover import discover, submit
    from atoll.api.discoverer import Discoverer
    from atoll.api.model import Model
    from atoll.api.regressor import Regressor
    from atoll.api.template import Template
    from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

__all__ = [
    "ENGINE_REVISION", "PROTOCOL_VERSION", "VERSION", "Discoverer", "Model", "Regressor", "Template", "discover",
    "discover_many", "submit",
]  # fmt: skip

_PUBLIC = {
    **dict.fromkeys(("ENGINE_REVISION", "PROTOCOL_VERSION", "VERSION"), "atoll_core"),
    "Model": "atoll.api.model",
    "discover": "atoll.api.discover",
    "discover_many": "atoll.api.campaign",
    "submit": "atoll.api.discover",
    "Discoverer": "atoll.api.discoverer",
    "Regressor": "atoll.api.regressor",
    "Template": "atoll.api.template",
}
"""The module of each public name; a module is imported when one of its names is first used."""


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'atoll' has no attribute {name!r}")
    import importlib

    value: object = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
