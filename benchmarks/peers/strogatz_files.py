"""The 14 Strogatz label files: their names and truths, their rows, and SRBench's way to split and disturb them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError

LABEL: Final = "label"

NAMES: Final = (
    *("glider1", "glider2", "bacres1", "bacres2", "predprey1", "predprey2", "barmag1", "barmag2"),
    *("shearflow1", "shearflow2", "vdp1", "vdp2", "lv1", "lv2"),
)

TRAINING_SHARE: Final = 0.75
_LEVEL_UNIT: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Split:
    """The rows to learn from, their labels with noise, and the rows to judge by, without.

    `columns` are the test rows: by name, R values each, and `labels` the true values there.
    """

    training: Table
    columns: dict[str, FloatArray]
    labels: FloatArray


def truths(folder: Path) -> dict[str, str]:
    """Return the true expressions by name; raises DataError when they, or a file of data, are not there."""
    missing = [file for file in ("truth.json", *(f"{name}.csv" for name in NAMES)) if not (folder / file).is_file()]
    if missing:
        raise DataError(f"{folder} has no {missing[0]}; name the folder of the Strogatz files with --data")
    read: dict[str, str] = json.loads((folder / "truth.json").read_text("utf-8"))
    return read


def rows_of(folder: Path, name: str) -> Table:
    """Return the rows of one file: label, x and y."""
    return read_table([folder / f"{name}.csv"], DataConfig(target=LABEL))


def split(table: Table, name: str, seed: int, level: float) -> Split:
    """Return rows to learn from and to judge by, as SRBench does for `seed`.

    Three quarters of the rows, shuffled, are for learning; Gaussian noise of standard deviation `level` times the root
    mean square of their labels is added to these labels (La Cava et al. 2021, section 4). The rows depend on file and
    seed, the noise on the level as well.
    """
    index = NAMES.index(name)
    order = np.random.default_rng((index, seed)).permutation(table.rows)
    count = round(TRAINING_SHARE * table.rows)
    training = _chosen(table, order[:count])
    if level > 0.0:
        generator = np.random.default_rng((index, seed, 1 + round(level / _LEVEL_UNIT)))
        place, labels = table.names.index(LABEL), training.column(LABEL)
        deviation = level * float(np.sqrt(np.mean(labels**2)))
        training.columns[place] = labels + generator.normal(0.0, deviation, count)
    test = table.columns[:, order[count:]]
    columns = {column: values for column, values in zip(table.names, test, strict=True) if column != LABEL}
    return Split(training, columns, test[table.names.index(LABEL)])


def _chosen(table: Table, rows: Sequence[int] | npt.NDArray[np.int64]) -> Table:
    """Return a table of copies of `rows` as one trajectory."""
    return replace(
        table,
        columns=np.ascontiguousarray(table.columns[:, rows]),
        starts=(0,),
        file_of_row=table.file_of_row[rows],
        line_of_row=table.line_of_row[rows],
    )
