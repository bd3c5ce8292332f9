"""What the coordinator and the island workers share, and the place of the public API.

``config``, ``data`` and ``expression`` say what a job is; ``search`` holds the rules that both sides must apply alike
(fronts, random streams, the commit order); ``wire`` the messages and the bus; ``compilation`` the kernels' compiler;
``machine`` what this process may use of its machine; ``command_line``, ``program``, ``logs`` and ``errors`` what both
command lines share.

``model`` is what users hold of a model that was found, ``stochastic`` the steps and paths of a process, ``analysis``
what the dynamics of a model are, ``experiments`` what is said of the data that it needs; ``Model`` here is loaded when
it is first used.

`atoll` imports neither `atoll_coordinator` nor `atoll_island_worker`.
"""

from typing import Any, Final

VERSION: Final = "0.1.0"
"""Version of the distribution; kept equal to pyproject.toml by a test."""

PROTOCOL_VERSION: Final = 7
"""Raised whenever a message on the wire changes its shape or meaning."""

ENGINE_REVISION: Final = 7
"""Raised whenever the same seed may give other bits: a change of kernels, of variation or of seeding."""

_API: Final = "atoll_coordinator.api"
_PUBLIC: Final = {
    "Model": "atoll.model.model",
    "discover": f"{_API}.discover",
    "submit": f"{_API}.discover",
    "Discoverer": f"{_API}.discoverer",
    "Regressor": f"{_API}.regressor",
}
"""The classes and functions for users, by the module that is imported when one is first asked for."""


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'atoll' has no attribute {name!r}")
    import importlib

    found = globals()[name] = getattr(importlib.import_module(_PUBLIC[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
