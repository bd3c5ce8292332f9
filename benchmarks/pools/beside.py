"""Processor seconds of refining by this tree and by another tree, pool by pool and in turn.

Wall times say nothing on a machine with other work, and processor seconds grow with the load, too. So each pool is
refined by both trees directly one after another, each in a process of its own, and the ratios count.
"""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

from atoll.terminal.output import note, table
from atoll_core.errors import UsageError
from benchmarks.pools.campaign import POOLS
from benchmarks.pools.cases import LISTED_VARIABLE, REAL_VARIABLE, Folders, job_of
from benchmarks.pools.stored import file_of, read_pools, refine_stored

ROOT: Final = Path(__file__).parents[2]
SOURCE_ROOTS: Final = ("common", "coordinator", "island_worker")
_PASSING: Final = ("version", "versions", "created", "seconds", "search_seconds")
"""Parts of a result that differ between two runs, besides names that end with a unit of time."""


@dataclass(frozen=True)
class Beside:
    """Processor seconds of refining a pool by the other tree (`before`) and by this tree, and whether the results are
    equal."""

    title: str
    before: float
    now: float
    is_equal: bool


def refine_and_digest(title: str, folders: Folders) -> str:
    """Refine a pool; return its processor seconds, without preparing, and a digest of its result, as JSON."""
    job = job_of(title, folders)
    refined = refine_stored(title, job.table, job.config, read_pools(file_of(POOLS, title)))
    text = json.dumps(_lasting(refined.result), sort_keys=True)
    return json.dumps({"seconds": refined.refining_s, "digest": hashlib.sha256(text.encode()).hexdigest()})


def _lasting(value: Any) -> Any:
    if isinstance(value, dict):
        kept = ((name, part) for name, part in value.items() if name not in _PASSING and not name.endswith("_s"))
        return {name: _lasting(part) for name, part in kept}
    return [_lasting(part) for part in value] if isinstance(value, list) else value


def compare(title: str, folders: Folders, source: Path) -> Beside:
    """Refine a pool by the tree at `source` and by this tree.

    Raises:
        UsageError: One of them failed.
    """
    before, now = _refined_by(source, title, folders), _refined_by(ROOT, title, folders)
    return Beside(title, before["seconds"], now["seconds"], before["digest"] == now["digest"])


def _refined_by(source: Path, title: str, folders: Folders) -> dict[str, Any]:
    given = {LISTED_VARIABLE: folders.listed, REAL_VARIABLE: folders.real}
    environment = os.environ | {name: str(folder) for name, folder in given.items() if folder is not None}
    environment["PYTHONPATH"] = os.pathsep.join(str(source.absolute() / part) for part in SOURCE_ROOTS)
    command = [sys.executable, "-m", "benchmarks.pools", "digest", title]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(f"{title} was not refined by {source}: {done.stderr.strip()[-500:]}")
    refined: dict[str, Any] = json.loads(done.stdout)
    return refined


def report(pairs: list[Beside]) -> str:
    """Return the table of seconds and ratios by kind of pool."""
    kinds: dict[str, list[Beside]] = {}
    for pair in pairs:
        kinds.setdefault(pair.title.partition(" ")[0], []).append(pair)
    kinds["all"] = pairs
    heads = ("pools", "number", "seconds before", "seconds now", "ratio of sums", "median ratio", "equal results")
    return table(heads, [_row(name, part) for name, part in kinds.items()])


def _row(name: str, pairs: list[Beside]) -> tuple[str, ...]:
    before, now = sum(pair.before for pair in pairs), sum(pair.now for pair in pairs)
    ratios = median(pair.now / pair.before for pair in pairs)
    equal = sum(pair.is_equal for pair in pairs)
    return name, str(len(pairs)), f"{before:.1f}", f"{now:.1f}", f"{now / before:.2f}", f"{ratios:.2f}", str(equal)


def compare_all(wanted: list[str], folders: Folders, source: Path) -> list[Beside]:
    """Compare pools one after another, with a line for each."""
    pairs: list[Beside] = []
    for title in wanted:
        pair = compare(title, folders, source)
        pairs.append(pair)
        change = "equal" if pair.is_equal else "DIFFERENT"
        note(f"{len(pairs)} of {len(wanted)}: {title}: {pair.before:.2f} s, now {pair.now:.2f} s, {change}")
    return pairs
