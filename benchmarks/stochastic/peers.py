"""The same paths treated by others, in an environment of their own: `peer_program` is what runs there.

Kramers-Moyal averaging (package ``kramersmoyal``, Epanechnikov kernel, its own bandwidth) gives no equations but values
on a grid, which are interpolated. Stochastic SINDy (Boninsegna, Nüske & Clementi 2018) regresses increments, and their
squares, on products up to the fourth degree; terms leave one after another and cross-validation says how many stay.
There is no package of it; that part is written here after the paper.
"""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from atoll_core.errors import AtollError
from benchmarks.judging.forms import compare
from benchmarks.stochastic.judging import ANY_CONSTANT
from benchmarks.stochastic.processes import PROCESSES, simulate

AVERAGING: Final = "Kramers-Moyal averaging"
SPARSE: Final = "stochastic SINDy"
METHODS: Final = (AVERAGING, SPARSE)
LIMIT_S: Final = 600.0


@dataclass(frozen=True)
class Estimate:
    """One equation by one method; `error` and `is_right` as in `Judged`, the latter None without an equation."""

    case: str
    seed: int
    equation: str
    method: str
    error: float
    is_right: bool | None
    found: str | None


def estimate(python: str, case: str, seed: int) -> list[Estimate]:
    """Return what both methods make of the paths of one seed; raises AtollError when the program fails."""
    process = PROCESSES[case]
    paths = simulate(process, seed)
    states = np.concatenate(paths, axis=1)
    columns = dict(zip(process.names, states, strict=True))
    with TemporaryDirectory() as folder:
        given, made = Path(folder) / "paths.npz", Path(folder) / "made.npz"
        arrays: dict[str, Any] = {f"path{number}": path for number, path in enumerate(paths)}
        np.savez(given, step=np.array(process.step), **arrays)
        program = Path(__file__).with_name("peer_program.py")
        words = [python, str(program), str(given), str(made), json.dumps(process.names)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        if done.returncode:
            raise AtollError(f"{python} failed: {done.stderr.strip()[-300:]}")
        with np.load(made) as loaded:
            results = {name: loaded[name] for name in loaded.files}
    texts = json.loads(done.stdout)
    found = []
    for name, truth in process.truth.items():
        if truth == "0":
            continue
        values = process.values(truth, states)
        rms = float(np.sqrt(np.mean(values * values)))
        for method, is_form in ((AVERAGING, False), (SPARSE, True)):
            away = results[f"{method}:{name}"] - values
            seen = away[np.isfinite(away)]
            text = texts[name] if is_form else None
            is_right = compare(text, truth, columns, ANY_CONSTANT).is_right if text else None
            error = float(np.sqrt(np.mean(seen * seen))) / rms
            found.append(Estimate(case, seed, name, method, error, is_right, text))
    return found
