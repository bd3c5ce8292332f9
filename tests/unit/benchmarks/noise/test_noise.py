"""Noisy searches: how answers are judged and summed up, and how a campaign is resumed."""

import dataclasses

import pytest

from atoll_core.errors import DataError, UsageError
from benchmarks.harness.journal import Journal
from benchmarks.judging.coverage import Covered
from benchmarks.noise import __main__ as noise
from benchmarks.noise.data import Key, case
from benchmarks.noise.judging import EquationOutcome, Outcome, outcome
from benchmarks.noise.tables import misses, summarized

KEY = Key("atoll", "lotka_volterra", 0.05, 100)
RESPIRATION = Key("atoll", "bacterial_respiration", 0.05, 100)


def equation(variable, expression, constants=(), **more):
    return {"variable": variable, "lhs": f"d{variable}/dt", "expression": expression, "constants": constants, **more}


def constant(value, low, high):
    return {"value": value, "fitted": value, "std_error": 0.1, "interval": [low, high], "identifiable": True}


X = equation(
    "x",
    "x*(3.05 - 1.96*y - x)",
    [constant(3.05, 2.9, 3.2), constant(1.96, 1.94, 1.98)],
    verdict="good",
    reason="few contenders",
)
Y = equation("y", "2.1*y - 0.3*y**2", front=[{"expression": "y*(2.0 - x - y)"}], candidates=[{"expression": "y"}])


def judged(*equations, key=KEY):
    return outcome(key, case(key), {"equations": list(equations), "seconds": 3.0, "digest": "d"}, {"refining": 1.0})


@pytest.fixture(scope="module")
def lotka():
    return judged(X, Y)


def test_an_equation_in_form_has_errors_and_intervals_of_its_constants(lotka):
    x = lotka.equations[0]
    assert (x.found, x.in_form, x.grade, x.elsewhere) == (True, True, "good", None)
    assert x.constants_error == pytest.approx(0.02)
    assert [(constant.is_covered, round(constant.truth, 6)) for constant in x.constants] == [(True, 3.0), (False, 2.0)]


def test_an_equation_that_is_not_in_form_is_looked_for_elsewhere(lotka):
    y = lotka.equations[1]
    assert (y.found, y.in_form, y.constants, y.elsewhere) == (False, False, None, "front")
    assert y.function_error > 0.05
    assert "the truth is among the front" in misses([lotka])[0]


EQUATION = EquationOutcome(
    variable="x", expression="x", found=True, in_form=True, reason="the same form", constants_error=0.02,
    function_error=0.03, elsewhere=None, constants=(), r2=0.95, grade="good",
)  # fmt: skip
MISSED = dataclasses.replace(
    EQUATION, variable="y", found=False, in_form=False, elsewhere="contenders", constants=None, r2=0.5, grade="doubtful"
)
COVERED = Covered(2.0, 2.01, 2.0, 1.9, 2.1, True)
UNCOVERED = dataclasses.replace(COVERED, low=2.05)


def outcomes():
    """Three seeds: both equations found, one, one."""
    whole = (dataclasses.replace(EQUATION, constants=(COVERED, UNCOVERED)), dataclasses.replace(EQUATION, variable="y"))
    half = (dataclasses.replace(EQUATION, constants_error=0.06, constants=(COVERED,)), MISSED)
    return [
        Outcome(dataclasses.replace(KEY, seed=seed), equations, 4.0 + seed, {"refining": 2.0})
        for seed, equations in ((0, whole), (1, half), (2, half))
    ]


def test_counts_are_medians_over_seeds_and_errors_over_all_equations_found():
    (summed,) = summarized(outcomes())
    assert (summed.seeds, summed.equations, summed.found, summed.foretold, summed.elsewhere) == (3, 2, 1, 1, 2)
    assert (summed.constants_error, summed.seconds, summed.longest_s) == (0.04, 5.0, 6.0)
    assert (summed.intervals, summed.covered, summed.coverage) == (4, 3, 0.75)
    assert summed.relative_width == pytest.approx(0.1)


def journal(path, *, resume=False):
    return Journal("noise", Outcome, path, ["--seeds", "0"], resume=resume)


def test_an_outcome_is_read_back_as_it_was_written(tmp_path, lotka):
    path = tmp_path / "lines.jsonl"
    journal(path).add(lotka, {"equations": [X], "seconds": 3.0, "more": 1})
    again = journal(path, resume=True)
    assert again.outcomes == {KEY: lotka}
    assert again.answers == {KEY: {"equations": [X], "seconds": 3.0}}


def test_a_line_that_was_cut_off_is_done_again(tmp_path, lotka):
    path = tmp_path / "lines.jsonl"
    journal(path).add(lotka)
    path.write_text(path.read_text() + '{"outcome": {"key"')
    journal(path, resume=True).add(dataclasses.replace(lotka, key=RESPIRATION))
    assert list(journal(path, resume=True).outcomes) == [KEY, RESPIRATION]


def test_files_are_not_overwritten_and_others_not_resumed(tmp_path):
    path = tmp_path / "lines.jsonl"
    path.write_text('{"outcome": 3}\n')
    with pytest.raises(UsageError, match="exists already"):
        journal(path)
    with pytest.raises(DataError, match="line 1"):
        journal(path, resume=True)
    with pytest.raises(UsageError, match="cannot be read"):
        journal(tmp_path / "none", resume=True)


class Told:
    """Answers every search with the truth."""

    def __init__(self):
        self.seeds = []

    def solve(self, title, table, config, watch):
        self.seeds.append(config.seed)
        return {"equations": [X, equation("y", "y*(2.0 - x - y)")], "seconds": 1.0}


@pytest.mark.slow
def test_a_campaign_does_what_is_missing_and_can_be_judged_again(tmp_path, monkeypatch, capsys):
    told, path = Told(), tmp_path / "lines.jsonl"
    monkeypatch.setattr("benchmarks.harness.campaign.searching", lambda workers: _Given(told))
    words = ["--systems", "lotka_volterra", "--levels", "0.05"]
    assert noise.main([*words, "--seeds", "100", "--out", str(path)]) == 0
    assert noise.main([*words, "--seeds", "100-101", "--resume", str(path), "--judge-again"]) == 0
    assert told.seeds == [100, 101]
    assert "2 of 2" in capsys.readouterr().out


class _Given:
    def __init__(self, value):
        self._value = value

    def __enter__(self):
        return self._value

    def __exit__(self, *_):
        return None
