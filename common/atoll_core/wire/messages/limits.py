"""Types of the fields of messages, and limits of the sizes of messages and their contents."""

from typing import Annotated, Final

from pydantic import Field

CHUNK_SIZE: Final = 4 * 1024 * 1024
"""Bytes per chunk of an upload or a dataset; the last chunk may be shorter."""

MAX_UPLOAD: Final = 1024 * 1024 * 1024
"""Largest table a client may upload, in bytes."""

MAX_PAGE_JOBS: Final = 100
"""Largest number of jobs in one list."""

MAX_PAGE_WORKERS: Final = 500
"""Largest number of workers in one list; each has a few thousand bytes of counters."""

CHUNK_LIMIT_S: Final = 120.0
"""Seconds for which a client tries to upload one chunk over a slow line."""

MAX_MESSAGE: Final = 16 * 1024 * 1024
"""Largest encoded message; anything larger is refused unread."""

MAX_STATE: Final = 256 * 1024 * 1024
"""Largest state of one island, in bytes; a typical state has about 50,000."""

MAX_RUNNERS_UP: Final = 20_000
"""Most runners-up that an island may report for one epoch; a few hundred are usual."""

MAX_ISLANDS: Final = 1024
"""Most islands of one archipelago."""

MAX_SHOWN_ISLANDS: Final = 16_384
"""Most islands of a job that are listed one by one."""

Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Variable = Annotated[str, Field(min_length=1, max_length=256)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Summand = Annotated[int, Field(ge=0, lt=2**63 // MAX_ISLANDS)]
"""A count whose sum over all islands is a `Count`."""

IslandIndex = Annotated[int, Field(ge=0, lt=MAX_ISLANDS)]
IslandCount = Annotated[int, Field(ge=0, le=MAX_ISLANDS)]
Term = Annotated[int, Field(ge=1, lt=2**63)]
Sentence = Annotated[str, Field(max_length=4000)]
Seconds = Annotated[float, Field(ge=0.0, lt=1e12)]
Priority = Annotated[int, Field(ge=-10, le=10)]
"""Each step doubles a job's share of the workers."""


def chunk_count(size: int) -> int:
    """Return the number of chunks of `size` bytes (at least 1)."""
    return max(1, -(-size // CHUNK_SIZE))
