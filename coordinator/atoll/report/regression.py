"""Measured beside fitted values of y = f(X)."""

from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, element, figure, number, section, table
from atoll.report.trajectories import ROWS


def regression(its: Findings) -> list[Element]:
    """Return the section, none of a model of dynamics: over the variable, of several fitted over measured values."""
    found = its.result.get("regression")
    if not found:
        return []
    target, variables = str(its.system["target"]), found["variables"]
    fitted, measured = found["fitted"], found["measured"]
    if len(variables) == 1:
        ((name, values),) = variables.items()
        fit = Chart(f"{target} over {name}", Axis(its.labelled(name)), Axis(its.labelled(target)))
        fit.add_points(values, measured, "c0")
        order = sorted(range(len(values)), key=values.__getitem__)
        fit.add_line([values[row] for row in order], [fitted[row] for row in order], "c1")
    else:
        fit = Chart(f"{target} fitted over measured", Axis("measured"), Axis("fitted"))
        fit.add_points(measured, fitted, "c0")
        fit.add_line([min(measured), max(measured)], [min(measured), max(measured)], "rule")
    residuals = [one - other if other is not None else None for one, other in zip(measured, fitted, strict=True)]
    left = Chart(f"residuals of {target} over its fitted values", Axis("fitted"), Axis("measured less fitted"))
    left.add_points(fitted, residuals, "c0")
    rows = zip(*variables.values(), measured, fitted, strict=True)
    some = list(rows)[:: max(1, found["listed"] // ROWS)]
    numbers = table(
        f"{target}, measured and fitted",
        [*variables, "measured", "fitted"],
        [[number(value, 6) for value in row] for row in some],
    )
    pictures = element(
        "div", figure(fit.svg(), f"{target}: dots measured, line fitted", numbers),
        figure(left.svg(), "what the model leaves", None), class_="pictures",
    )  # fmt: skip
    return [section("fit", "Measured and fitted", pictures)]
