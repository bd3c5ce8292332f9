"""What the coordinator and the island workers must agree on.

``common`` is a generic import name (the layout is given), so a foreign package of that name could shadow this one.
`PRODUCT` is the marker that both programs check before they do anything else.
"""

from typing import Final

PRODUCT: Final = "atoll"
"""Marks this package as Atoll's own; see `coordinator.__main__` and `island_worker.__main__`."""

VERSION: Final = "0.1.0"
"""Version of the distribution; kept equal to pyproject.toml by a test."""

PROTOCOL_VERSION: Final = 4
"""Raised whenever a message on the wire changes its shape or meaning."""

ENGINE_REVISION: Final = 3
"""Raised whenever the same seed may give other bits: a change of kernels, of variation or of seeding."""
