"""What a result says of a stochastic process as a whole: as a dictionary for ``result.json``, and in lines of text."""

from collections.abc import Mapping
from typing import Any, Final

from atoll.stochastic.paths import Ensemble
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.refinement import MeasuredDensity, ProcessFindings
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.model.result.tables import percent, plus_minus

MOST_POINTS: Final = 101
"""Times at which an ensemble is reported."""
_EULER_MARUYAMA: Final = "rows are the steps of Euler and Maruyama's method rather than samples of a process in time"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


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


def process_lines(result: Mapping[str, Any]) -> list[str]:
    """Return lines about the process of a result; none when it has none."""
    its = result.get("process")
    if its is None:
        return []
    lines = [
        f"errors of measurement of {state}: {plus_minus(noise['sd'], noise['std_error'] or 0.0)}"
        for state, noise in its["measurement_noise"].items()
    ]
    if its["discretisation"] == "Euler-Maruyama":
        lines.insert(0, f"{_EULER_MARUYAMA} ({its['discretisation_nats']:.3g} nats shorter so)")
    ensemble = its["ensemble"]
    if ensemble is not None:
        ranges = [
            f"{state} from {ensemble['lower'][state][-1]:.3g} to {ensemble['upper'][state][-1]:.3g}"
            for state in ensemble["mean"]
        ]
        start = f"{ensemble['finite_paths']} paths from the beginning of trajectory {ensemble['trajectory']}"
        lines.append(f"ensemble: {start}; at t = {ensemble['times'][-1]:.6g} 90 % have {', '.join(ranges)}")
    if its["stationary"] is None:
        has_inputs = bool((result.get("system") or {}).get("inputs"))
        reason = "not sought: there are inputs" if has_inputs else "none that simulations settle into"
        return [*lines, f"stationary density: {reason}"]
    for state, density in its["stationary"].items():
        edges = density["edges"]
        lines.append(
            f"stationary density of {state}: {density['mean']:.3g} ± {density['sd']:.3g}, overlaps the measured one by "
            f"{percent(density['overlap'])}"
        )
        lines.append(f"    {edges[0]:.3g} {_bars(density['density'])} {edges[-1]:.3g}")
    return lines


def _bars(values: list[float]) -> str:
    most = max(values) or 1.0
    return "".join(_BLOCKS[round((len(_BLOCKS) - 1) * value / most)] for value in values)
