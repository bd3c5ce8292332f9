"""The source files of kernels: which there are, and a digest of those that one program runs."""

import hashlib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

WORKER: Final = ("atoll_core", "atoll_island_worker")
"""The packages whose kernels decide the bits of a search."""
ALL: Final = (*WORKER, "atoll_coordinator")

_COMPILED_IN: Final = {
    "atoll_core": ("compilation/jit.py", "search/seeding.py", "expression/operators.py"),
    "atoll_island_worker": ("evolution/structures.py",),
}
"""Files beside the kernels whose constants and types are compiled into them."""


def packages_compiled_into(package: str) -> tuple[str, ...]:
    """Return the packages whose kernels may be compiled into those of `package`; of tests and the like, all."""
    return tuple(dict.fromkeys(("atoll_core", package))) if package in ALL else ALL


def kernel_files(packages: Sequence[str] = ALL) -> list[Path]:
    """Return the modules of every folder ``kernels`` in `packages`, in a fixed order."""
    return [file for package in packages for file in sorted(_folder(package).glob("**/kernels/[!_]*.py"))]


def source_digest(packages: Sequence[str] = ALL) -> str:
    """Return a short digest of every source file that takes part in the compiled kernels of `packages`."""
    digest = hashlib.blake2b(digest_size=8)
    others = [_folder(package) / name for package in packages for name in _COMPILED_IN.get(package, ())]
    for file in [*others, *kernel_files(packages)]:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent
