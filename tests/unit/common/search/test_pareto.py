"""Fronts and runners-up: what is kept, what counts as the same function, and that order does not matter."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import AGREEMENT, FrontEntry, merge, runners_up, structure_of

QUICK = settings(max_examples=200, deadline=None, derandomize=True, database=None)
ERRORS = st.one_of(st.sampled_from([1.0, 1.0 + 0.5 * AGREEMENT, 2.0, math.inf]), st.floats(0.5, 3.0))
PROGRAMS = st.sampled_from([bytes([1, code, *bytes(4), value]) for code in range(6) for value in range(2)])
ENTRIES = st.lists(
    st.builds(
        lambda complexity, error, tag, program: FrontEntry(
            complexity, error, error * (1.0 + program[1] % 2), *tag, program
        ),
        st.integers(1, 5),
        ERRORS,
        st.tuples(st.integers(0, 1), st.integers(0, 3), st.integers(0, 1)),
        PROGRAMS,
    ),
    max_size=30,
)


def program(text):
    return from_infix(text, ("x", "y")).to_bytes()


def by_definition(front, candidates, most):
    """Return the runners-up as they are defined, pair by pair."""
    kept = []
    for candidate in sorted({*front, *candidates}, key=lambda one: one.key):
        if candidate in front:
            kept.append(candidate)
            continue
        alike = [
            one
            for one in kept
            if structure_of(one.program) == structure_of(candidate.program)
            or (abs(one.error - candidate.error) <= AGREEMENT * candidate.error
                and abs(one.mse - candidate.mse) <= AGREEMENT * min(one.mse, candidate.mse))
        ]  # fmt: skip
        beside = sum(one.complexity == candidate.complexity and one not in front for one in kept)
        if math.isfinite(candidate.error) and not alike and beside < most:
            kept.append(candidate)
    return tuple(one for one in kept if one not in front)


@pytest.mark.slow
@QUICK
@given(ENTRIES, st.integers(0, 4))
def test_runners_up_are_those_of_the_definition(entries, most):
    front = merge((), entries)
    assert runners_up(front, entries, most) == (by_definition(front, entries, most) if most else ())


@QUICK
@given(ENTRIES, st.integers(1, 3), st.randoms(use_true_random=False))
def test_neither_order_nor_repetition_matters(entries, most, random):
    front = merge((), entries)
    shuffled = [*entries, *entries[:3]]
    random.shuffle(shuffled)
    assert runners_up(front, shuffled, most) == runners_up(front, entries, most)
    assert runners_up(front, (*front, *entries), most) == runners_up(front, entries, most)


@pytest.mark.slow
@QUICK
@given(ENTRIES, ENTRIES)
def test_a_front_is_the_same_however_its_entries_are_merged(some, others):
    assert merge(merge((), some), others) == merge((), (*others, *some))


def test_a_structure_is_a_program_without_its_constants():
    assert structure_of(program("2.0*x + 1.0")) == structure_of(program("7.0*x + 3.0"))
    assert structure_of(program("2.0*x + 1.0")) != structure_of(program("2.0*y + 1.0"))
    assert structure_of(b"") == b""
