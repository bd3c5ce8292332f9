"""Each operation on a block of rows has the bits of numpy on every lane, compiled and interpreted."""

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.compilation.jit import kernel
from atoll_core.expression.kernels import lanes as kernels_lanes
from atoll_core.expression.kernels.lanes import (
    CHUNK,
    LANES,
    add_scaled,
    blend,
    centre,
    copy,
    differing,
    fill,
    get,
    highest_bit,
    lane_operation,
    lowest_bit,
    move,
    place,
    place_in,
    put,
    square_root,
    total,
    total_magnitude,
)

FORMULAS = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "negate": lambda a: -a,
    "invert": lambda a: 1.0 / a,
    "root": lambda a: square_root(a),
    "magnitude": lambda a: abs(a),
    "add_product": lambda t, a, b: t + a * b,
    "subtract_product": lambda t, a, b: t - a * b,
    "add_quotient": lambda t, a, b: t + a / b,
    "subtract_quotient": lambda t, a, b, c: t - a * b / c,
}
add, subtract, multiply, divide, negate, invert, root, magnitude = map(lane_operation, [*FORMULAS.values()][:8])
add_product, subtract_product, add_quotient, subtract_quotient = (
    lane_operation(FORMULAS[name], onto=True)
    for name in ("add_product", "subtract_product", "add_quotient", "subtract_quotient")
)
QUICK = settings(max_examples=100, deadline=None, derandomize=True, database=None)
AWKWARD = np.array([0.0, -0.0, 1.0, -1.0, 0.1, -3.7, 5e-324, -1e-310, 1e-200, 1e200, -1e200, 1e308])
AWKWARD = np.append(AWKWARD, [np.inf, -np.inf, np.nan, 2.0**53])
ROW, START, X = 1, 16, 0.3

BINARY = ("add", "subtract", "multiply", "divide")
UNARY = ("negate", "invert", "root", "magnitude", "copy")
ONTO = ("add_product", "subtract_product", "add_quotient", "subtract_quotient")
OTHERS = ("fill", "add_scaled", "centre")
OPERATIONS = (*BINARY, *UNARY, *ONTO, *OTHERS)

EXPECTED = {
    "add": lambda out, a, b, c: a + b,
    "subtract": lambda out, a, b, c: a - b,
    "multiply": lambda out, a, b, c: a * b,
    "divide": lambda out, a, b, c: a / b,
    "negate": lambda out, a, b, c: -a,
    "invert": lambda out, a, b, c: 1.0 / a,
    "root": lambda out, a, b, c: np.sqrt(a),
    "magnitude": lambda out, a, b, c: np.abs(a),
    "copy": lambda out, a, b, c: a,
    "add_product": lambda out, a, b, c: out + a * b,
    "subtract_product": lambda out, a, b, c: out - a * b,
    "add_quotient": lambda out, a, b, c: out + a / b,
    "fill": lambda out, a, b, c: np.full(LANES, X),
    "add_scaled": lambda out, a, b, c: out + X * a,
    "subtract_quotient": lambda out, a, b, c: out - a * b / c,
    "centre": lambda out, a, b, c: (a - X) * b,
}


@pytest.fixture(autouse=True)
def _quiet():
    """Silence numpy's warnings: infinities and NaN are expected here."""
    with np.errstate(all="ignore"):
        yield


@kernel
def operate(which: int, arrays, row: int, start: int, x: float) -> None:
    """Apply operation number `which` of OPERATIONS to the places of `arrays` (4, rows, columns) at `row`, `start`."""
    out, a = place(arrays[0], row, start), place(arrays[1], row, start)
    b, c = place(arrays[2], row, start), place(arrays[3], row, start)
    if which == 0:
        add(out, a, b)
    elif which == 1:
        subtract(out, a, b)
    elif which == 2:
        multiply(out, a, b)
    elif which == 3:
        divide(out, a, b)
    elif which == 4:
        negate(out, a)
    elif which == 5:
        invert(out, a)
    elif which == 6:
        root(out, a)
    elif which == 7:
        magnitude(out, a)
    elif which == 8:
        copy(out, a)
    elif which == 9:
        add_product(out, a, b)
    elif which == 10:
        subtract_product(out, a, b)
    elif which == 11:
        add_quotient(out, a, b)
    elif which == 12:
        subtract_quotient(out, a, b, c)
    elif which == 13:
        fill(out, x)
    elif which == 14:
        add_scaled(out, x, a)
    elif which == 15:
        centre(out, a, x, b)


@kernel
def totals(a, b, row: int, start: int) -> tuple[float, float]:
    """Return the sums of a * b and of |a| * b at the places of `row` and `start`."""
    one, two = place(a, row, start), place(b, row, start)
    return total(one, two), total_magnitude(one, two)


@kernel
def moved(out, p: int, source, q: int, first: int, last: int) -> None:
    move(out, p, source, q, first, last)


@kernel
def blended(out, p: int, one, i: int, other, j: int, start: int, cut: int) -> None:
    blend(out, p, one, i, other, j, start, cut)


@kernel
def differences(one, p: int, other, q: int, start: int) -> np.uint64:
    return differing(one, p, other, q, start)


@kernel
def exchanged(numbers, start: int, i: int, j: int) -> None:
    """Exchange two lanes of one-dimensional `numbers`."""
    block = place_in(numbers, start)
    kept = get(block, i)
    put(block, i, get(block, j))
    put(block, j, kept)


@kernel
def ends(words, lowest, highest) -> None:
    for i in range(words.shape[0]):
        lowest[i], highest[i] = lowest_bit(words[i]), highest_bit(words[i])


def assert_same_bits(values, expected):
    np.testing.assert_array_equal(values, expected)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(values)[numbers], np.signbit(expected)[numbers])


def interpreted(name, out, a, b, c):
    """Return `out` after the interpreted operation `name`."""
    out = out.copy()
    values = {"out": out, "g": a, "a": a, "b": b, "factor": X, "mean": X, "x": X, "mask": b}
    if name in FORMULAS:
        kernels_lanes._lane_operation(FORMULAS[name], onto=name in ONTO, ignored=2)(out, a, b, c)
        return out
    function = getattr(kernels_lanes, f"_{name}")
    function(*(values[parameter] for parameter in inspect.signature(function).parameters))
    return out


def cases():
    """Yield four blocks at a time: combinations of awkward numbers, then random numbers of all magnitudes."""
    for turn in range(LANES):
        yield AWKWARD[::-1], AWKWARD, np.roll(AWKWARD, turn), np.roll(AWKWARD, 3 * turn + 1)
    random = np.random.default_rng(0)
    for _ in range(20):
        yield tuple(random.normal(size=(4, LANES)) * 10.0 ** random.integers(-9, 9, (4, LANES)))


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_is_numpy_s_on_its_own_lanes_and_touches_no_other_number(name):
    for out, a, b, c in cases():
        arrays = np.full((4, 3, 48), 7.5)
        for array, block in zip(arrays, (out, a, b, c), strict=True):
            array[ROW, START : START + LANES] = block
        before = arrays.copy()
        operate(OPERATIONS.index(name), arrays, ROW, START, X)
        values = arrays[0, ROW, START : START + LANES].copy()
        assert_same_bits(values, EXPECTED[name](out, a, b, c))
        assert_same_bits(values, interpreted(name, out, a, b, c))
        arrays[0, ROW, START : START + LANES] = out
        np.testing.assert_array_equal(arrays, before)


@pytest.mark.parametrize("name", OPERATIONS)
def test_the_result_may_stand_where_an_argument_stood(name):
    """An operation reads all its arguments before it writes; sums of adjoints need this."""
    random = np.random.default_rng(1)
    block = random.normal(size=LANES)
    if name == "root":
        block = np.abs(block)
    expected = EXPECTED[name](block, block, block, block)
    array = block.reshape(1, LANES).copy()
    operate(OPERATIONS.index(name), (array, array, array, array), 0, 0, X)
    assert_same_bits(array[0], expected)


def by_halves(numbers):
    """Return the sum of 16 numbers by its definition: add the upper half to the lower until one number is left."""
    numbers = list(numbers)
    while len(numbers) > 1:
        middle = len(numbers) // 2
        numbers = [a + b for a, b in zip(numbers[:middle], numbers[middle:], strict=True)]
    return numbers[0]


@QUICK
@given(*(st.lists(st.floats(-1e100, 1e100), min_size=16, max_size=16) for _ in range(2)))
def test_lanes_are_summed_by_halves(one, two):
    a, b = np.full((2, 32), np.nan), np.full((2, 32), np.nan)
    a[1, 16:], b[1, 16:] = one, two
    values = totals(a, b, 1, 16)
    expected = by_halves(a[1, 16:] * b[1, 16:]), by_halves(abs(a[1, 16:]) * b[1, 16:])
    assert values == expected
    assert values == (kernels_lanes._total(a[1, 16:], b[1, 16:]), kernels_lanes._total_magnitude(a[1, 16:], b[1, 16:]))


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int64, np.float64])
@pytest.mark.parametrize(("first", "last"), [(0, 40), (0, 0), (40, 40), (7, 8), (3, 39)])
def test_a_move_copies_that_part_of_the_row_and_nothing_else(kind, first, last):
    out, source = np.full((3, 40), -1, kind), np.arange(80).reshape(2, 40).astype(kind)
    expected = out.copy()
    expected[2, first:last] = source[1, first:last]
    moved(out, 2, source, 1, first, last)
    np.testing.assert_array_equal(out, expected)


def test_single_lanes_are_read_and_written_where_they_are():
    numbers = np.arange(40.0)
    exchanged(numbers, 10, 0, 15)
    expected = np.arange(40.0)
    expected[[10, 25]] = expected[[25, 10]]
    np.testing.assert_array_equal(numbers, expected)


def test_the_lowest_and_the_highest_bit_of_a_word_are_found():
    words = [1 << low | 1 << high for low in range(64) for high in range(low, 64)]
    words += [low | (low << 40) for low in range(1, 1 << 20, 12345)]
    lowest, highest = np.zeros((2, len(words)), np.int64)
    ends(np.array(words, np.uint64), lowest, highest)
    assert lowest.tolist() == [(word & -word).bit_length() - 1 for word in words]
    assert highest.tolist() == [word.bit_length() - 1 for word in words]


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int64, np.float64])
@pytest.mark.parametrize(("start", "cut"), [(0, 0), (0, 1), (0, 31), (0, 32), (32, 7), (32, 40), (32, 64), (8, 99)])
def test_a_blend_is_of_one_row_before_the_cut_and_of_the_other_from_it_on(kind, start, cut):
    random = np.random.default_rng(3)
    one, other, out = (random.integers(-99, 99, (3, 70)).astype(kind) for _ in range(3))
    expected = out.copy()
    for k in range(start, start + CHUNK):
        expected[1, k] = one[0, k] if k < cut else other[2, k]
    blended(out, 1, one, 0, other, 2, start, cut)
    np.testing.assert_array_equal(out, expected)


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int64, np.float64])
def test_bits_are_set_where_numbers_differ(kind):
    one, other = np.zeros((2, 70), kind), np.zeros((2, 70), kind)
    other[0, 40:45] = one[1, 40] = one[1, 44] = 1
    for start, places in ((0, []), (32, [41, 42, 43]), (38, [41, 42, 43])):
        assert int(differences(one, 1, other, 0, start)) == sum(1 << (place - start) for place in places)


def test_zeros_of_two_signs_differ_and_one_nan_is_itself():
    one, other = np.full((1, 32), np.nan), np.full((1, 32), np.nan)
    one[0, 5], other[0, 5] = 0.0, -0.0
    assert int(differences(one, 0, other, 0, 0)) == 1 << 5
