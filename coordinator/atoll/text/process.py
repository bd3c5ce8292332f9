"""What a result says of a stochastic process as a whole, in lines of text."""

from collections.abc import Mapping
from typing import Any, Final

from atoll.text.tables import percent, plus_minus

_EULER_MARUYAMA: Final = "rows are the steps of Euler and Maruyama's method rather than samples of a process in time"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


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
