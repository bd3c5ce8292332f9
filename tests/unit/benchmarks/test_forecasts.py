"""The program that measures coverage of forecasts: known systems, held-out ends."""

from benchmarks.forecasts import CHAOTIC, measure, summary, systems


def test_a_table_of_a_known_law_is_forecast_and_covered() -> None:
    outcomes = measure("decay", {"x": "-0.5*x"}, (2.0,), 4.0, 0.01, is_chaotic=False)
    (outcome,) = outcomes
    assert outcome.horizon == 1.0
    assert outcome.error < 1.0
    assert "not chaotic" in summary(outcomes)


def test_systems_are_as_many_as_asked_for_and_the_chaotic_ones() -> None:
    found = [*systems(2, range(20))]
    assert [is_chaotic for *_, is_chaotic in found] == [False, False, *(True for _ in CHAOTIC)]
