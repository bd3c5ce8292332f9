"""The corpus: equal seeds give equal tables, qualities are what they say, outcomes are judged, kept and summed up."""

import dataclasses
import math

import numpy as np
import pytest

from atoll_core.errors import DataError, UsageError
from benchmarks.corpus import __main__ as corpus
from benchmarks.corpus import campaign, cases
from benchmarks.corpus.campaign import configuration, judge_again
from benchmarks.corpus.cases import Key, make_case, smallest_t
from benchmarks.corpus.families import FAMILIES, NAMED
from benchmarks.corpus.lengths import excess_of_truth
from benchmarks.corpus.outcomes import Outcome, judge_job
from benchmarks.corpus.qualities import QUALITIES, quality
from benchmarks.corpus.random_equations import random_family
from benchmarks.corpus.systems import CorpusSystem, draw_system, named_system, solution
from benchmarks.corpus.tables import by_grade, by_quality, equation_rows
from benchmarks.harness.journal import Journal
from benchmarks.harness.solving import DivergedError

KEY = Key("lotka_volterra", 2, 1, "even", "noise-0.01", 0)
RANDOM = Key("random", 1, 4, "even", "exact", 3)


def kept(path):
    return Journal("corpus", Outcome, path, (), resume=path is not None and path.exists())


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


@pytest.mark.slow
def test_a_seed_has_one_system():
    draw_system.cache_clear()
    first = draw_system(3, 2)
    draw_system.cache_clear()
    assert draw_system(3, 2) == first
    assert draw_system(4, 2) != first


def test_a_key_has_one_table():
    first, second = make_case(RANDOM), make_case(RANDOM)
    np.testing.assert_array_equal(first.table.columns, second.table.columns)
    assert first.table.rows == 400


def test_a_drawn_system_is_the_one_that_its_seed_has_had():
    drawn = draw_system(2, 1)
    assert drawn.truths == {"x": "0.712*x*(1.0 - x/7.17)"}
    assert drawn.duration == 6.0


@pytest.mark.parametrize("name", [*FAMILIES])
def test_a_family_has_a_constant_and_a_range_for_each_name(name):
    family = FAMILIES[name]
    middle = {key: math.sqrt(low * high) for key, (low, high) in family.constants.items()}
    system = CorpusSystem(name, family.equations, middle, ((0.5, 1.0),) * len(family.equations), 1.0)
    assert len(family.box) == len(family.equations)
    assert all(math.isfinite(slope) for slope in system.field()([0.7] * len(family.equations)))


@pytest.mark.parametrize("states", [1, 2, 5])
def test_random_equations_have_ranges_for_their_constants(states):
    family = random_family(np.random.default_rng(2), states)
    system = CorpusSystem("random", family.equations, dict.fromkeys(family.constants, 0.5), ((1.0, 2.0),) * states, 1.0)
    assert len(system.field()([1.0] * states)) == states
    assert not any("{" in text for text in system.truths.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", QUALITIES)
def test_every_quality_measures_all_rows(monkeypatch, name, lotka):
    monkeypatch.setattr(cases, "fresh_paths", lambda *_: ())
    monkeypatch.setattr(cases, "smallest_t", lambda *_: {})
    case = make_case(dataclasses.replace(KEY, quality=name))
    values = case.table.columns[1:]
    clean = np.array([*lotka.clean.values()])
    assert values.shape == clean.shape
    error = np.sqrt(((values - clean) ** 2).mean(axis=1)) / clean.std(axis=1)
    parsed = quality(name)
    if parsed.kind in ("noise", "ar1"):
        np.testing.assert_allclose(error, parsed.size, rtol=0.6)
    elif parsed.kind == "exact":
        assert not error.any()
    else:
        assert (error < 0.5).all()
        assert error.any()


@pytest.mark.parametrize("name", ["exact-1", "noise", "loud-0.1", "noise-much"])
def test_a_quality_that_there_is_none_of_is_refused(name):
    with pytest.raises(UsageError, match="no quality"):
        quality(name)


def test_a_solution_that_runs_away_is_refused():
    system = CorpusSystem("runaway", {"x": "k1*x**2"}, {"k1": 1.0}, ((1.0, 1.0),), 5.0)
    with pytest.raises(DivergedError):
        solution(system.field(), (1.0,), np.linspace(0.0, 5.0, 5))


@pytest.mark.slow
def test_constants_are_the_less_known_the_larger_the_errors(lotka):
    loud = make_case(dataclasses.replace(KEY, quality="noise-0.1"))
    together = make_case(dataclasses.replace(KEY, quality="ar1-0.01"))
    assert lotka.t["x"] == pytest.approx(10.0 * loud.t["x"], rel=0.2)
    assert together.t["x"] < 0.6 * lotka.t["x"]


def test_a_constant_that_the_data_do_not_show_is_not_known():
    """What x' = k1 - k2*x does near its rest is that of the quotient of the constants."""
    still = CorpusSystem("decay", FAMILIES["decay"].equations, {"k1": 1.0, "k2": 1.0}, ((1.0, 1.0),), 5.0, ((1.001,),))
    times = [np.linspace(0.0, 5.0, 100)]
    clean = [solution(still.field(), (1.001,), times[0])]
    measured = [clean[0] + 0.01 * np.random.default_rng(0).standard_normal(clean[0].shape)]
    assert smallest_t(still, still.starts, times, clean, measured)["x"] < 1.0


def test_fresh_trajectories_begin_in_the_measured_box(lotka):
    for path in lotka.fresh:
        for start, values in zip(path.states[0].tolist(), lotka.clean.values(), strict=True):
            assert values.min() <= start <= values.max()


@pytest.mark.slow
def test_chaos_shortens_fresh_trajectories():
    case = make_case(Key("lorenz", 3, 1, "even", "exact", 0))
    assert max(path.times[-1] for path in case.fresh) < 0.6 * NAMED["lorenz"][3]


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


def test_a_job_that_failed_has_no_equations(lotka):
    judgement = judge_job(KEY, lotka, {"seconds": 1.0}, failure="no")
    assert [equation.form for equation in judgement.equations] == ["none", "none"]
    assert judgement.failure == "no"


def test_a_model_that_runs_away_foretells_nothing(lotka):
    judgement = judge_job(KEY, lotka, result("5.0*x**3", "0.1*x*y - 0.4*y"))
    assert judgement.equations[0].r2 == -math.inf
    assert judgement.equations[0].is_foretold is False


@pytest.mark.slow
def test_outcomes_survive_the_journal(tmp_path, judged, lotka):
    path = tmp_path / "journal.jsonl"
    runaway = judge_job(dataclasses.replace(KEY, seed=1), lotka, result("5.0*x**3", "1.0*y"))
    first = kept(path)
    first.add(judged, result("1.1*x - 0.4*x*y + 0.001*y**3", "0.1*x*y - 0.4*y"))
    first.add(runaway, None)
    with path.open("a") as stream:
        stream.write('{"torn')
    again = kept(path)
    assert again.outcomes == {KEY: judged, runaway.key: runaway}
    judge_again([KEY], again)
    assert dataclasses.replace(again.outcomes[KEY], excess=None) == judged
    assert kept(path).outcomes == again.outcomes


def test_a_campaign_does_only_what_is_missing(monkeypatch, judged):
    journal = kept(None)
    journal.add(judged, None)
    monkeypatch.setattr("benchmarks.harness.campaign.searching", lambda workers: pytest.fail("nothing is missing"))
    assert campaign.run_jobs([KEY], journal, 1, None, {}) == [judged]


def test_the_search_has_the_functions_that_the_truth_needs(lotka):
    tank = named_system("logistic")
    case = dataclasses.replace(lotka, system=dataclasses.replace(tank, equations={"x": "k1*log(x) - k2*x**k3"}))
    config = configuration(KEY, case, 3.0, {"max_epochs": 2})
    assert config.space.operators[-2:] == ("log", "pow")
    assert (config.budget.max_time, config.budget.max_epochs, config.seed) == (3.0, 2, 0)
    untold = configuration(dataclasses.replace(KEY, method="atoll-untold"), case, 3.0, {})
    assert untold.space.operators is None


def test_a_family_is_drawn_from_the_seed():
    keys = [Key("tanks", 2, 1, "even", "exact", seed) for seed in (1, 2, 1)]
    one, other, same = (make_case(key, has_fresh=False) for key in keys)
    assert one.system.operators == ("sqrt",)
    assert one.system.truths == same.system.truths != other.system.truths
    assert one.table.columns.tobytes() == same.table.columns.tobytes()


@pytest.mark.slow
def test_pysindy_is_given_the_same_table(monkeypatch, lotka):
    given = []

    def solve(method, seed, case):
        given.append((method, case.table.columns.tobytes(), dict(case.truths)))
        return result("1.1*x - 0.4*x*y", "0.1*x*y - 0.4*y")

    monkeypatch.setattr(campaign.pysindy_models, "solve", solve)
    monkeypatch.setattr("benchmarks.harness.campaign.searching", lambda workers: pytest.fail("nothing is searched"))
    key = dataclasses.replace(KEY, method="pysindy weak")
    (outcome,) = campaign.run_jobs([key], kept(None), 1, None, {})
    assert [equation.is_right for equation in outcome.equations] == [True, True]
    assert given == [("pysindy weak", lotka.table.columns.tobytes(), lotka.system.truths)]


def test_operon_is_given_the_same_table_and_the_operators_of_the_search(monkeypatch, lotka):
    given = []

    def solve(table, operators, seed):
        given.append((table.columns.tobytes(), operators, seed))
        return result("1.1*x - 0.4*x*y", "0.1*x*y - 0.4*y")

    monkeypatch.setattr(campaign.operon_models, "solve", solve)
    (outcome,) = campaign.run_jobs([dataclasses.replace(KEY, method="operon")], kept(None), 1, None, {})
    assert [equation.is_right for equation in outcome.equations] == [True, True]
    assert given == [(lotka.table.columns.tobytes(), configuration(KEY, lotka, None, {}).space.operators, KEY.seed)]
    assert set(outcome.cpu) == {"operon"}


def test_a_peer_that_cannot_use_the_data_fails_that_job_only(monkeypatch):
    def solve(*_):
        raise DataError("too few rows")

    monkeypatch.setattr(campaign.operon_models, "solve", solve)
    (outcome,) = campaign.run_jobs([dataclasses.replace(KEY, method="operon")], kept(None), 1, None, {})
    assert outcome.failure == "too few rows"
    assert [equation.form for equation in outcome.equations] == ["none", "none"]


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
