"""What a result says of a stochastic process as a whole."""

from typing import Final

from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.refinement import Constant, MeasuredDensity, ProcessFindings
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.result.findings import Density, MeasurementNoise, PathEnsemble, Process
from atoll_coordinator.stochastic.paths import Ensemble
from atoll_core.data.dataset import FloatArray

MOST_POINTS: Final = 101
"""Times at which an ensemble is reported."""


def process(findings: ProcessFindings | None, recording: ProcessRecording | None) -> Process | None:
    """Return what is known of the process, times as in the user's file; None when the job seeks none."""
    if findings is None or recording is None:
        return None
    return Process(
        steps=findings.steps,
        step=findings.length,
        discretisation=findings.discretisation,
        discretisation_nats=finite(findings.discretisation_nats),
        log_likelihood=finite(findings.log_likelihood),
        held_out_log_likelihood=finite(findings.held_out),
        measurement_noise={state: _noise(sd) for state, sd in findings.noise.items()},
        ensemble=_ensemble(findings.ensemble, findings.trajectory, recording.offset),
        stationary=_stationary(findings.stationary),
    )


def _noise(sd: Constant) -> MeasurementNoise:
    interval = None if sd.interval is None else (finite(sd.interval[0]), finite(sd.interval[1]))
    return MeasurementNoise(sd=finite(sd.value), std_error=finite(sd.std_error), interval=interval)


def _ensemble(ensemble: Ensemble | None, trajectory: str, offset: float) -> PathEnsemble | None:
    if ensemble is None:
        return None
    rows = thinned(len(ensemble.t), MOST_POINTS)

    def curves(values: FloatArray) -> dict[str, tuple[float | None, ...]]:
        return {state: curve(values[rows, index]) for index, state in enumerate(ensemble.states)}

    return PathEnsemble(
        trajectory=trajectory,
        paths=len(ensemble.x),
        finite_paths=len(ensemble.finite),
        times=curve(ensemble.t[rows] + offset, digits=12),
        mean=curves(ensemble.mean),
        lower=curves(ensemble.lower),
        median=curves(ensemble.median),
        upper=curves(ensemble.upper),
    )


def _stationary(density: MeasuredDensity | None) -> dict[str, Density] | None:
    if density is None:
        return None
    settled = density.settled
    return {
        state: Density(
            mean=finite(float(settled.mean[index])),
            sd=finite(float(settled.sd[index])),
            overlap=finite(float(density.overlap[index])),
            edges=curve(settled.edges[index]),
            density=curve(settled.density[index]),
            measured=curve(density.measured[index]),
        )
        for index, state in enumerate(settled.states)
    }
