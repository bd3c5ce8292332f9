"""The corpus on which the speed of evaluation is measured: 1,000 offspring of searches with preset ``paper``.

The offspring come from crossover and mutation of the populations at generations 100, 200, ..., 1000 of all eight
islands of each of the 14 Strogatz label files. The corpus has their whole operation lists, dead nodes included, and 16
rows of each file. The file is never changed, so that speeds measured at different times can be compared. The program
that wrote it was removed after revision ff1aeaaf (``git show ff1aeaaf:benchmarks/kernels/corpus.py``).
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from atoll_core.errors import DataError
from atoll_island_worker.evolution.structures import Lists, empty_lists

CORPUS: Final = Path(__file__).parent / "data" / "corpus.npz"


@dataclass(frozen=True, eq=False)
class Corpus:
    """Operation lists of P individuals, in the order of their label files, and rows of these F files.

    `code`, `left`, `right` and `constants` (P, L) are as in `atoll_island_worker.evolution.structures.Lists`. `origin`
    (P,) is the index of the file in `names` (F,). `generation` (P,) is the generation of the parents. `inputs`
    (F, V, 16) and `target` (F, 16) are evenly spaced rows of the files.
    """

    names: npt.NDArray[np.str_]
    origin: npt.NDArray[np.int8]
    generation: npt.NDArray[np.int16]
    code: npt.NDArray[np.int8]
    left: npt.NDArray[np.int16]
    right: npt.NDArray[np.int16]
    constants: npt.NDArray[np.float64]
    inputs: npt.NDArray[np.float64]
    target: npt.NDArray[np.float64]

    def lists_of(self, file: int) -> Lists:
        """Return the lists that come from one file, unscaled."""
        chosen = self.origin == file
        parts = (self.code, self.left, self.right, self.constants)
        code, left, right, constants = (np.ascontiguousarray(part[chosen]) for part in parts)
        scale = empty_lists(len(code), self.code.shape[1]).scale
        return Lists(code, left, right, constants, scale)


def load_corpus(path: Path = CORPUS) -> Corpus:
    """Return the corpus in the file `path`; raises DataError if the file is no corpus."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return Corpus(**{field.name: arrays[field.name] for field in fields(Corpus)})
    except (OSError, KeyError, TypeError, ValueError, EOFError, BadZipFile) as error:
        raise DataError(f"{path} is not a corpus of operation lists ({error}); check out the file anew") from error
