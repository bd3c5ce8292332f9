"""What the codec of values promises: what goes in comes out to the bit, whatever else arrives ends in one sentence."""

import contextlib
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.text.parsing import from_infix
from atoll_core.wire import codec
from atoll_core.wire.values import decode_value, encode_value
from tests.values import is_same

DTYPES = ("f8", "i8", "i4", "i2", "i1", "u1", "u8", "b1", "c16")


@dataclass(frozen=True)
class Leaf:
    number: float
    text: str = ""


@dataclass(frozen=True)
class Twig:
    number: float


@dataclass(frozen=True, eq=False)
class Tree:
    numbers: np.ndarray
    kind: Literal["one", "two", 3] = "one"
    either: Leaf | Twig | None = None
    many: tuple[Leaf, ...] = ()
    pair: tuple[int, str] = (0, "")
    rows: Sequence[bytes] = ()
    by_name: Mapping[tuple[int, bytes], Leaf] = field(default_factory=dict)
    chosen: frozenset[int] = frozenset()
    shape: Hashable = None
    share: Fraction = Fraction(0)
    is_so: bool = False
    other: np.ndarray | None = None


PROGRAM = from_infix("3*x - sin(y)/2", ("x", "y"))
INTEGERS = st.integers(-(2**63), 2**63 - 1)
LEAVES = st.builds(Leaf, st.floats(), st.text(st.characters(exclude_categories=["Cs"])))
SHAPES = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.text("ab"), lambda part: st.tuples(part, part)
)


@st.composite
def arrays(draw: st.DrawFn) -> np.ndarray:
    shape = draw(st.lists(st.integers(0, 4), max_size=4))
    dtype, count = draw(st.sampled_from(DTYPES)), math.prod(shape)
    data = draw(st.binary(min_size=16 * count, max_size=16 * count))
    flat = np.frombuffer(data, "u1")[:count] % 2 if dtype == "b1" else np.frombuffer(data, dtype)[:count]
    array = flat.astype(dtype).reshape(shape)
    return np.asfortranarray(array) if draw(st.booleans()) else array


TREES = st.builds(
    Tree,
    arrays(),
    st.sampled_from(("one", "two", 3)),
    st.none() | LEAVES | st.builds(Twig, st.floats()),
    st.lists(LEAVES, max_size=3).map(tuple),
    st.tuples(INTEGERS, st.just("a")),
    st.lists(st.binary(max_size=5), max_size=3),
    st.dictionaries(st.tuples(INTEGERS, st.binary(max_size=3)), LEAVES, max_size=3),
    st.frozensets(INTEGERS, max_size=3),
    SHAPES,
    st.fractions(-(2**40), 2**40, max_denominator=99),  # whose parts are integers of 64 bits, as all that travel
    st.booleans(),
    st.none() | arrays(),
)


@given(TREES)
def test_a_value_comes_back_to_the_bit(tree: Tree) -> None:
    data = encode_value(tree)
    back = decode_value(data, Tree)
    assert is_same(back, tree)
    assert encode_value(back) == data


def test_arrays_may_be_written_to_and_lie_as_they_did() -> None:
    by_columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    for array in (np.arange(6.0).reshape(2, 3), by_columns, by_columns[:, ::2]):
        back = decode_value(encode_value(array), np.ndarray)
        back[0, 0] = 7.0
        assert back.flags.f_contiguous == array.flags.f_contiguous


def test_every_bit_that_is_changed_is_noticed_or_gives_a_value() -> None:
    data = encode_value(
        Tree(np.arange(3.0), "two", Leaf(math.nan), (Leaf(1.0),), chosen=frozenset({3}), shape=(1, ("a",)))
    )
    draw = np.random.default_rng(3)
    for _ in range(2000):
        changed = bytearray(data)
        changed[draw.integers(len(data))] ^= 1 << int(draw.integers(8))
        for arrived in (bytes(changed), bytes(changed[: draw.integers(len(data))])):
            with contextlib.suppress(RemoteProtocolError):
                assert isinstance(decode_value(arrived, Tree), Tree)


def sent(**changed: Any) -> bytes:
    tree: Any = codec.unpack(encode_value(Tree(np.arange(3.0), either=Leaf(1.0))), 10**6)
    return codec.pack({**tree, **changed})


@pytest.mark.parametrize(
    "changed",
    [
        {"numbers": ["f8", [4], False, bytes(24)]},
        {"numbers": ["f8", [-1, -3], False, bytes(24)]},
        {"numbers": ["f8", [2**40, 2**40], False, bytes(24)]},
        {"numbers": ["f8", [1] * 5, False, bytes(8)]},
        {"numbers": ["O", [1], False, bytes(8)]},
        {"numbers": ["b1", [1], False, b"\x02"]},
        {"numbers": ["f8", [3.0], False, bytes(24)]},
        {"numbers": ["f8", [3], 0, bytes(24)]},
        {"numbers": None},
        {"kind": "three"},
        {"kind": 3.0},
        {"either": [2, {}]},
        {"either": [True, {"number": 1.0}]},
        {"either": [0, {"number": "1.0", "text": ""}]},
        {"either": [0, {"number": 1.0, "text": "", "more": 1}]},
        {"many": {"number": 1.0}},
        {"pair": [1]},
        {"pair": [True, ""]},
        {"rows": ["text"]},
        {"by_name": [[[1, b""], {"number": 1.0, "text": ""}]] * 2},
        {"by_name": {"a": 1}},
        {"chosen": [1, 1]},
        {"shape": [{"a": 1}]},
        {"share": [1, 0]},
        {"share": [0.5, 1]},
        {"is_so": 1},
        {"more": 1},
    ],
)  # fmt: skip
def test_what_is_no_value_of_the_type_is_refused(changed: dict[str, Any]) -> None:
    assert isinstance(decode_value(sent(), Tree), Tree)
    with pytest.raises(RemoteProtocolError, match="bytes do not hold a value of Tree"):
        decode_value(sent(**changed), Tree)


@pytest.mark.parametrize(
    "value",
    [
        object(),
        Tree(np.array(["a"])),
        Tree(np.array([1 + 2j], dtype=np.complex64)),
        Tree(np.arange(3.0), either=PROGRAM),
    ],
)
def test_what_cannot_travel_is_said_at_once(value: object) -> None:
    with pytest.raises(LocalProtocolError, match="cannot be encoded"):
        encode_value(value)
