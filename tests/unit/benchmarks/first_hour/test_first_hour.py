"""Tables of the first hour: their files say what the cases mean, and what comes back is judged by the law."""

from benchmarks.first_hour.campaign import figures, is_as_it_should_be
from benchmarks.first_hour.cases import CASES
from benchmarks.first_hour.outcomes import Outcome, judge


def result(verdict: str, symbols: dict[str, str], **equations: str) -> dict[str, object]:
    rows = [
        {"variable": name, "expression": text, "verdict": verdict, "reason": ""} for name, text in equations.items()
    ]
    return {"equations": rows, "symbols": symbols, "warnings": []}


def outcome(name: str, asked: dict[str, object]) -> Outcome:
    return Outcome(name, "done", "", judge(CASES[name], asked), 1.0, 1.0)


def test_the_law_is_found_under_any_name() -> None:
    symbols = {"lambda": "lambda_", "class": "class_"}
    contents = result(
        "good", symbols, **{"lambda": "lambda_*(1.1 - 0.4*class_)", "class": "class_*(0.1*lambda_ - 0.4)"}
    )
    prey, hunter = judge(CASES["called lambda, class"], contents)
    assert (prey.is_found, hunter.is_found) == (True, True)
    assert (prey.form, prey.expression) == ("right", "x*(1.1 - 0.4*y)")


def test_another_law_is_not_found_unless_the_columns_determine_each_other() -> None:
    (free,) = judge(CASES["decay"], result("good", {"y": "y"}, y="-0.5*y + 0.001*y*y"))
    assert not free.is_found
    symbols = {"A": "A", "B": "B"}
    bound = judge(CASES["reaction, A + B = 1"], result("good", symbols, A="0.7*B - 0.7", B="0.7*(1 - B)"))
    assert [asked.is_found for asked in bound] == [True, True]
    (near,) = judge(CASES["decay"], result("good", {"y": "y"}, y="-0.52*y"))
    assert (near.form, near.is_found) == ("right", False)


def test_the_velocity_may_stand_in_an_equation_of_second_order() -> None:
    name = "spiral, position alone"
    contents = result("exact", {"x": "x", "x_dot": "x_dot"}, x="-4*x - 0.4*x_dot")
    assert judge(CASES[name], contents)[0].is_found


def test_what_is_relied_on_without_a_law_is_a_fault() -> None:
    name = "white noise, seed 0"
    good = outcome(name, result("good", {"x": "x"}, x="-2*x"))
    doubtful = outcome(name, result("doubtful", {"x": "x"}, x="-2*x"))
    assert (is_as_it_should_be([doubtful]), is_as_it_should_be([good])) == (True, False)
    assert "WRONGLY good white noise, seed 0: x' = -2.0*x" in figures([good, doubtful])


def test_what_broke_is_a_fault_and_what_is_refused_is_not() -> None:
    ends = [Outcome("decay", end, "a sentence", judge(CASES["decay"], {}), 1.0, 1.0) for end in ("broke", "refused")]
    assert [is_as_it_should_be([end]) for end in ends] == [False, True]
    assert "BROKE decay: a sentence" in figures(ends)
