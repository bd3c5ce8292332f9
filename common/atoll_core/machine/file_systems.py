"""The kind of file system that a folder is on, and whether it is reached over a network; known on Linux only."""

import contextlib
from pathlib import Path
from typing import Final

_NETWORKED: Final = ("nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "ceph", "afs", "fuse.sshfs", "9p")
_MOUNTS: Final = Path("/proc/self/mounts")


def file_system(place: Path, mounts: Path = _MOUNTS) -> str | None:
    """Return the kind of file system that `place` is on, or would be on; None where this is not known."""
    kinds = {}
    with contextlib.suppress(OSError):
        for line in mounts.read_text("utf-8", "replace").splitlines():
            _, point, kind, *_ = line.split()
            kinds[Path(point.replace("\\040", " "))] = kind
    real = place.resolve()
    return next((kinds[folder] for folder in (real, *real.parents) if folder in kinds), None)


def is_networked(kind: str | None) -> bool:
    """Tell whether several machines may see a file system of this kind at once."""
    return kind is not None and kind.startswith(_NETWORKED)
