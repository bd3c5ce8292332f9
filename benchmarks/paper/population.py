"""The solutions of an island as they stand: their sizes, dead nodes left out, and their losses on all rows.

Evaluated by numpy, all solutions at once, apart from the search, which is neither disturbed nor charged.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import DEFINITIONS
from atoll_core.expression.operators import ARITY, CONSTANT, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.wire.codec import decode_arrays
from atoll_island_worker.evolution.island import Island

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
_ARITY = np.array(ARITY)


@dataclass(frozen=True, eq=False)
class Population:
    """P operation lists of L nodes each over one variable, in no particular order."""

    code: IntArray
    left: IntArray
    right: IntArray
    constants: FloatArray

    def live(self) -> BoolArray:
        """Return which nodes (P, L) the output of their list depends on."""
        live = np.zeros(self.code.shape, np.bool_)
        live[:, -1] = True
        for node in range(self.code.shape[1] - 1, -1, -1):
            arity = _ARITY[self.code[:, node]]
            for least, argument in ((1, self.left), (2, self.right)):
                users = np.flatnonzero(live[:, node] & (arity >= least))
                live[users, argument[users, node]] = True
        return live

    def sizes(self) -> IntArray:
        """Return the number of live nodes of each list, duplicates included."""
        sizes: IntArray = self.live().sum(axis=1)
        return sizes

    def values(self, x: FloatArray) -> FloatArray:
        """Return the outputs (P, R) at `x` (R,)."""
        lists, nodes = self.code.shape
        values = np.empty((nodes, lists, len(x)))
        live = self.live()
        with np.errstate(all="ignore"):
            for node in range(nodes):
                for code in np.unique(self.code[live[:, node], node]).tolist():
                    which = np.flatnonzero((self.code[:, node] == code) & live[:, node])
                    if code == VARIABLE:
                        values[node, which] = x
                    elif code == CONSTANT:
                        values[node, which] = self.constants[which, node, np.newaxis]
                    else:
                        left = values[self.left[which, node], which]
                        right = values[self.right[which, node], which] if ARITY[code] > 1 else left
                        values[node, which] = DEFINITIONS[code].value(left, right)
        outputs: FloatArray = values[-1]
        return outputs

    def losses(self, x: FloatArray, target: FloatArray) -> FloatArray:
        """Return the mean absolute errors (P,) at `x`, inf where one is not finite."""
        with np.errstate(all="ignore"):
            losses: FloatArray = np.abs(self.values(x) - target).mean(axis=1)
        losses[~np.isfinite(losses)] = np.inf
        return losses

    def program(self, index: int) -> Program:
        """Return one list, dead nodes included."""
        return Program(
            self.code[index].astype(np.int8),
            self.left[index].astype(np.int16),
            self.right[index].astype(np.int16),
            self.constants[index],
        )


def population(island: Island) -> Population:
    """Return the solutions of an island without linear scaling, as it would send them at an epoch's end."""
    blocks = [decode_arrays(block)[1] for _, block in sorted(island.emigrants().items())]
    code, left, right, constants = (
        np.concatenate([block[name] for block in blocks]) for name in ("code", "left", "right", "constants")
    )
    return Population(code.astype(np.int64), left.astype(np.int64), right.astype(np.int64), constants)
