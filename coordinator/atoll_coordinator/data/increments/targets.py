"""The regression problems of a process: a target for each drift and for each component of the diffusion. Pure."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from atoll_coordinator.data.differentiation.value_scale import derivative_standard_deviation
from atoll_coordinator.data.increments.moments import BinnedMoments, bin_moments
from atoll_coordinator.data.increments.roughness import is_driven, noise_shares
from atoll_coordinator.data.increments.steps import take_steps
from atoll_coordinator.data.recording import Preparation, ProcessRecording, SampledPath
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Dataset, FloatArray, Target
from atoll_core.errors import DataError


def assemble_process(measurements: Measurements, equations: Collection[str], symbols: Mapping[str, str]) -> Preparation:
    """Return the problems of the `equations`, as far as the data show them, and the recording of a process.

    `symbols` has by column name the name in expressions. Raises DataError for too few steps, or a state without noise.
    """
    process = record_process(measurements, symbols)
    steps = take_steps(process)
    fewest = SETTINGS.process.fewest_steps
    if len(steps.lengths) < fewest:
        count = f"there are {len(steps.lengths)} steps from row to row"
        raise DataError(f"{count}; a stochastic process takes at least {fewest}")
    for number, (state, share) in enumerate(zip(process.states, noise_shares(steps).tolist(), strict=True)):
        if share < SETTINGS.process.least_noise and not is_driven(steps, number):
            raise DataError(
                f"state '{state}' moves without noise, its own or that of a state it follows; leave out --stochastic, "
                "or make it an input with --inputs if only other states have noise"
            )
    moments = bin_moments(steps)
    roles = measurements.roles
    process = replace(process, noise=moments.noise, pairs=tuple(moments.products))
    values = [*moments.drift, *moments.products.values()]
    targets = tuple(
        _target(name, roles.left_hand_side(name), moment, error)
        for name, moment, error in zip([*process.states, *process.components], values, moments.errors, strict=True)
        if name in equations
    )
    warnings = (*measurements.warnings, *_remarks(process, moments, len(steps.lengths)))
    dataset = Dataset(tuple(symbols.values()), moments.points, targets, dict(symbols), warnings)
    return Preparation(dataset, process=process)


def record_process(measurements: Measurements, symbols: Mapping[str, str]) -> ProcessRecording:
    """Return the trajectories as they were sampled, rows without missing values."""
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    inputs = measurements.inputs
    paths = []
    for number, (name, times, held_out) in enumerate(zip(whole.names, whole.times, measurements.held_out, strict=True)):
        states = np.array([whole.states[state][number] for state in roles.states])
        acting = np.array([parts[number] for parts in inputs]).reshape(len(inputs), len(times))
        rows = np.flatnonzero(np.isfinite(states).all(axis=0))
        states, acting = (np.ascontiguousarray(array[:, rows]) for array in (states, acting))
        paths.append(SampledPath(name, times[rows], states, acting, held_out))
    return ProcessRecording(
        roles.states,
        tuple(symbols[name] for name in roles.states),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        whole.offset,
        tuple(paths),
    )


def _target(name: str, lhs: str, values: FloatArray, error: float) -> Target:
    values = np.ascontiguousarray(values)
    scale = derivative_standard_deviation(name, values)
    return Target(name, lhs, values, error / scale, scale, error / scale)


def _remarks(process: ProcessRecording, moments: BinnedMoments, steps: int) -> list[str]:
    groups = f"{moments.points.shape[1]} groups of neighbouring rows"
    remarks = [f"The search sees means over {groups}; models are judged by all {steps} steps."]
    for state, variance in zip(process.states, moments.noise.tolist(), strict=True):
        if variance > 0.0:
            remarks.append(
                f"Steps of '{state}' undo the ones before them: errors of measurement of about {variance**0.5:.2g} "
                "stand beside the noise of the process."
            )
    return remarks
