"""What a result says of a stochastic process as a whole, in lines of text."""

from collections.abc import Sequence
from typing import Final

from atoll.model.equations import number_text, plus_minus
from atoll.text.tables import percent
from atoll_coordinator.result.findings import Density, PathEnsemble
from atoll_coordinator.result.result import Result

_EULER_MARUYAMA: Final = "rows are the steps of Euler and Maruyama's method rather than samples of a process in time"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def process_lines(result: Result) -> list[str]:
    """Return lines about the process of a result; none when it has none."""
    process = result.process
    if process is None:
        return []
    lines = []
    if process.discretisation == "Euler-Maruyama":
        lines.append(f"{_EULER_MARUYAMA} ({number_text(process.discretisation_nats)} nats shorter so)")
    for state, noise in process.measurement_noise.items():
        lines.append(f"errors of measurement of {state}: {plus_minus(noise.sd or 0.0, noise.std_error or 0.0)}")
    if process.ensemble is not None:
        lines.append(_ensemble_line(process.ensemble))
    if process.stationary is None:
        reason = "not sought: there are inputs" if result.columns.inputs else "none that simulations settle into"
        lines.append(f"stationary density: {reason}")
    for state, density in (process.stationary or {}).items():
        lines += _density_lines(state, density)
    return lines


def _ensemble_line(ensemble: PathEnsemble) -> str:
    ranges = [
        f"{state} from {number_text(ensemble.lower[state][-1])} to {number_text(ensemble.upper[state][-1])}"
        for state in ensemble.mean
    ]
    start = f"{ensemble.finite_paths} paths from the initial state of trajectory {ensemble.trajectory}"
    return f"ensemble: {start}; at t = {number_text(ensemble.times[-1], 6)} 90 % have {', '.join(ranges)}"


def _density_lines(state: str, density: Density) -> list[str]:
    sizes = f"{number_text(density.mean)} ± {number_text(density.sd)}"
    overlap = f"overlaps the measured one by {percent(density.overlap)}"
    bars = f"    {number_text(density.edges[0])} {_bars(density.density)} {number_text(density.edges[-1])}"
    return [f"stationary density of {state}: {sizes}, {overlap}", bars]


def _bars(values: Sequence[float | None]) -> str:
    heights = [value or 0.0 for value in values]
    most = max(heights, default=0.0) or 1.0
    return "".join(_BLOCKS[round((len(_BLOCKS) - 1) * height / most)] for height in heights)
