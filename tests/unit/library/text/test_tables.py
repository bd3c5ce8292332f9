"""What people are shown beside the equations."""

from typing import Any

import pytest

from atoll.model.equations import plus_minus
from atoll.text.render import (
    MOST_LINES,
    candidates_table,
    constants_line,
    constants_table,
    correlation_lines,
    noise_lines,
    simulation_table,
    summary,
    together_line,
)
from atoll_coordinator.result.equations import Candidate, Constant, SimpleTogether
from atoll_coordinator.result.result import Result


def constant(value: float, fitted: float | None, error: float | None, **more: Any) -> dict[str, Any]:
    return {"value": value, "fitted": fitted, "std_error": error, "interval": None, "identifiable": True, **more}


def constants(*values: dict[str, Any]) -> list[Constant]:
    return [Constant.model_validate(value) for value in values]


def trajectory(name: str, *r2: float | None, held_out: bool = False) -> dict[str, Any]:
    return {"name": name, "held_out": held_out, "r2": dict(zip(("x", "y"), r2, strict=False)), "times": []}


def result(*trajectories: dict[str, Any], verdict: str = "good", **more: Any) -> Result:
    known = [constant(3.0, 2.98, 0.02), constant(0.5, 0.4, 0.3)]
    equation = {"variable": "x", "lhs": "dx/dt", "expression": "3.0*x", "verdict": verdict, "constants": known}
    parts = {"trajectories": list(trajectories)}
    return Result.of({"schema": 1, "equations": [equation], "symbols": {"x": "x"}, "simulation": parts, **more})


LOESS = {"sd": 0.123456, "relative": 0.0512, "method": "loess", "span": 21, "degree": 3, "doubtful_rows": 0}
CLEAN = {"sd": 1e-9, "relative": 1e-9, "method": "interpolation", "span": None, "degree": None, "doubtful_rows": 0}


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (2.98123, 0.0182, "2.981 ± 0.018"),
        (-0.5, 0.61, "-0.50 ± 0.61"),
        (1234.5, 12.3, "1234 ± 12"),
        (1234.5, 123.0, "1234 ± 123"),
        (1.21e-7, 3e-9, "1.210e-07 ± 3.0e-09"),
        (2.5e9, 1e6, "2.5000e+09 ± 1.0e+06"),
        (3.0, 0.0, "3"),
        (0.0, 0.02, "0.000 ± 0.020"),
    ],
)
def test_a_value_has_the_digits_that_its_error_leaves(value: float, error: float, text: str) -> None:
    assert plus_minus(value, error) == text


def test_constants_stand_in_a_line_with_their_errors() -> None:
    given = constants(
        constant(3.0, 2.981, 0.018),
        constant(2.98, 2.98, 0.25),
        constant(2.0, 2.04, 1.5, identifiable=False),
        constant(7.0, None, None),
    )
    assert constants_line(given) == "constants: 3 (2.981 ± 0.018), 2.98 ± 0.25, 2 (2.0 ± 1.5, not determined)"


def test_units_and_bounds_stand_beside_constants() -> None:
    met = constant(0.5, 0.5, None, at_bound=True, interval=[0.48, 0.5])
    given = constants(constant(3.0, 2.981, 0.018, unit="1/h"), constant(2.0, 2.0, 0.1, unit="1"), met)
    line = "constants: 3 (2.981 ± 0.018) 1/h, 2 (2.00 ± 0.10), 0.5 (at its bound, 0.48 to 0.5)"
    assert constants_line(given) == line
    assert constants_table(given)[1].split()[:2] == ["3", "1/h"]
    assert constants_table(given)[3].endswith("at its bound")


def test_constants_known_but_for_rounding_need_no_line() -> None:
    assert constants_line(constants(constant(3.0, 3.0, 1e-12), constant(1.0, None, None))) is None
    assert constants_line([]) is None


def test_the_table_of_constants_has_intervals() -> None:
    given = constants(
        constant(3.0, 2.981, 0.018, interval=[2.9457, 3.0163]), constant(2.0, 2.04, 1.5, identifiable=False)
    )
    heads, first, second = constants_table(given)
    assert heads.split("  ")[-1].strip() == "95 % interval"
    assert first.split() == ["3", "2.981", "±", "0.018", "2.946", "to", "3.016"]
    assert second.endswith("-  not determined by the data")
    assert constants_table(constants(constant(7.0, None, None))) == []
    assert "interval" not in constants_table(constants(constant(3.0, 2.981, 0.018)))[0]


def test_candidates_show_how_close_the_race_was() -> None:
    def contender(text: str, nats: float | None, held_out: float | None, **more: bool) -> Candidate:
        shown = {"expression": text, "complexity": 3, "r2": 0.998, "selected": nats == 0.0}
        return Candidate.model_validate({**shown, "nats": nats, "held_out_r2": held_out, "origin": "front", **more})

    lines = candidates_table([contender("a*x", 0.0, 0.9), contender("a+x", 2.13, None)], str.upper)
    assert " ".join(lines[0].split()) == "candidate Δ description length R2 held out size origin expression"
    assert lines[1].split() == ["*", "0.0", "0.9980", "0.9000", "3", "front", "A*X"]
    assert lines[2].split() == ["2.1", "0.9980", "-", "3", "front", "A+X"]
    without = candidates_table([contender("a*x", 0.0, None), contender("a+x", None, None)], str)
    assert "held" not in without[0]
    assert candidates_table([contender("a*x", 0.0, None)], str) == []
    crossed = [contender(text, 0.0, 0.9, cross_validated=True) for text in ("a", "b", "c", "d")]
    heads, *rest = candidates_table(crossed, str, most=2)
    assert heads.split()[5] == "cross-validated"
    assert [line.split()[-1] for line in rest[:3]] == ["a", "b", "c"]
    assert rest[3:] == ["    1 more: coordinator result"]


def test_noise_is_said_in_a_line_for_each_state() -> None:
    noise = {"x": {**LOESS, "outliers": 1}, "y": {**CLEAN, "doubtful_rows": 9, "outliers": 0}}
    assert noise_lines(result(noise=noise)) == [
        "noise of x: 0.123, 5.1 % of the standard deviation; loess of degree 3 over 21 rows; 1 outlier",
        "noise of y: negligible; interpolated; derivatives doubtful on 9 rows",
    ]


def test_residuals_and_reasons_are_said_where_they_are_known() -> None:
    largest = {"value": -0.5, "trajectory": "2", "time": 3.25}
    times = (("end", [0.0, 0.1]), ("end", [9.0]), ("jump", [2.0]))
    doubtful = [{"trajectory": "1", "reason": reason, "times": lines} for reason, lines in times]
    lines = {**LOESS, "doubtful_rows": 4, "outliers": 0, "residual_rms": 0.1, "largest_residual": largest}
    (line,) = noise_lines(result(noise={"x": {**lines, "doubtful": doubtful}}))
    assert "; residuals 0.1, the largest -0.5 at t = 3.25 of trajectory 2; " in line
    assert line.endswith("; not used: 3 near ends, 1 at jumps")
    assert noise_lines(result()) == []


def test_the_summary_is_two_lines_and_exact_models_need_none() -> None:
    several = (trajectory("1", 0.99, 0.98), trajectory("2", 0.97, 1.0), trajectory("3", 0.9, 0.95, held_out=True))
    summary_line = summary(result(*several, noise={"x": LOESS, "y": CLEAN}))
    assert summary_line == [
        "noise: x 5.1 % of the standard deviation",
        "simulation: R2 at least 0.9700 on 2 trajectories, 0.9000 on 1 held out",
    ]
    broken = summary(result(trajectory("1", 0.99, None), trajectory("2", 0.5, 0.5)))
    assert broken == ["simulation: R2 at least 0.5000 on 1 trajectory, 1 ended early"]
    assert summary(result(*several, verdict="exact", noise={"x": CLEAN})) == []
    assert summary(result(trajectory("1"))) == []


def test_simulations_stand_in_a_table_and_of_many_the_worst() -> None:
    lines = simulation_table(result(trajectory("1", 0.99, 0.98), trajectory("day 2", 0.97, None, held_out=True)))
    assert [line.split() for line in lines[1:]] == [
        ["trajectory", "x", "y"],
        ["1", "0.9900", "0.9800"],
        ["day", "2", "0.9700", "-", "held", "out"],
    ]
    many = simulation_table(result(*(trajectory(str(index), 0.01 * index, 1.0) for index in range(50))))
    assert len(many) == MOST_LINES + 3
    assert many[2].split() == ["0", "0.0000", "1"]
    assert many[-1].strip() == f"the {MOST_LINES} worst of 50"
    assert simulation_table(result()) == []


def test_constants_that_are_hardly_told_apart_are_named() -> None:
    def pair(first: int, second: int, value: float | None) -> dict[str, Any]:
        places = [{"variable": "x", "constant": index} for index in (first, second)]
        return {"first": places[0], "second": places[1], "value": value}

    lines_shown = correlation_lines(result(correlations=[pair(0, 1, 0.96), pair(1, 0, -0.999), pair(0, 0, None)]))
    assert lines_shown == [
        "strongly correlated: 0.5 of x and 3 of x (c1), correlation -0.999",
        "strongly correlated: 3 of x (c1) and 0.5 of x, correlation 0.960",
    ]


def test_a_constant_of_infinite_error_is_said_not_to_be_determined() -> None:
    loose = constants(constant(2.0, 2.0, None, identifiable=False))
    assert constants_line(loose) == "constants: 2 (not determined)"
    assert "not determined by the data" in constants_table(loose)[1]


def test_simple_numbers_together_have_a_line_with_their_odds() -> None:
    together = SimpleTogether(constants=(0, 1), values=(0.9, 1.0 / 9.0), odds=14.7, chi_square=0.61)
    assert together_line(together) == ["    0.9 and 0.111111 together (chi-square 0.61): odds 15 against other numbers"]
    assert together_line(None) == together_line(SimpleTogether(constants=(0, 1), values=(0.9, 1.0 / 9.0))) == []
