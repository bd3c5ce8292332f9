"""The library for users, and the command line ``coordinator``, which is a user of it.

``api`` finds equations (`discover`, `submit`, `Discoverer`, `Regressor`) through ``client``; ``model`` is what users
hold of a model that was found, ``analysis`` what its dynamics are, ``experiments`` what data it needs, ``export`` what
other programs read of it, ``display`` its notations and pictures, ``report`` the page that shows it, ``text`` what
terminals show; ``workers`` starts workers on clusters of Dask and Ray; ``cli`` is the command line.

It stands above `atoll_coordinator`, which stands above `atoll_core`. Nothing is loaded before it is first used.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:  # named so, because `typing` takes its time: the command line has to meet Ctrl-C as soon as it can
    from atoll.api.discover import discover, submit
    from atoll.api.discoverer import Discoverer
    from atoll.api.model import Model
    from atoll.api.regressor import Regressor
    from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

__all__ = ["ENGINE_REVISION", "PROTOCOL_VERSION", "VERSION", "Discoverer", "Model", "Regressor", "discover", "submit"]

_PUBLIC = {
    **dict.fromkeys(("ENGINE_REVISION", "PROTOCOL_VERSION", "VERSION"), "atoll_core"),
    "Model": "atoll.api.model",
    "discover": "atoll.api.discover",
    "submit": "atoll.api.discover",
    "Discoverer": "atoll.api.discoverer",
    "Regressor": "atoll.api.regressor",
}
"""What users import, by the module that has it, which is imported when it is first asked for."""


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'atoll' has no attribute {name!r}")
    import importlib

    value: object = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
