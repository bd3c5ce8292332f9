"""A system fitted to measured trajectories. Letters as in `atoll_coordinator.model.shooting.kernels.integrate`."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.system import System
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

if TYPE_CHECKING:
    from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting

_LEAST_CURVATURE: Final = 1e-13
"""Least curvature of an initial state, its D coordinates scaled to a curvature of one: smaller ones are rounding.

Entries are sums over N rows, rounded by about eps*sqrt(N) each, and the largest eigenvalue is at most D, so that
eigenvalues are known to about eps*D*sqrt(N): 1e-13 at D = 7 and N = 4000. It is one number for all: with fewer rows
some curvature that is known is raised, with more some rounding is kept.
"""


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """A system fitted to segments.

    `starts` (G, D) are the fitted initial states of `segments` (G, 2), and behind them, where trajectories are fitted
    in whole, their K offsets (G, D + K); `simulated` (D, N); `residuals` (O, N) measured minus simulated and offset;
    `errors` what they were taken to be; `squares` (O,) their mean squares; `normal`,
    `coupling` and `own` the blocks of the normal equations at the end, weighted; `estimator` fitted it; `is_stiff`
    tells whether the system was integrated as a stiff one; `gradient` (P,) is by how much more likely the data become
    where a constant grows, which is zero but for constants on their bounds.
    """

    system: System
    segments: Ints
    starts: FloatArray
    simulated: FloatArray
    residuals: FloatArray
    errors: ErrorModel
    squares: FloatArray
    normal: FloatArray
    coupling: FloatArray
    own: FloatArray
    estimator: "MultipleShooting" = field(repr=False)
    is_stiff: bool = False
    gradient: FloatArray | None = field(default=None, repr=False)

    def integrated_sensitivities(self) -> FloatArray:
        """Return the sensitivities (N, D, P + D + K) to the constants and to what each segment has its own.

        They are integrated again at each call, since they would make a fit many times as large.
        """
        return self.estimator.sensitivities(self)

    @property
    def reduced(self) -> FloatArray:
        """The normal matrix (P, P) of the constants, initial states eliminated."""
        carried = self.coupling @ _inverse_roots(self.own)
        return np.asarray(self.normal - np.tensordot(carried, carried, axes=([0, 2], [0, 2])))


def _inverse_roots(own: FloatArray) -> FloatArray:
    """Return W (G, D, D) with WW' the inverses of the blocks of the initial states.

    What trajectories forget at once has hardly any curvature. By roots it is taken from that of the constants without
    more than rounding; an inverse leaves an indefinite matrix.
    """
    scale = np.sqrt(np.maximum(np.einsum("gdd->gd", own), 1e-200))
    values, vectors = np.linalg.eigh(own / (scale[:, :, None] * scale[:, None, :]))
    return np.asarray(vectors / scale[:, :, None] / np.sqrt(np.maximum(values, _LEAST_CURVATURE))[:, None, :])
