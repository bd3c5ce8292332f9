"""Which instructions numpy's and scipy's linear algebra use: the same ones on all processors of a kind.

OpenBLAS has kernels for each processor, which add in other orders. Those of the oldest processor that numpy runs on
run on all that came after it; matrices here are small, so that newer ones would save little.
"""

import platform
from collections.abc import Mapping, MutableMapping
from typing import Final

CORE_TYPES: Final[Mapping[str, str]] = {"x86_64": "Nehalem", "amd64": "Nehalem"}
"""By kind of processor, the core whose kernels are used. Of kinds that are not here OpenBLAS chooses itself."""


def use_common_instructions(environment: MutableMapping[str, str], machine: str | None = None) -> None:
    """Set in `environment` what OpenBLAS reads when it is loaded, unless the user has; before numpy is imported.

    One thread: how a product falls to several depends on how many there are, and small ones wait for each other.
    `machine` is the kind of processor, as `platform.machine` says; this one's unless given.
    """
    core = CORE_TYPES.get((machine or platform.machine()).lower())
    if core is not None:
        environment.setdefault("OPENBLAS_CORETYPE", core)
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
