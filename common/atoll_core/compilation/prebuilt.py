"""Compiled kernels that a wheel brings: which of them this machine can use, or why it must compile its own.

A wheel for one architecture and one version of Python has the folder `FOLDER`, which ``deploy/kernels.py`` writes:
`INDEX`, and a folder of numba's cache files for each level of processors. A level is a kind of processor that numba
knows by name. All levels give the same bits (ADR 0002), so the best level that the processor can run is taken. Machine
code is used only for the very numba, the version of Python and the source text for which it was compiled (ADR 0104).
"""

import functools
import hashlib
import json
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).with_name("prebuilt")
INDEX: Final = "index.json"

LEVELS: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "x86_64": {
        "x86-64-v3": ("abm", "avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"),
        "generic": (),
    },
    "aarch64": {"generic": ()},
}
"""For each machine the levels that wheels bring, the fastest first, with the flags of the processor that they need."""

_CPU_INFO: Final = Path("/proc/cpuinfo")


@dataclass(frozen=True, slots=True)
class Kernels:
    """The usable compiled kernels of one package.

    `folder` has the cache files of numba, `target` is numba's name of the level, `results` is the digest of the
    self-test, and `index_digest` tells wheels apart.
    """

    folder: Path
    target: tuple[str, ...]
    results: str
    index_digest: str

    def is_intact(self) -> bool:
        """Return whether every file has the digest in the index."""
        expected = _index(self.folder.parents[1])["files"]
        place = self.folder.relative_to(self.folder.parents[1]).as_posix()
        names = {name for name in expected if name.startswith(f"{place}/")}
        try:
            files = {f"{place}/{file.name}": file for file in self.folder.iterdir()}
            return files.keys() == names and all(file_digest(files[name]) == expected[name] for name in names)
        except OSError:  # the folder, or a file, is missing or cannot be read
            return False


@dataclass(frozen=True, slots=True)
class Unusable:
    """Why the kernels of the wheel cannot be used; `reason` continues the sentence "the wheel's kernels …"."""

    reason: str


def find(package: str, source_digest: str) -> Kernels | Unusable | None:
    """Return the kernels that this machine can use for `package` with the sources of `source_digest`.

    The result is None if nothing was brought for this package, such as in a clone. Files are not read, only the index.
    """
    index = _index(FOLDER)
    if not index or package not in index["packages"]:
        return None
    here = circumstances()
    for name, value in here.items():
        if index[name] != value:
            return Unusable(f"are for {name} {index[name]}, and this is {name} {value}")
    if index["packages"][package] != source_digest:
        return Unusable("are for other source files than the installed ones")
    flags = processor_flags()
    for level, needed in LEVELS[here["processor"]].items():
        if level in index["levels"] and flags.issuperset(needed):
            place = FOLDER / level / f"{package}-{source_digest}"
            results = index["results"].get(package, "")  # the kernels of the core are tested with the worker's
            return Kernels(place, tuple(index["levels"][level]), results, index["digest"])
    return Unusable(f"need a processor of the kind {' or '.join(index['levels'])}")


def circumstances() -> dict[str, str]:
    """Return what machine code depends on, besides its source text and the level, each with its usual name."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return {"processor": platform.machine(), "system": platform.system(), "Python": python, "numba": version("numba")}


def processor_flags() -> frozenset[str]:
    """Return the instruction sets of this machine's processor by Linux's names; empty where they are not known."""
    try:
        lines = _CPU_INFO.read_text("utf-8", "replace").splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line.partition(":")[2] for line in lines if line.startswith("flags")), "").split())


def file_digest(file: Path) -> str:
    """Return the digest of a file by which the index knows it."""
    return hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest()


@functools.cache
def _index(folder: Path) -> dict[str, Any]:
    try:
        data = (folder / INDEX).read_bytes()
    except OSError:
        return {}
    try:
        index = json.loads(data)
        _ = index["packages"], index["levels"], index["results"]
    except (ValueError, KeyError, TypeError):  # a damaged file: kernels are compiled, as without the file
        return {}
    return {**index, "digest": hashlib.blake2b(data, digest_size=8).hexdigest()}
