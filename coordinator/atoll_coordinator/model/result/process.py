"""What a result says of a stochastic process as a whole, as a dictionary for ``result.json``."""

from typing import Any, Final

from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.refinement import MeasuredDensity, ProcessFindings
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.stochastic.paths import Ensemble

MOST_POINTS: Final = 101
"""Times at which an ensemble is reported."""


def process(its: ProcessFindings | None, recording: ProcessRecording | None) -> dict[str, Any] | None:
    """Return what is known of the process, times as in the user's file; None when the job seeks none."""
    if its is None or recording is None:
        return None
    return {
        "steps": its.steps,
        "step": finite(its.length),
        "discretisation": its.discretisation,
        "discretisation_nats": finite(its.discretisation_nats),
        "log_likelihood": finite(its.log_likelihood),
        "held_out_log_likelihood": finite(its.held_out),
        "measurement_noise": {
            state: {
                "sd": finite(sd.value),
                "std_error": finite(sd.std_error),
                "interval": None if sd.interval is None else [finite(bound) for bound in sd.interval],
            }
            for state, sd in its.noise.items()
        },
        "ensemble": _ensemble(its.ensemble, its.trajectory, recording.offset),
        "stationary": _stationary(its.stationary),
    }


def _ensemble(its: Ensemble | None, trajectory: str, offset: float) -> dict[str, Any] | None:
    if its is None:
        return None
    rows = thinned(len(its.t), MOST_POINTS)
    curves = {"mean": its.mean, "lower": its.lower, "median": its.median, "upper": its.upper}
    return {
        "trajectory": trajectory,
        "paths": len(its.x),
        "finite_paths": len(its.finite),
        "times": curve(its.t[rows] + offset, digits=12),
        **{
            key: {state: curve(values[rows, index]) for index, state in enumerate(its.states)}
            for key, values in curves.items()
        },
    }


def _stationary(its: MeasuredDensity | None) -> dict[str, Any] | None:
    if its is None:
        return None
    settled = its.settled
    return {
        state: {
            "mean": finite(float(settled.mean[index])),
            "sd": finite(float(settled.sd[index])),
            "overlap": finite(float(its.overlap[index])),
            "edges": curve(settled.edges[index]),
            "density": curve(settled.density[index]),
            "measured": curve(its.measured[index]),
        }
        for index, state in enumerate(settled.states)
    }
