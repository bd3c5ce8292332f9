"""What is counted of the choices of scores."""

import math
from typing import cast

import numpy as np
import pytest

from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.expression.text.parsing import from_infix
from benchmarks.corpus.cases import Key
from benchmarks.scores.outcomes import Outcome, choice_of, laws_of, table
from benchmarks.scores.pools import Pool, Scored

TEXTS = ("2.0*x", "x*2.0", "2.0*x + 0.1", "x")
POOL = Pool(
    cast(ModellingTask, None),
    tuple((from_infix(text, ("x",)),) for text in TEXTS),
    ("law", "exchanged", "extended", "reduced"),
    is_identifiable=True,
)


def scored(*nats: float, misfits: tuple[float, ...] = (0.0, 0.0, -1.0, 50.0), errors: tuple[float, ...] = ()) -> Scored:
    return Scored(nats, misfits, (2.1,) if errors else (), errors)


def test_the_law_in_other_words_is_the_law() -> None:
    one = scored(10.0, 8.0, 15.0, 60.0, errors=(0.06,))
    is_law = laws_of(POOL, {"pieces": one})
    assert is_law == [True, True, False, False]
    choice = choice_of(POOL, is_law, one, 1.0)
    assert (choice.chosen, choice.margins, choice.margin) == (
        "law", {"extended": 7.0, "reduced": 52.0, "exchanged": None}, 7.0,
    )  # fmt: skip
    assert (choice.covered, choice.intervals) == (1, 1)


def test_with_more_constants_the_same_misfit_is_no_law() -> None:
    one = scored(10.0, 8.0, 15.0, 60.0, misfits=(0.0, 5.0, 0.0, 50.0))
    assert laws_of(POOL, {"pieces": one}) == [True, False, False, False]


def test_tempered_misfits_tell_no_writings_apart() -> None:
    near = scored(10.0, 8.0, 15.0, 60.0, misfits=(0.0, 5e-4, -1.0, 50.0))
    apart = scored(10.0, 8.0, 15.0, 60.0, misfits=(0.0, 5.0, -1.0, 50.0))
    assert laws_of(POOL, {"pieces": apart, "tempered": near})[1] is False


@pytest.mark.parametrize(
    ("nats", "chosen", "margin"),
    [
        ((10.0, 10.0, 7.5, 60.0), "extended", -2.5),
        ((math.inf, math.inf, 7.5, 60.0), "extended", -math.inf),
        ((math.inf,) * 4, "none", -math.inf),
        ((10.0, 10.0, math.inf, math.inf), "law", math.inf),
    ],
)
def test_a_law_that_is_not_the_shortest_is_told_by_its_margin(
    nats: tuple[float, ...], chosen: str, margin: float
) -> None:
    choice = choice_of(POOL, [True, True, False, False], scored(*nats), 1.0)
    assert choice.chosen == chosen
    assert choice.margin == margin


def test_tables_count_what_was_chosen() -> None:
    key = Key("random", 1, 1, "even", "noise-0.01", 3)
    names = ("pieces", "pieces, evidence", "innovations", "filter", "tempered", "evidence")
    is_law = [True, True, False, False]
    right, wrong = (choice_of(POOL, is_law, scored(10.0, 10.0, nats, 60.0), 1.0) for nats in (17.0, 7.5))
    outcomes = [Outcome(key, dict.fromkeys(names, right)), Outcome(key, dict.fromkeys(names, wrong)), Outcome(key, {})]
    lines = table(outcomes).splitlines()
    assert lines[-1].startswith("| all | evidence | 1 of 2 (50 %) | 1 | 0 | 0 | 0 | 2.2 |")
    assert np.count_nonzero(["noise-0.01" in line for line in lines]) == len(names)
