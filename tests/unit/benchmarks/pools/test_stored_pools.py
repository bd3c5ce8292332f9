"""Stored pools: what is kept is refined and judged as the reference says, and changes are counted."""

from types import SimpleNamespace

import pytest

from atoll_coordinator.model.result.building import VariableOutcome
from atoll_coordinator.service.tasks.background import RefiningFailed
from atoll_coordinator.settings import Settings, with_changes
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_coordinator.tasks.refining import Searched
from atoll_core.errors import UsageError
from benchmarks.pools import beside, stored
from benchmarks.pools.__main__ import main
from benchmarks.pools.campaign import POOLS, REFERENCE, changes_of, judge_pool, sample, titles
from benchmarks.pools.cases import Folders, Judged, job_of
from benchmarks.pools.outcomes import PoolOutcome, read_reference, report, write_reference
from tests.unit.coordinator.model.shooting import made

LOGISTIC = "corpus logistic 1 1 even exact 1000"


@pytest.mark.timeout(300)
def test_what_a_coordinator_keeps_is_refined_and_judged(tmp_path, monkeypatch):
    job = job_of(LOGISTIC, Folders())
    prepared, _ = prepare_job(job.table.to_bytes(), job.config)
    pools = made.pools(prepared.preparation, x=("x", "x*(2.0 - x)"))
    outcomes = tuple(VariableOutcome(name, pool.front, 1, runners_up=pool.runners_up) for name, pool in pools.items())
    path = stored.file_of(tmp_path, LOGISTIC)
    monkeypatch.setenv(stored.FILE, str(path))
    posted: list[object] = []
    stored.keep(SimpleNamespace(post=posted.append), Searched("j", outcomes), job.config, None, 0.0)
    assert [type(item) for item in posted] == [RefiningFailed]
    assert stored.read_pools(path) == pools
    (equation,) = job.judge(stored.refine_stored(LOGISTIC, job.table, job.config, pools).result)
    assert (equation.is_right, equation.grade, equation.is_false) == (True, "exact", False)


def test_a_pool_that_is_not_kept_is_named(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        stored.read_pools(tmp_path / "none.json")


def test_every_title_has_a_pool_and_a_reference():
    reference = read_reference(REFERENCE)
    assert [title for title in titles() if not stored.file_of(POOLS, title).exists()] == []
    assert [title for title in titles() if title not in reference] == []


@pytest.mark.timeout(300)
@pytest.mark.parametrize("title", sample(read_reference(REFERENCE), 10, 5.0))
def test_stored_pools_are_refined_to_the_forms_and_grades_of_the_reference(title):
    before = read_reference(REFERENCE)[title]
    now = judge_pool(title, Folders())
    assert now.failure is None
    assert [one.is_right for one in now.equations] == [one.is_right for one in before.equations], now.line
    assert [one.grade for one in now.equations] == [one.grade for one in before.equations], now.line
    assert not any(one.is_false for one in now.equations)


def outcome(title, *rights, failure=None):
    equations = tuple(Judged(str(place), is_right, "good", not is_right) for place, is_right in enumerate(rights))
    return PoolOutcome(title, equations, 0.0, 1.0, failure)


def test_changes_are_counted_and_losses_beyond_chance_are_worse(tmp_path):
    path = tmp_path / "reference.json"
    write_reference(path, [outcome("corpus a", *[True] * 6), outcome("corpus b", False)])
    reference = read_reference(path)
    text, is_as_good = report([outcome("corpus a", *[True] * 5, False), outcome("corpus b", True)], reference)
    assert is_as_good
    assert "right: 1 gained, 1 lost" in text
    assert "corpus b: 0: other form, good, FALSE -> right, good" in text
    text, is_as_good = report([outcome("corpus a", *[False] * 6)], reference)
    assert not is_as_good
    assert "6 lost" in text


def test_a_pool_that_fails_is_worse():
    _, is_as_good = report([outcome("corpus a", failure="the table has no rows")], {})
    assert not is_as_good


def test_every_number_of_the_settings_is_tried_halved_and_doubled_and_is_read_back():
    changes = changes_of(Settings())
    for change in changes:
        stage, _, field = change.name.partition(".")
        assert getattr(getattr(with_changes(Settings(), change.text), stage), field) == change.value
    assert len({change.text for change in changes}) == len(changes) > 90


@pytest.mark.parametrize("word", ["no-such-title", "quantised3"])
def test_words_of_no_drawn_pool_are_refused_before_pools_are_refined(word, monkeypatch, capsys):
    monkeypatch.setattr("benchmarks.pools.__main__.with_settings", lambda *_: pytest.fail("pools were refined"))
    with pytest.raises(SystemExit, match="2"):
        main(["settings", "--only", word])
    assert f"no drawn pool has a title with {word}" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["selection.least=1.0", "none.steps=3", "effort.steps=2.5"])
def test_settings_that_are_unknown_or_of_another_kind_are_named(text):
    with pytest.raises(ValueError, match=text.partition("=")[0]):
        with_changes(Settings(), text)


def test_ratios_of_two_trees_are_told_by_kind_and_over_all_pools():
    pairs = [beside.Beside("real a", 2.0, 1.0, True), beside.Beside("real b", 4.0, 4.0, False)]
    lines = [line.split() for line in beside.report([*pairs, beside.Beside("many c", 4.0, 1.0, True)]).splitlines()]
    assert ["real", "2", "6.0", "5.0", "0.83", "0.75", "1"] in lines
    assert ["all", "3", "10.0", "6.0", "0.60", "0.50", "2"] in lines


@pytest.mark.slow
def test_a_tree_beside_itself_has_equal_results():
    pair = beside.compare("corpus random 1 1 even exact 1607", Folders(), beside.ROOT)
    assert pair.is_equal
    assert min(pair.before, pair.now) > 0.0
