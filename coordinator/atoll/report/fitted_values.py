"""Measured beside fitted values of y = f(X)."""

from atoll.display.series import residuals
from atoll.report.chart import Axis, Chart
from atoll.report.findings import Findings
from atoll.report.markup import Element, figure, number, pictures, section, table
from atoll.report.trajectories import ROWS


def fitted_values(findings: Findings) -> list[Element]:
    """Return the section, none of a model of dynamics: over the variable, of several fitted over measured values."""
    known = findings.result.regression
    if known is None:
        return []
    target, variables = str(findings.result.columns.target), known.variables
    fitted, measured = known.fitted, known.measured
    if len(variables) == 1:
        ((name, values),) = variables.items()
        fit = Chart(f"{target} over {name}", findings.axis(name), findings.axis(target))
        fit.add_points(values, measured, "c0")
        order = [row for _, row in sorted((value, row) for row, value in enumerate(values) if value is not None)]
        fit.add_line([values[row] for row in order], [fitted[row] for row in order], "c1")
    else:
        fit = Chart(f"{target} fitted over measured", Axis("measured"), Axis("fitted"))
        fit.add_points(measured, fitted, "c0")
        known_values = [value for value in measured if value is not None]
        ends = [min(known_values), max(known_values)] if known_values else []
        fit.add_line(ends, ends, "rule")
    left = Chart(f"residuals of {target} over its fitted values", Axis("fitted"), Axis("measured less fitted"))
    left.add_points(fitted, residuals(measured, fitted), "c0")
    rows = list(zip(*variables.values(), measured, fitted, strict=True))
    some = [[number(value, 6) for value in row] for row in rows[:: max(1, len(rows) // ROWS)]]
    numbers = table(f"{target}, measured and fitted", [*variables, "measured", "fitted"], some)
    drawn = [
        figure(fit.svg(), f"{target}: dots measured, line fitted", numbers),
        figure(left.svg(), "what the model leaves", None),
    ]
    return [section("fit", "Measured and fitted", pictures(drawn))]
