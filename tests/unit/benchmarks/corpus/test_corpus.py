"""The corpus: equal seeds give equal tables, qualities are what they say, outcomes are judged and summed up."""

import dataclasses

import numpy as np
import pytest

from benchmarks.corpus import __main__ as corpus
from benchmarks.corpus.campaign import configuration
from benchmarks.corpus.cases import Key, make_case, smallest_t
from benchmarks.corpus.families import FAMILIES
from benchmarks.corpus.lengths import excess_of_truth
from benchmarks.corpus.outcomes import judge_job
from benchmarks.corpus.systems import CorpusSystem, solution
from benchmarks.corpus.tables import by_grade, by_quality, equation_rows

KEY = Key("lotka_volterra", 2, 1, "even", "noise-0.01", 0)
RANDOM = Key("random", 1, 4, "even", "exact", 3)


def result(x, y, **more):
    return {
        "equations": [
            {"variable": "x", "expression": x, "verdict": "exact", **more},
            {"variable": "y", "expression": y, "verdict": "good"},
        ],
        "seconds": 2.0,
        "digest": "d",
    }


@pytest.fixture(scope="module")
def lotka():
    return make_case(KEY)


@pytest.fixture(scope="module")
def judged(lotka):
    return judge_job(KEY, lotka, result("1.1*x - 0.4*x*y + 0.001*y**3", "0.1*x*y - 0.4*y"))


def test_a_key_has_one_table():
    first, second = make_case(RANDOM), make_case(RANDOM)
    np.testing.assert_array_equal(first.table.columns, second.table.columns)
    assert first.table.rows == 400


def test_a_constant_that_the_data_do_not_show_is_not_known():
    """What x' = k1 - k2*x does near its rest is that of the quotient of the constants."""
    still = CorpusSystem("decay", FAMILIES["decay"].equations, {"k1": 1.0, "k2": 1.0}, ((1.0, 1.0),), 5.0, ((1.001,),))
    times = [np.linspace(0.0, 5.0, 100)]
    clean = [solution(still.field(), (1.001,), times[0])]
    measured = [clean[0] + 0.01 * np.random.default_rng(0).standard_normal(clean[0].shape)]
    assert smallest_t(still, still.starts, times, clean, measured)["x"] < 1.0


def test_a_job_is_judged(judged):
    x, y = judged.equations
    assert (x.form, x.extra, x.grade, x.is_right) == ("extra", 1, "exact", False)
    assert (y.form, y.extra, y.is_right, y.is_identifiable) == ("right", 0, True, True)
    assert y.r2 < 1.0


def test_the_truth_is_looked_for_elsewhere(lotka):
    text = "1.1*x - 0.41*x*y"
    judgement = judge_job(
        KEY, lotka, result("1.1*x", "0.1*x*y - 0.4*y", candidates=[{"expression": text, "nats": 2.5}])
    )
    assert (judgement.equations[0].elsewhere, judgement.equations[0].nats) == ("candidates", 2.5)


def test_tables_count_what_they_say(judged):
    assert "| atoll | noise-0.01 | 1-2 | 2 | 2 | 1 of 2 (50 %) | 1 |" in by_quality([judged])
    assert "| exact | 1 | 0 of 1 (0 %) |" in by_grade([judged])
    assert "| good | 1 | 1 of 1 (100 %) |" in by_grade([judged])
    several = dataclasses.replace(judged, key=dataclasses.replace(judged.key, trajectories=4))
    counted = by_grade([judged, several]).splitlines()
    singles = judged.key.trajectories == 1
    assert [line.split(" | ")[1::3] for line in counted[2:]] == [["2", "1" if singles else "0"]] * 2
    wrong = equation_rows([judged], only_wrong=True)
    assert "extra 1" in wrong
    assert "`0.1*x*y - 0.4*y`" not in wrong


def test_keys_of_the_command_line():
    parse = corpus.main.parser.parse_args
    named = corpus.keys(parse(["--named"]))
    assert len(named) == 30
    assert {key.trajectories for key in named} == {1}
    drawn = corpus.keys(parse(["--seeds", "0-3", "--states", "1", "--qualities", "exact", "noise-0.1", "--in-turn"]))
    assert [key.quality for key in drawn] == ["noise-0.1", "exact", "noise-0.1", "exact"]


def test_the_truth_is_the_shorter_description_where_data_decide(lotka):
    config = configuration(KEY, lotka, None, {})
    truths = lotka.system.truths
    other = excess_of_truth(lotka.table, config, truths, ["1.1*x - 0.4*x*y*y", truths["y"]])
    runaway = excess_of_truth(lotka.table, config, truths, ["5.0*x**3", truths["y"]])
    crumb = excess_of_truth(lotka.table, config, truths, [truths["x"] + " + 0.001*sin(x)", truths["y"]])
    assert other < -100.0
    assert runaway < -100.0
    assert -20.0 < crumb < 0.0
    assert excess_of_truth(lotka.table, config, truths, [None, truths["y"]]) is None
