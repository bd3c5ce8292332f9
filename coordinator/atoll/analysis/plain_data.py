"""Values as JSON can hold them."""

from collections.abc import Mapping

import numpy as np

from atoll_coordinator.result.base import finite


def plain(data: Mapping[str, object]) -> dict[str, object]:
    """Return arrays and tuples as lists, complex numbers as pairs, and numbers that are not finite as None."""
    return {name: _plain(value) for name, value in data.items()}


def attributes(of: object, *names: str) -> dict[str, object]:
    """Return attributes by name."""
    return {name: getattr(of, name) for name in names}


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return plain(value)
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, complex):
        return [finite(value.real), finite(value.imag)]
    return finite(value) if isinstance(value, float) else value
