"""Whatever a table is made of and whatever the options say: a result that can be read, or one sentence."""

import contextlib

import numpy as np
import pytest

from benchmarks.operations.drawn_jobs import config_of, table_of
from benchmarks.operations.pipelines import LateError, limited, play

CASES = 8
"""Played at each run; `make soak` plays ten thousand."""


@pytest.mark.parametrize("first", range(0, CASES, 2))
def test_nothing_breaks_whatever_a_table_is_made_of(first: int) -> None:
    outcomes = [play(seed) for seed in range(first, first + 2)]
    assert [outcome for outcome in outcomes if outcome.end not in ("done", "refused")] == []


def test_most_cases_reach_their_end_and_equal_seeds_are_equal_cases() -> None:
    one, other = (table_of(np.random.default_rng(7)) for _ in range(2))
    assert one.digest == other.digest
    assert len({table_of(np.random.default_rng(seed)).digest for seed in range(50)}) == 50
    draws = [np.random.default_rng(seed) for seed in range(200)]
    configs = [config_of(draw, table_of(draw)) for draw in draws]
    used = {name for config in configs for name in config.data.model_fields_set}
    assert {"order", "robust", "weights", "holdout", "group", "stochastic", "derivatives", "target"} <= used
    assert any(config.prior.equations for config in configs)


def never_ends() -> None:
    while True:
        with contextlib.suppress(Exception):  # as handlers of errors in a pipeline do
            sum(range(100))


def test_a_case_that_never_ends_is_ended() -> None:
    with pytest.raises(LateError), limited(0.05):
        never_ends()
