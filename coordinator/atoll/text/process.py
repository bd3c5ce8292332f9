"""What a result says of a stochastic process as a whole, in lines of text."""

from collections.abc import Sequence
from typing import Final

from atoll.text.tables import percent, plus_minus
from atoll_coordinator.result.findings import Density, PathEnsemble, Process
from atoll_coordinator.result.result import Result

_EULER_MARUYAMA: Final = "rows are the steps of Euler and Maruyama's method rather than samples of a process in time"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def process_lines(result: Result) -> list[str]:
    """Return lines about the process of a result; none when it has none."""
    process = result.process
    if process is None:
        return []
    lines = [*_discretisation_line(process), *_noise_lines(process)]
    if process.ensemble is not None:
        lines.append(_ensemble_line(process.ensemble))
    if process.stationary is None:
        reason = "not sought: there are inputs" if result.columns.inputs else "none that simulations settle into"
        return [*lines, f"stationary density: {reason}"]
    return [*lines, *(line for state, density in process.stationary.items() for line in _density_lines(state, density))]


def _discretisation_line(process: Process) -> list[str]:
    if process.discretisation != "Euler-Maruyama":
        return []
    return [f"{_EULER_MARUYAMA} ({_short(process.discretisation_nats)} nats shorter so)"]


def _noise_lines(process: Process) -> list[str]:
    return [
        f"errors of measurement of {state}: {plus_minus(noise.sd or 0.0, noise.std_error or 0.0)}"
        for state, noise in process.measurement_noise.items()
    ]


def _ensemble_line(ensemble: PathEnsemble) -> str:
    ranges = [
        f"{state} from {_short(ensemble.lower[state][-1])} to {_short(ensemble.upper[state][-1])}"
        for state in ensemble.mean
    ]
    start = f"{ensemble.finite_paths} paths from the beginning of trajectory {ensemble.trajectory}"
    return f"ensemble: {start}; at t = {_short(ensemble.times[-1], 6)} 90 % have {', '.join(ranges)}"


def _density_lines(state: str, density: Density) -> list[str]:
    sizes = f"{_short(density.mean)} ± {_short(density.sd)}"
    overlap = f"overlaps the measured one by {percent(density.overlap)}"
    bars = f"    {_short(density.edges[0])} {_bars(density.density)} {_short(density.edges[-1])}"
    return [f"stationary density of {state}: {sizes}, {overlap}", bars]


def _short(value: float | None, digits: int = 3) -> str:
    return "?" if value is None else f"{value:.{digits}g}"


def _bars(values: Sequence[float | None]) -> str:
    heights = [value or 0.0 for value in values]
    most = max(heights, default=0.0) or 1.0
    return "".join(_BLOCKS[round((len(_BLOCKS) - 1) * height / most)] for height in heights)
