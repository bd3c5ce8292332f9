"""The spectrum of Lyapunov exponents: variational equations with repeated orthogonalisation (Benettin et al. 1980).

Many trajectories are followed together; the spread of their exponents gives the standard error. Letters: D states.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.analysis.fixed_points import jacobian_in_widths, time_scale
from atoll.analysis.flow import SETTLING, UNBOUNDED, Box, Flow, IntegrationBatch
from atoll_core.data.dataset import FloatArray

STARTS: Final = 128
"""Trajectories: their spread gives a standard error that is itself known to 6 %, 1/sqrt(2 * 127)."""

INTERVALS: Final = 400
"""Orthogonalisations that count; the vectors settle during a quarter as many before them."""

_SETTLING_SHARE: Final = 4
"""Orthogonalisations that count over those before them."""


@dataclass(frozen=True, eq=False)
class LyapunovSpectrum:
    """Exponents (D,) by falling size with their standard errors (D,), from `starts` trajectories of `duration`."""

    exponents: FloatArray
    standard_errors: FloatArray
    starts: int
    duration: float

    @property
    def is_chaotic(self) -> bool:
        """Whether the largest exponent is positive by more than three standard errors and 1 % of the spectrum.

        Without chaos errors can grow as a power of time, up to the number of states less one (on tori like time
        itself); chaotic growth has to be faster.
        """
        largest = float(np.abs(self.exponents).max())
        by_power = (len(self.exponents) - 1) * np.log(1.0 + _SETTLING_SHARE) / self.duration
        return bool(self.exponents[0] > max(3.0 * self.standard_errors[0], 0.01 * largest, by_power))


def lyapunov_spectrum(
    flow: Flow, box: Box, seeds: FloatArray | None = None, *, starts: int = STARTS, intervals: int = INTERVALS
) -> LyapunovSpectrum | None:
    """Return the exponents on the attractors of `seeds` (n, D), or of the box; None where no trajectory is bounded.

    Each of `starts` trajectories begins near a seed. One of the `intervals` between orthogonalisations lasts about as
    long as a vector takes to double.
    """
    scale, size = time_scale(flow, box), flow.size
    first = box.points(starts)
    if seeds is not None and len(seeds):
        first = seeds[np.arange(starts) % len(seeds)] + 1e-3 * (first - box.middle)
    settled = IntegrationBatch.of(first, 1e-3 * scale)
    settled.settle(flow, box, SETTLING * scale, rtol=1e-5, most_steps=5000)
    states = settled.states[~settled.is_lost & (box.excursions(settled.states) < UNBOUNDED)]
    if not len(states):
        return None
    norms = np.sqrt((jacobian_in_widths(flow, states, box) ** 2).sum(axis=(1, 2)))
    interval = min(scale, 2.0 / max(float(np.median(norms[np.isfinite(norms)])), 1e-300))

    def rates(y: FloatArray) -> FloatArray:
        vectors = jacobian_in_widths(flow, y[:, :size], box) @ y[:, size:].reshape(-1, size, size)
        return np.concatenate([flow.rates(y[:, :size]), vectors.reshape(len(y), -1)], axis=1)

    count = len(states)
    batch = IntegrationBatch.of(np.hstack([states, np.tile(np.eye(size).ravel(), (count, 1))]), 0.1 * interval)
    weights = np.concatenate([1e-2 * box.widths, np.full(size * size, 1.0)])
    growth, skipped = np.zeros((count, size)), intervals // _SETTLING_SHARE
    for number in range(1, intervals + skipped + 1):
        batch.advance(rates, number * interval, weights, rtol=1e-5)
        vectors, sizes = np.linalg.qr(np.nan_to_num(batch.states[:, size:].reshape(count, size, size)))
        batch.states[:, size:] = vectors.reshape(count, -1)
        if number > skipped:
            with np.errstate(divide="ignore"):
                growth += np.log(np.abs(np.einsum("nii->ni", sizes)))
    is_bounded = box.excursions(batch.states[:, :size]) < UNBOUNDED
    kept = growth[~batch.is_lost & is_bounded & np.isfinite(growth).all(axis=1)]
    if not len(kept):
        return None
    duration = intervals * interval
    exponents = kept.mean(axis=0) / duration
    errors = kept.std(axis=0, ddof=1) / duration / np.sqrt(len(kept)) if len(kept) > 1 else np.full(size, np.nan)
    falling = np.argsort(-exponents, kind="stable")
    return LyapunovSpectrum(exponents[falling], errors[falling], len(kept), duration)
