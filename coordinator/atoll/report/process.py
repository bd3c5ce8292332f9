"""A stochastic process: simulated ensembles and the densities that they settle into."""

from itertools import pairwise

from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, facts, figure, number, paragraph, section, table
from atoll.report.trajectories import ROWS


def process(its: Findings) -> list[Element]:
    """Return the section, none of a model without noise of its own."""
    found = its.result.get("process")
    if not found:
        return []
    said = [
        ("Steps", f"{found['steps']}, of {number(found['step'])} in the median"),
        ("Log-likelihood of a step", f"{number(found['log_likelihood'])} nats"),
    ]
    pictures = [_ensemble(state, its) for state in (found["ensemble"] or {}).get("mean") or ()]
    pictures += [_density(state, its) for state in found["stationary"] or ()]
    return [
        section(
            "process",
            "Noise as part of the law",
            facts(said),
            paragraph(
                "Of the simulated paths the mean, and the bounds that 5 % lie beyond on either side; stationary "
                "densities beside the measured ones."
            ),
            element("div", *pictures, class_="pictures"),
        )
    ]


def _ensemble(state: str, its: Findings) -> Element:
    found = its.result["process"]["ensemble"]
    drawn = Chart(f"simulated paths of {state}", Axis(its.labelled(its.time)), Axis(its.labelled(state)))
    drawn.add_band(found["times"], found["lower"][state], found["upper"][state], "c0")
    drawn.add_line(found["times"], found["mean"][state], "c0")
    rows = list(zip(found["times"], *(found[key][state] for key in ("mean", "lower", "upper")), strict=True))
    numbers = table(
        f"simulated paths of {state}",
        [its.time, "mean", "5 %", "95 %"],
        [[number(value, 5) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]],
    )
    return figure(drawn.svg(), f"{its.labelled(state)}, {found['finite_paths']} paths", numbers)


def _density(state: str, its: Findings) -> Element:
    found = its.result["process"]["stationary"][state]
    drawn = Chart(f"stationary density of {state}", Axis(its.labelled(state)), Axis("density"))
    edges = found["edges"]
    middles = [0.5 * (low + high) for low, high in pairwise(edges)]
    drawn.add_points(middles, found["measured"], "c1")
    drawn.add_line(middles, found["density"], "c0")
    rows = zip(middles, found["density"], found["measured"], strict=True)
    numbers = table(
        f"stationary density of {state}",
        [state, "simulated", "measured"],
        [[number(value) for value in row] for row in rows],
    )
    overlap = f"; they overlap by {100 * found['overlap']:.0f} %" if found.get("overlap") is not None else ""
    return figure(drawn.svg(), f"{its.labelled(state)}: line simulated, dots measured{overlap}", numbers)
