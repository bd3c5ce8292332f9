"""The input of a search: rows of input variables and, for each equation, the target column.

Measurements are in `atoll_core.data.table.Table`; preparing a job smooths and differentiates them once and makes a
`Dataset`. Letters: R rows, V input variables.
"""

import hashlib
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from atoll_core.data.notes import notes_of

FloatArray = npt.NDArray[np.float64]
AnyArray = npt.NDArray[Any]
"""An array of numbers or texts of any type."""
IntArray = npt.NDArray[np.int64]

CLEAN_UNCERTAINTY: Final = 1e-3
"""Targets with a smaller uncertainty than this, relative to their standard deviation, count as noise-free."""

EXACT_ERROR: Final = 1e-9
"""Normalized error at which an equation of noise-free data has converged: rounding errors."""


@dataclass(frozen=True, eq=False)
class Target:
    """The left-hand side of one equation.

    `variable` is the name of its column and of the equation; `lhs` is its printed form, such as ``dx/dt``; `values` has
    shape (R,); `uncertainty` is the mean estimated uncertainty of `values` divided by their `standard_deviation`;
    `noise` is the estimated relative noise (0: none).
    """

    variable: str
    lhs: str
    values: FloatArray
    uncertainty: float
    standard_deviation: float
    noise: float = 0.0

    @property
    def is_noisy(self) -> bool:
        """Whether noise is so large that the size of residuals alone cannot identify the true equation."""
        return self.noise > 0.0 or self.uncertainty >= CLEAN_UNCERTAINTY

    def normalized(self, error: float) -> float:
        """Return an error over the standard deviation, infinite for a target that does not vary."""
        return error / self.standard_deviation if self.standard_deviation else math.inf

    def r2(self, mse: float) -> float | None:
        """Return the share of the variance that an equation with this mean squared error explains; None if unknown."""
        variance = self.standard_deviation * self.standard_deviation
        return 1.0 - mse / variance if variance and math.isfinite(mse) else None

    def convergence_threshold(self, target_error: float | None = None) -> float:
        """Return the largest normalized error of a converged equation of this target.

        It is `target_error` if the job has one, else twice the uncertainty, but at least `EXACT_ERROR`.
        """
        return target_error if target_error is not None else max(EXACT_ERROR, 2.0 * self.uncertainty)

    def convergence_error(self, target_error: float | None = None) -> float:
        """Return the largest error of a converged equation of this target, in the unit of `values`."""
        return self.convergence_threshold(target_error) * self.standard_deviation


@dataclass(frozen=True, eq=False)
class Problem:
    """One regression problem: the inputs, shape (V, R), C order, and one target over the same R rows.

    `groups` (R,) are the numbers of the groups of trajectories with separate constants; None: all rows share them.
    """

    names: tuple[str, ...]
    inputs: FloatArray
    target: Target
    groups: IntArray | None = None

    def of_group(self, group: int) -> "Problem":
        """Return the problem on the rows of one group, or this problem if there are no groups."""
        if self.groups is None:
            return self
        rows = np.flatnonzero(self.groups == group)
        target = replace(self.target, values=np.ascontiguousarray(self.target.values[rows]))
        return Problem(self.names, np.ascontiguousarray(self.inputs[:, rows]), target)


@dataclass(frozen=True, eq=False)
class Dataset:
    """All regression problems of a job over the same rows.

    `names` are the V symbols used in expressions, in the order of the rows of `inputs`; `symbols` maps each column name
    of the user's file to its symbol; `warnings` are sentences for the user about the treatment of the data; `notes`
    lists the warnings that are only information; `groups` are as in `Problem`.
    """

    names: tuple[str, ...]
    inputs: FloatArray
    targets: tuple[Target, ...]
    symbols: dict[str, str]
    warnings: tuple[str, ...] = ()
    groups: IntArray | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Store which warnings are notes: the bytes of a dataset do not contain this distinction."""
        object.__setattr__(self, "notes", tuple(dict.fromkeys((*self.notes, *notes_of(self.warnings)))))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all equations, including known equations, in their order."""
        return tuple(target.variable for target in self.targets)

    def problem(self, variable: str) -> Problem:
        """Return the regression problem of `variable`; raises KeyError if `variable` is unknown."""
        for target in self.targets:
            if target.variable == variable:
                return Problem(self.names, self.inputs, target, self.groups)
        raise KeyError(variable)

    @cached_property
    def digest(self) -> str:
        """Hex digest of all data that can influence the search."""
        digest = hashlib.sha256()
        _update(digest, self.names)
        digest.update(self.inputs.tobytes())
        for target in self.targets:
            _update(digest, (target.variable, target.lhs))
            digest.update(target.values.tobytes())
            digest.update(struct.pack("<ddd", target.uncertainty, target.standard_deviation, target.noise))
        if self.groups is not None:
            digest.update(self.groups.tobytes())
        return digest.hexdigest()


def _update(digest: "hashlib._Hash", texts: Sequence[str]) -> None:
    for text in texts:
        encoded = text.encode()
        digest.update(struct.pack("<q", len(encoded)) + encoded)
