"""The Strogatz label files: what must be there, and the table beside the paper's."""

import argparse
import dataclasses

import pytest

from atoll_core.wire.messages.views import JobView, VariableView
from benchmarks.peers.strogatz import (
    PUBLISHED,
    Passings,
    beside_the_paper,
    configured,
    is_solved,
    levels,
    main,
)
from tests.unit.benchmarks.judging.verdicts import VERDICT


def test_without_the_files_there_is_one_sentence_and_exit_code_2(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--data", str(tmp_path)])
    assert ended.value.code == 2
    assert "truth.json" in capsys.readouterr().err


def test_the_published_sums_are_those_of_the_paper():
    seconds, evaluations = (sum(column) for column in zip(*PUBLISHED.values(), strict=True))
    assert seconds == pytest.approx(589.7, abs=1.0)
    assert evaluations == pytest.approx(59.6e9, rel=0.01)


@pytest.mark.parametrize("words", [[], ["--to-the-end"]])
def test_a_search_may_go_on_without_progress(words):
    options = main.parser.parse_args(["--data", "d", "--max-time", "300", "--target-error", "1e-3", *words])
    budget = configured(options, 3).budget
    assert (budget.max_time, budget.target_error) == (300.0, 1e-3)
    assert ((budget.stagnation or 0) > 10**6) is bool(words)


@pytest.mark.parametrize(("error", "solved"), [(9e-5, True), (1.1e-4, False), (None, False)])
def test_the_error_decides_what_is_solved(error, solved):
    assert is_solved(dataclasses.replace(VERDICT, error=error, exact=False)) is solved


def view(elapsed, error, evaluations):
    its = VariableView(variable="label", lhs="label", epoch=1, normalized_error=error, point_evaluations=evaluations)
    return JobView(
        job="a", name="b", state="running", seed=0, preset="paper", submitted="", elapsed=elapsed, workers=2,
        point_evaluations=evaluations, variables=(its,),
    )  # fmt: skip


def test_each_level_is_taken_when_it_is_first_passed():
    passings = Passings()
    for elapsed, error, evaluations in [(1.0, None, 10), (2.0, 5e-3, 20), (3.0, 4e-3, 30), (4.0, 1e-3, 40)]:
        passings.look(view(elapsed, error, evaluations))
    assert passings.passed == {1e-2: (2.0, 20), 1e-3: (4.0, 40)}


def test_evaluations_stand_beside_the_papers():
    verdict = dataclasses.replace(VERDICT, case="lv2", point_evaluations=11_000_000)
    heads, row = beside_the_paper([(verdict, Passings({1e-2: (0.25, 5_000_000)}))]).splitlines()
    assert row.split()[:5] == ["lv2", "0", "yes", "1.0e-10", "1.10e+07"]
    assert row.split()[5:] == ["0.25", "5.00e+06", "-", "-", "-", "-", "1.1", "1.10e+08"]
    assert heads.index("paper s") == row.index("1.1 ", 50)


def test_levels_of_noise_are_numbers():
    assert levels("0,0.001,0.1,0.1") == [0.0, 0.001, 0.1]


@pytest.mark.parametrize("text", ["", "-1", "0.1,", "a", "nan", "inf"])
def test_other_levels_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="levels such as"):
        levels(text)


def test_noise_and_a_race_exclude_each_other(capsys):
    with pytest.raises(SystemExit):
        main.parser.parse_args(["--data", "d", "--noise", "0.1", "--versus", "operon"])
    assert "not allowed with" in capsys.readouterr().err
