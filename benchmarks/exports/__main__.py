"""``python -m benchmarks.exports``: how far each program's solution is from `Model.simulate`, system by system.

Figures are largest differences over the largest value of any state. Programs that are not installed are left out.
"""

import tempfile
from pathlib import Path

import numpy as np

from atoll.api.model import Model
from benchmarks.exports.models import published
from benchmarks.exports.programs import PROGRAMS, Absent, lint_petab
from benchmarks.harness.systems import TABLE_III


def main() -> None:
    """Print the table."""
    models = {name: published(name) for name in TABLE_III}
    print("| format (opened by) | " + " | ".join(TABLE_III) + " |")
    print("|---|" + "---|" * len(TABLE_III))
    for name, program in PROGRAMS.items():
        try:
            figures = [f"{_difference(program(model), model):.1e}" for model in models.values()]
        except Absent as missing:
            print(f"{name}: {missing} is not installed")
            continue
        print(f"| {name} | " + " | ".join(figures) + " |")
    try:
        print("| PEtab (its linter) | " + " | ".join(_linted(model) for model in models.values()) + " |")
    except Absent as missing:
        print(f"PEtab: {missing} is not installed")


def _difference(states: np.ndarray, model: Model) -> float:
    expected = model.simulate(has_bands=False).x
    return float(np.abs(states - expected).max() / np.abs(expected).max())


def _linted(model: Model) -> str:
    simulated = model.simulate(has_bands=False)
    with tempfile.TemporaryDirectory() as folder:
        model.to_petab(folder, data=[simulated.columns()])
        lint_petab(Path(folder))
    return "passes"


if __name__ == "__main__":
    main()
