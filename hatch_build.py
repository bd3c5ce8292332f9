"""Build hook: put compiled kernels into the wheel if ``ATOLL_WHEEL_KERNELS`` names a folder of ``deploy/kernels.py``.

Such a wheel is for one version of Python and one kind of system. Without the variable the wheel is for all of them and
compiles its kernels when they are first used.
"""

import json
import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_PLATFORMS = {"Linux": "manylinux_2_17_{}", "Darwin": "macosx_11_0_{}"}
"""The oldest systems of the tag: numba's own wheels need at least these, and the kernels call no system library."""


class KernelsHook(BuildHookInterface):  # type: ignore[type-arg]
    """See the module."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Include the folder and set the tag of the wheel; raises OSError if the folder has no index."""
        chosen = os.environ.get("ATOLL_WHEEL_KERNELS")
        if not chosen or version == "editable":
            return
        folder = Path(self.root, chosen)
        index = json.loads((folder / "index.json").read_text("ascii"))
        python = "cp" + index["Python"].replace(".", "")
        platform = _PLATFORMS[index["system"]].format(index["processor"])
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-{platform}"
        build_data["force_include"][str(folder)] = "atoll_core/compilation/prebuilt"
