"""A Kalman filter along a system of equations, which carries the sensitivities to constants with it.

The state x obeys dx = f(x; c) dt with process noise of variance `process` per unit of time; sensor j measures
y = x + s + e with independent errors e and a drift s, an Ornstein-Uhlenbeck process. Between rows the covariance is
carried by the sensitivities to the state at the row before (the extended filter: Jazwinski 1970, Stochastic Processes
and Filtering Theory, section 8.3); the channels of a row are taken in one after another, each with Joseph's form.
Letters: D states, O sensors, A = D + O, P fitted constants, N rows, G segments.
"""

import numpy as np

from atoll_coordinator.model.shooting.kernels.innovations import decayed
from atoll_coordinator.model.shooting.kernels.integrate import advance
from atoll_coordinator.model.shooting.kernels.rates import Path, Table, Tape
from atoll_core.compilation.jit import allocating_kernel, inlined
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

Noise = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Variances: `process` (D,) per unit of time, `sensor` (O,) of a row of weight 1, `drift` (O,); and the drift's
correlation (O,) between rows one median step apart."""

Layout = tuple[Ints, FloatArray, FloatArray, FloatArray, Ints]
"""Row ranges (G, 2); steps (N,) from the row before over the median one; measured numbers and weights (O, N), 0 leaves
one out; the state (O,) that each sensor measures."""


@inlined
def predict(covariance: FloatArray, moved: FloatArray, sensitivity: FloatArray, fitted: int, noise: Noise, width: float,
            step: float) -> None:  # fmt: skip
    """Carry the covariance (A, A) to the next row, given the sensitivities (D, P + D) to the row before."""
    process, _, drift, decay = noise
    states, every = process.shape[0], covariance.shape[0]
    for d in range(states):
        for b in range(every):
            moved[d, b] = 0.0
            for k in range(states):
                moved[d, b] += sensitivity[d, fitted + k] * covariance[k, b]
    for j in range(states, every):
        kept = decayed(decay[j - states], step)
        for b in range(every):
            moved[j, b] = kept * covariance[j, b]
    for a in range(every):
        for d in range(states):
            covariance[a, d] = 0.0
            for k in range(states):
                covariance[a, d] += moved[a, k] * sensitivity[d, fitted + k]
        for j in range(states, every):
            covariance[a, j] = decayed(decay[j - states], step) * moved[a, j]
    for d in range(states):
        covariance[d, d] += process[d] * width
    for j in range(states, every):
        kept = decayed(decay[j - states], step)
        covariance[j, j] += drift[j - states] * (1.0 - kept * kept)


@inlined
def weigh(covariance: FloatArray, moved: FloatArray, state: int, sensor: int, error: float, gain: FloatArray) -> float:
    """Write the gain (A,) of one sensor and condition the covariance; return the variance of its innovation."""
    every = covariance.shape[0]
    total = error
    total += covariance[state, state] + 2.0 * covariance[state, sensor] + covariance[sensor, sensor]
    for a in range(every):
        gain[a] = (covariance[a, state] + covariance[a, sensor]) / total
    for a in range(every):
        for b in range(every):
            moved[a, b] = covariance[a, b] - gain[a] * (covariance[state, b] + covariance[sensor, b])
    for a in range(every):
        for b in range(every):
            covariance[a, b] = moved[a, b] - gain[b] * (moved[a, state] + moved[a, sensor]) + error * gain[a] * gain[b]
    return float(total)


@allocating_kernel
def filter_rows(table: Table, tape: Tape, owners: Ints, path: Path, layout: Layout, starts: FloatArray,
                unknown: FloatArray, tolerance: FloatArray, limits: FloatArray, budget: int, noise: Noise,
                is_held: bool, gains: FloatArray, variances: FloatArray, innovations: FloatArray,
                gradients: FloatArray) -> int:  # fmt: skip
    """Filter every segment; return how many were filtered to their end.

    Args:
        table, tape, owners, path, tolerance, limits, budget: see `integrate_segments`.
        layout: what was measured.
        starts: states (G, D) from which segments begin, of variance `unknown` (D,).
        noise: decides gains, unless these are held.
        is_held: whether `gains` (N, O, A) and `variances` (O, N) are given; else they are written.
        innovations: (O, N), what was measured minus what was foretold; written.
        gradients: (N, O, P) of innovations by constants; written.
    """
    segments, steps, measured, weights, observed = layout
    stage_count = table[1].shape[0]
    nodes, states, sensors, fitted = tape[0].shape[0], tape[4].shape[0], observed.shape[0], owners.shape[0]
    times, inputs, _ = path
    columns, every = fitted + states, states + sensors
    scratch = (
        np.zeros((stage_count, states + inputs.shape[0])),
        np.zeros((stage_count, states, columns)),
        np.zeros((stage_count, nodes)),
        np.zeros(nodes),
        np.zeros((states, states + inputs.shape[0])),
        np.zeros(fitted),
        np.zeros((states, columns)),
        np.zeros((stage_count + 1, states)),
    )
    sensitivity = np.zeros((states, columns))
    flat = (sensitivity.reshape(-1), scratch[6].reshape(-1), scratch[1].reshape(stage_count, states * columns))
    drifting = np.zeros((sensors, fitted))
    covariance, moved = np.zeros((every, every)), np.zeros((every, every))
    y, s, slope = np.zeros(states), np.zeros(sensors), np.zeros(fitted)
    for g in range(segments.shape[0]):
        first, end = segments[g, 0], segments[g, 1]
        s[:] = 0.0
        drifting[:, :] = 0.0
        sensitivity[:, :] = 0.0
        covariance[:, :] = 0.0
        for d in range(states):
            y[d] = starts[g, d]
            covariance[d, d] = unknown[d]
        for j in range(sensors):
            covariance[states + j, states + j] = noise[2][j]
        step = times[first + 1] - times[first] if end > first + 1 else 1.0
        for row in range(first, end):
            if row > first:
                for d in range(states):
                    for k in range(states):
                        sensitivity[d, fitted + k] = 1.0 if d == k else 0.0
                step, budget = advance(
                    table, tape, owners, path, row - 1, tolerance, limits, y, step, budget, flat, True, scratch, False
                )
                if budget < 0:
                    return g
                for j in range(sensors):
                    kept = decayed(noise[3][j], steps[row])
                    s[j] *= kept
                    for p in range(fitted):
                        drifting[j, p] *= kept
                if not is_held:
                    predict(covariance, moved, sensitivity, fitted, noise, times[row] - times[row - 1], steps[row])
            for j in range(sensors):
                if weights[j, row] == 0.0:
                    continue
                d = observed[j]
                if not is_held:
                    variances[j, row] = weigh(
                        covariance, moved, d, states + j, noise[1][j] / weights[j, row], gains[row, j]
                    )
                innovation = measured[j, row] - y[d] - s[j]
                innovations[j, row] = innovation
                for p in range(fitted):
                    slope[p] = -sensitivity[d, p] - drifting[j, p]
                    gradients[row, j, p] = slope[p]
                for k in range(states):
                    gain = gains[row, j, k]
                    y[k] += gain * innovation
                    for p in range(fitted):
                        sensitivity[k, p] += gain * slope[p]
                for k in range(sensors):
                    gain = gains[row, j, states + k]
                    s[k] += gain * innovation
                    for p in range(fitted):
                        drifting[k, p] += gain * slope[p]
    return int(segments.shape[0])
