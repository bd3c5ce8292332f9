"""A stochastic process: simulated ensembles and the densities that they settle into."""

from itertools import pairwise

from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.fit import ROWS
from atoll.report.markup import Element, facts, figure, number, paragraph, pictures, section, table
from atoll_coordinator.result.findings import Density, PathEnsemble


def process(findings: Findings) -> list[Element]:
    """Return the section, none of a model without noise of its own."""
    fitted = findings.result.process
    if fitted is None:
        return []
    entries = [
        ("Steps", f"{fitted.steps}, of {number(fitted.step)} in the median"),
        ("Log-likelihood of a step", f"{number(fitted.log_likelihood)} nats"),
    ]
    ensemble, densities = fitted.ensemble, fitted.stationary or {}
    drawn = [] if ensemble is None else [_ensemble(ensemble, state, findings) for state in ensemble.mean]
    drawn += [_density(density, state, findings) for state, density in densities.items()]
    explained = paragraph(
        "Of the simulated paths the mean, and the bounds that 5 % lie beyond on either side; stationary densities "
        "beside the measured ones."
    )
    return [section("process", "Noise as part of the law", facts(entries), explained, pictures(drawn))]


def _ensemble(ensemble: PathEnsemble, state: str, findings: Findings) -> Element:
    drawn = findings.over_time(f"simulated paths of {state}", state)
    drawn.add_band(ensemble.times, ensemble.lower[state], ensemble.upper[state], "c0")
    drawn.add_line(ensemble.times, ensemble.mean[state], "c0")
    curves = (ensemble.mean, ensemble.lower, ensemble.upper)
    rows = list(zip(ensemble.times, *(curve[state] for curve in curves), strict=True))
    some = [[number(value, 5) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]]
    numbers = table(f"simulated paths of {state}", [findings.result.time, "mean", "5 %", "95 %"], some)
    return figure(drawn.svg(), f"{findings.label(state)}, {ensemble.finite_paths} paths", numbers)


def _density(density: Density, state: str, findings: Findings) -> Element:
    drawn = Chart(f"stationary density of {state}", findings.axis(state), Axis("density"))
    middles = [0.5 * ((low or 0.0) + (high or 0.0)) for low, high in pairwise(density.edges)]
    drawn.add_points(middles, density.measured, "c1")
    drawn.add_line(middles, density.density, "c0")
    curves = zip(middles, density.density, density.measured, strict=True)
    rows = [[number(value) for value in row] for row in curves]
    numbers = table(f"stationary density of {state}", [state, "simulated", "measured"], rows)
    overlap = f"; they overlap by {100 * density.overlap:.0f} %" if density.overlap is not None else ""
    return figure(drawn.svg(), f"{findings.label(state)}: line simulated, dots measured{overlap}", numbers)
