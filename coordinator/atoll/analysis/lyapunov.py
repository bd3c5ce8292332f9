"""The spectrum of Lyapunov exponents: variational equations with repeated orthogonalisation (Benettin et al. 1980).

Many trajectories first settle on the attractor. Then each is integrated together with D perturbation vectors. After
each interval, a QR decomposition makes the vectors orthonormal again, and the logarithms of the diagonal of R are
added. Their mean growth per time gives the exponents; the spread over the trajectories gives the standard error.

Doubtful: exponents are averages over a finite time. If trajectories reach different attractors, the mean mixes their
exponents. Letters: D states.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.analysis.fixed_points import jacobian_in_widths, time_scale
from atoll.analysis.flow import SETTLING, UNBOUNDED, Box, Flow, IntegrationBatch
from atoll_core.data.dataset import FloatArray

STARTS: Final = 128
"""Number of trajectories. Their spread gives the standard error with an accuracy of 6 %, 1/sqrt(2 * 127)."""

INTERVALS: Final = 400
"""Number of orthogonalisations that count. A quarter as many come before, in which the vectors settle."""

_SETTLING_SHARE: Final = 4
"""Number of orthogonalisations that count, divided by the number before them."""


@dataclass(frozen=True, eq=False)
class LyapunovSpectrum:
    """Exponents (D,) in descending order with their standard errors (D,), from `starts` trajectories of `duration`."""

    exponents: FloatArray
    standard_errors: FloatArray
    starts: int
    duration: float

    @property
    def is_chaotic(self) -> bool:
        """Whether the largest exponent exceeds three of its standard errors, 1 % of the largest absolute exponent, and
        the growth rate of a power of time.

        Without chaos, errors can grow as a power of time. The largest power is the number of states minus one; on tori
        the power is 1. Chaotic growth must be faster than the largest power.
        """
        largest = float(np.abs(self.exponents).max())
        by_power = (len(self.exponents) - 1) * np.log(1.0 + _SETTLING_SHARE) / self.duration
        return bool(self.exponents[0] > max(3.0 * self.standard_errors[0], 0.01 * largest, by_power))


def lyapunov_spectrum(
    flow: Flow, box: Box, seeds: FloatArray | None = None, *, starts: int = STARTS, intervals: int = INTERVALS
) -> LyapunovSpectrum | None:
    """Return the exponents on the attractors that trajectories reach; None if no trajectory is bounded.

    The `starts` trajectories begin near the `seeds` (n, D), or all over the box. Each of the `intervals` between
    orthogonalisations is about as long as the doubling time of a vector.
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
