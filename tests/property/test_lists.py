"""What must hold of every list that evolution makes: acyclic, evaluable, from the space it was drawn from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.expression.operators import BY_NAME, CONSTANT
from atoll_core.expression.program import check_program_bytes
from atoll_core.search.seeding import Stream
from atoll_island_worker.evolution.front import from_tape, to_program
from atoll_island_worker.evolution.kernels.random import below, next_bits, normal, uniform
from atoll_island_worker.evolution.kernels.tape import compile_tape, sign
from atoll_island_worker.evolution.kernels.variation import (
    LOG_UNIFORM_STEPS,
    cross,
    distance,
    is_unchanged,
    mutate,
    random_constant,
)
from atoll_island_worker.evolution.structures import Space, empty_lists, empty_tape
from tests.oracles import variation as oracle
from tests.oracles.spaces import random_lists, space_of, stream_of
from tests.oracles.tapes import node_values

QUICK = settings(max_examples=100, deadline=None, derandomize=True, database=None)
SEEDS = st.integers(0, 2**64 - 1)


@pytest.fixture(autouse=True)
def _quiet():
    """With the JIT off kernels meet numpy's warnings, the generator's among them: it counts modulo 2**64."""
    with np.errstate(all="ignore"):
        yield


@st.composite
def spaces(draw: st.DrawFn) -> Space:
    names = draw(st.lists(st.sampled_from(sorted(BY_NAME)), min_size=1, max_size=6, unique=True))
    return space_of(
        tuple(names),
        terminals=draw(st.integers(1, 9)),
        operators=draw(st.one_of(st.integers(1, 30), st.sampled_from([57, 64, 80, 140]))),
        variables=draw(st.integers(1, 4)),
        scales=draw(st.sampled_from([(), (1.0,), (1024.0, 2.0**-20)])),
        mutation=draw(st.sampled_from([0.0, 0.05, 1.0])),
        crossover=draw(st.sampled_from([0.0, 0.75, 1.0])),
    )


def assert_sound(lists, space):
    for p in range(lists.code.shape[0]):
        assert not oracle.problems(lists, p, space)
        tape = empty_tape(space.nodes)
        count = compile_tape(lists, p, tape)
        program = to_program(from_tape(tape, count))
        check_program_bytes(program.to_bytes(), space.variables)
        assert node_values(program, np.ones((space.variables, 1))).shape == (count, 1)


def bits(lists):
    return [column.tobytes() for column in lists]


@QUICK
@given(spaces(), SEEDS)
def test_random_lists_are_sound_and_begin_as_they_stand(space, seed):
    lists = random_lists(3, space, seed)
    assert_sound(lists, space)
    assert (lists.scale == [0.0, 1.0, 0.0, 0.0, 0.0]).all()
    assert np.isfinite(lists.constants).all()
    assert bits(lists) == bits(random_lists(3, space, seed))


@QUICK
@given(spaces(), SEEDS)
def test_mutants_are_sound_and_their_terminals_stay_terminals(space, seed):
    lists, stream = random_lists(2, space, seed), stream_of(seed)
    before = bits(lists)
    for _ in range(3):
        mutate(lists, 0, space, stream)
    assert_sound(lists, space)
    if space.mutation == 0.0:
        assert bits(lists) == before


@QUICK
@given(spaces(), SEEDS)
def test_children_are_sound_and_those_of_the_definition(space, seed):
    parents, children = random_lists(2, space, seed), empty_lists(2, space.nodes)
    parents.scale[:] = np.arange(10.0).reshape(2, 5)
    cross(children, parents, 0, 1, space, stream_of(seed))
    assert_sound(children, space)
    cut = oracle.cut_of(Stream(seed), space)
    expected = oracle.crossed(oracle.nodes_of(parents, 0), oracle.nodes_of(parents, 1), cut)
    assert (oracle.nodes_of(children, 0), oracle.nodes_of(children, 1)) == expected
    np.testing.assert_array_equal(children.scale, parents.scale)


def distance_of(one, p, two, q):
    """Return the distance of list `p` of `one` and list `q` of `two`, from their signatures."""
    nodes = one.code.shape[1]
    signature, bits = np.zeros((2, nodes), np.int64), empty_tape(nodes).bits
    sign(one, p, bits, signature, 0)
    sign(two, q, bits, signature, 1)
    return distance(signature, 0, 1)


@QUICK
@given(spaces(), SEEDS)
def test_distance_is_that_of_the_definition(space, seed):
    lists = random_lists(2, space, seed)
    other = empty_lists(2, space.nodes)
    cross(other, lists, 0, 1, space, stream_of(seed))
    for two, q in ((lists, 1), (other, 0), (other, 1), (lists, 0)):
        distance = distance_of(lists, 0, two, q)
        assert distance == oracle.distance(oracle.nodes_of(lists, 0), oracle.nodes_of(two, q))
        assert distance == distance_of(two, q, lists, 0)
    assert distance == 0


@QUICK
@given(spaces(), SEEDS)
def test_the_value_of_a_constant_makes_no_distance(space, seed):
    lists = random_lists(2, space, seed)
    for name in ("code", "left", "right"):
        getattr(lists, name)[1] = getattr(lists, name)[0]
    assert distance_of(lists, 0, lists, 1) == 0


@QUICK
@given(SEEDS, st.integers(1, 2**31))
def test_the_kernels_generator_is_the_one_of_common_seeding(seed, bound):
    mine, theirs = stream_of(seed), Stream(seed)
    for _ in range(5):
        assert int(next_bits(mine)) == theirs.bits()
        assert int(below(mine, bound)) == theirs.below(bound)
        assert float(uniform(mine)) == theirs.uniform()


def test_normal_numbers_are_normal():
    stream = stream_of(1)
    drawn = np.array([normal(stream) for _ in range(20_000)])
    assert abs(drawn.mean()) < 0.03
    assert abs(drawn.std() - 1.0) < 0.03
    assert abs((abs(drawn) < 1.96).mean() - 0.95) < 0.01


def test_constants_without_scales_are_uniform_on_minus_ten_to_ten():
    space, stream = space_of(scales=()), stream_of(2)
    drawn = np.array([random_constant(space, stream) for _ in range(4000)])
    assert -10.0 <= drawn.min() < -9.9
    assert 9.9 < drawn.max() <= 10.0
    assert abs(drawn.mean()) < 0.4


def test_constants_with_scales_have_the_magnitudes_of_their_products():
    """With one scale: a quarter each over it and times it, the rest as they are; each log-uniform over two decades."""
    space, stream = space_of(scales=(2.0**20,)), stream_of(3)
    drawn = np.array([random_constant(space, stream) for _ in range(8000)])
    powers = np.log2(abs(drawn)) / 20.0
    assert abs((powers < -0.5).mean() - 0.25) < 0.03
    assert abs((powers > 0.5).mean() - 0.25) < 0.03
    assert abs((drawn > 0.0).mean() - 0.5) < 0.03
    plain = abs(drawn[abs(powers) < 0.5])
    assert 0.1 <= plain.min() < 0.11
    assert 9.5 < plain.max() <= 10.0


@pytest.mark.parametrize("mutation", [0.05, 0.5])
def test_nodes_change_about_as_often_as_asked(mutation):
    """Some changes draw what was there before, so that a little less is seen."""
    space = space_of(mutation=mutation, variables=4)
    lists, stream = random_lists(200, space, 7), stream_of(8)
    before = [column.copy() for column in lists]
    for p in range(200):
        mutate(lists, p, space, stream)
    changed = np.any([old != new for old, new in zip(before[:4], lists[:4], strict=True)], axis=0)
    assert 0.8 * mutation < changed.mean() < 1.1 * mutation


def mutants(lists, space, seed):
    """Return copies of `lists`, each mutated once."""
    after, stream = type(lists)(*(column.copy() for column in lists)), stream_of(seed)
    for p in range(lists.code.shape[0]):
        mutate(after, p, space, stream)
    return after


@pytest.mark.parametrize("nodes", [32, 33, 64, 65, 101])
def test_every_place_of_a_list_changes_equally_often_and_on_its_own(nodes):
    """Of 3000 lists; the draws that change nothing that can be seen are reckoned with."""
    mutation, number = 0.3, 3000
    space = space_of(operators=nodes - 7, mutation=mutation, variables=4)
    lists = random_lists(number, space, 21)
    after = mutants(lists, space, 22)
    changed = np.any([old != new for old, new in zip(lists[:4], after[:4], strict=True)], axis=0)
    place, operators = np.arange(7, nodes), len(space.operators)
    unseen = (1.0 / operators + 2.0 / place) / 3.0
    assert abs(changed[:, 7:].mean(axis=0) - mutation * (1.0 - unseen)).max() < 0.05
    assert abs(changed[:, :7].mean() - mutation * (1.0 - 0.5 * 0.5 / 4)) < 0.02
    seen = changed[:, 7:] - changed[:, 7:].mean(axis=0)
    together = abs((seen[:, :-1] * seen[:, 1:]).mean(axis=0))
    assert together.max() < 0.025


@pytest.mark.parametrize("scales", [(), (1.0,)])
def test_each_kind_of_change_is_as_likely_as_documented(scales):
    """All nodes change: a third each of operator, left and right; half of the constants move, the rest are redrawn."""
    space = space_of(mutation=1.0, variables=3, scales=scales)
    lists = random_lists(2000, space, 23)
    lists.constants[:, :7] = 1e6
    after = mutants(lists, space, 24)
    operators, place = len(space.operators), np.arange(7, space.nodes)
    for name, unseen in (("code", 1.0 / operators), ("left", 1.0 / place), ("right", 1.0 / place)):
        seen = getattr(lists, name)[:, 7:] != getattr(after, name)[:, 7:]
        assert seen.mean() == pytest.approx(np.mean((1.0 - unseen) / 3.0), abs=0.01)
    several = sum((getattr(lists, name) != getattr(after, name)).astype(int) for name in ("code", "left", "right"))
    assert several[:, 7:].max() == 1
    was_constant, is_constant = lists.code[:, :7] == CONSTANT, after.code[:, :7] == CONSTANT
    assert is_constant[~was_constant].mean() == pytest.approx(0.5, abs=0.03)
    moved = was_constant & is_constant & (abs(after.constants[:, :7]) > 100.0)
    assert moved[was_constant].mean() == pytest.approx(0.5, abs=0.03)
    assert is_constant[was_constant].mean() == pytest.approx(0.75, abs=0.03)
    for variable in range(3):
        assert (after.left[:, :7][~is_constant] == variable).mean() == pytest.approx(1 / 3, abs=0.03)
    steps = after.constants[:, :7][moved] / 1e6 - 1.0
    assert abs(steps.mean()) < 0.015
    assert steps.std() == pytest.approx(0.3, rel=0.05)


def test_log_uniform_steps_have_every_size_as_often_as_any_other():
    """Of values of 2: by the median of a normal step's size, the sizes are spread evenly over six decades."""
    space = space_of(mutation=1.0, steps=LOG_UNIFORM_STEPS, moves=1.0)
    lists = random_lists(2000, space, 25)
    lists.constants[:, :7] = 2.0
    after = mutants(lists, space, 26)
    moved = (lists.code[:, :7] == CONSTANT) & (after.code[:, :7] == CONSTANT)
    exponents = np.log10(abs(after.constants[:, :7][moved] - 2.0) / 0.6745)
    assert np.quantile(exponents, (0.25, 0.5, 0.75)) == pytest.approx((-3.5, -2.0, -0.5), abs=0.15)


@QUICK
@given(spaces(), SEEDS)
def test_a_child_is_unchanged_when_the_live_nodes_of_the_parent_of_its_output_are(space, seed):
    parents, children, stream = random_lists(2, space, seed), empty_lists(2, space.nodes), stream_of(seed)
    live, signature = np.zeros((2, -(-space.nodes // 64)), np.uint64), np.zeros((2, space.nodes), np.int64)
    for p in range(2):
        sign(parents, p, live[p], signature, p)
    for _ in range(4):
        base = cross(children, parents, 0, 1, space, stream)
        for q, parent in ((0, base), (1, 1 - base)):
            mutate(children, q, space, stream)
            before, after = oracle.nodes_of(parents, parent), oracle.nodes_of(children, q)
            same = all(before[i] == after[i] for i in oracle.live_of(before))
            assert is_unchanged(parents, parent, children, q, live) == same
