"""Table III: what each search is given, and what the searches for one equation come to."""

import dataclasses

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_core.errors import UsageError
from benchmarks.harness.systems import TRUTH, trajectories
from benchmarks.paper.table3 import (
    EQUATIONS,
    PAPER,
    SHOWN,
    SLOPE,
    balance,
    chosen,
    configured,
    main,
    summed_up,
    with_slopes,
)
from tests.unit.benchmarks.judging.verdicts import VERDICT

GLIDER_V = ("glider", "v")


def options(*words):
    return main.parser.parse_args(words)


def verdicts(*seconds, found=True):
    return [
        dataclasses.replace(
            VERDICT, seed=k, found=found, search_seconds=s, seconds=2 * s, point_evaluations=int(1e6 * s)
        )
        for k, s in enumerate(seconds)
    ]


def test_the_papers_figures_stand_by_their_equations():
    assert len(EQUATIONS) == 14
    assert PAPER[GLIDER_V] == (10.2, 1.03e9)
    assert PAPER["predator_prey", "y"] == (290.6, 29.38e9)
    assert PAPER["shear_flow", "theta"] == (3.6, 0.36e9)
    assert PAPER["lotka_volterra", "y"] == (1.1, 0.11e9)


def test_given_derivatives_are_the_truth_on_the_papers_400_points():
    table = with_slopes("lotka_volterra", trajectories("lotka_volterra", 0.1, 0))
    config = configured(options(), 3, ("lotka_volterra", "y"), "given")
    dataset = prepare(table, config).dataset
    (target,) = dataset.targets
    x, y = dataset.inputs
    assert (target.variable, target.uncertainty, len(x)) == ("y", 0.0, 400)
    np.testing.assert_array_equal(target.values, 2 * y - x * y - y * y)


def test_every_system_has_its_derivatives_beside_its_states():
    for system in ("glider", "shear_flow"):
        sampled = trajectories(system, 0.1, 0)
        assert with_slopes(system, sampled).names == (*sampled.names, *(SLOPE + name for name in TRUTH[system]))


def test_one_variable_is_sought_and_both_may_be_used():
    config = configured(options("--preset", "paper", "--target-error", "1e-3"), 7, GLIDER_V, "estimated")
    assert (config.seed, config.preset, config.budget.target_error) == (7, "paper", 1e-3)
    assert (config.data.only, config.data.states, config.data.derivatives) == (("v",), ("v", "theta"), None)


def test_the_median_counts_a_miss_as_infinitely_long():
    found, missed = verdicts(1.0, 4.0), verdicts(0.1, found=False)
    row = summed_up(GLIDER_V, "given", [*missed, *found])
    assert (row.found, row.searches, row.seconds, row.job_seconds, row.point_evaluations) == (2, 3, 4.0, 8.0, 4e6)
    assert row.is_found
    assert row.is_ahead


def test_more_misses_than_not_have_no_median():
    row = summed_up(GLIDER_V, "given", [*verdicts(1.0), *verdicts(0.1, 0.2, found=False)])
    assert (row.seconds, row.point_evaluations, row.is_found, row.is_ahead) == (None, None, False, False)
    assert SHOWN.row(row)[3:7] == ("1 of 3", "-", "-", "-")


@pytest.mark.parametrize(("seconds", "evaluations"), [(11.0, 1000), (1.0, 2_000_000_000)])
def test_who_is_slower_or_evaluates_more_is_not_ahead(seconds, evaluations):
    verdict = dataclasses.replace(VERDICT, seconds=seconds, point_evaluations=evaluations)
    assert not summed_up(GLIDER_V, "given", [verdict]).is_ahead


def test_ratios_stand_in_the_table():
    row = summed_up(GLIDER_V, "given", verdicts(1.0))
    assert SHOWN.row(row)[7:11] == ("10.2", "1.03e+09", "5.1", "1030")


def test_the_balance_compares_only_what_was_found():
    rows = [
        summed_up(GLIDER_V, "given", verdicts(1.0)),
        summed_up(("glider", "theta"), "given", verdicts(1, found=False)),
    ]
    text = balance(rows)
    assert "1 of 2 found in the median, 1 ahead" in text
    assert "1.000e+06 point evaluations" in text
    assert "1.03e+03 times" in text


def test_variables_choose_among_the_systems():
    assert chosen(options("--system", "glider", "--only", "theta")) == [("glider", "theta")]
    with pytest.raises(UsageError, match="v, theta"):
        chosen(options("--system", "glider", "--only", "x"))


def test_a_variable_that_no_system_has_is_one_sentence_and_exit_code_2(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--system", "glider", "--only", "x"])
    assert ended.value.code == 2
    assert "none of the systems has a variable x" in capsys.readouterr().err
