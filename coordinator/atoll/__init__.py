"""The library for users, and the command line ``coordinator``, which is a user of it.

``api`` finds equations (`discover`, `submit`, `Discoverer`, `Regressor`) through ``client``; ``model`` is what users
hold of a model that was found, ``analysis`` what its dynamics are, ``experiments`` what data it needs, ``report`` the
page that shows it, ``text`` what terminals show; ``cli`` is the command line.

It stands above `atoll_coordinator`, which stands above `atoll_core`. Nothing is loaded before it is first used.
"""

from typing import Any, Final

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

__all__ = ["ENGINE_REVISION", "PROTOCOL_VERSION", "VERSION", "Discoverer", "Model", "Regressor", "discover", "submit"]

_PUBLIC: Final = {
    "Model": "atoll.model.model",
    "discover": "atoll.api.discover",
    "submit": "atoll.api.discover",
    "Discoverer": "atoll.api.discoverer",
    "Regressor": "atoll.api.regressor",
}
"""The classes and functions for users, by the module that is imported when one is first asked for."""


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'atoll' has no attribute {name!r}")
    import importlib

    value = globals()[name] = getattr(importlib.import_module(_PUBLIC[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
