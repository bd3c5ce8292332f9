"""What the codec promises: what goes in comes out, and whatever else arrives ends in one sentence."""

import contextlib
import tracemalloc
from dataclasses import replace
from typing import Annotated, Literal

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.wire import codec


class Ping(Frozen):
    kind: Literal["ping"] = "ping"
    number: int = 0
    ratio: float | None = None
    text: str = ""
    block: bytes = b""
    rows: tuple[tuple[int, str], ...] = ()
    names: dict[str, int] = Field(default_factory=dict)


class Pong(Frozen):
    kind: Literal["pong"] = "pong"
    ping: Ping


class Either(Frozen):
    body: Annotated[Ping | Pong, Field(discriminator="kind")]


INTEGERS = st.integers(-(2**63), 2**64 - 1)
TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PINGS = st.builds(
    Ping,
    number=INTEGERS,
    ratio=st.none() | st.floats(allow_nan=False, allow_infinity=False),
    text=TEXT,
    block=st.binary(max_size=300),
    rows=st.lists(st.tuples(INTEGERS, TEXT), max_size=20).map(tuple),
    names=st.dictionaries(TEXT, INTEGERS, max_size=20),
)


@given(PINGS)
def test_a_message_comes_back_as_it_was(ping: Ping) -> None:
    assert codec.decode(codec.encode(ping), Ping) == ping
    assert codec.decode(codec.encode(Either(body=Pong(ping=ping))), Either).body == Pong(ping=ping)


def test_bytes_stay_bytes_and_numpy_scalars_become_numbers() -> None:
    ping = Ping.model_construct(kind="ping", number=np.int64(7), ratio=np.float64(0.1), block=b"\xff\x00")  # type: ignore[arg-type]
    back = codec.decode(codec.encode(ping), Ping)
    assert (back.number, back.ratio, back.block) == (7, 0.1, b"\xff\x00")
    assert type(back.number) is int


@given(st.binary(max_size=400).filter(lambda noise: noise != b"\x80"))  # which is a message without any field
def test_noise_is_never_anything_but_a_remote_error(noise: bytes) -> None:
    for act in (
        lambda: codec.decode(noise, Ping),
        lambda: codec.decode(noise, Either),
        lambda: codec.decode_arrays(b"atollar1" + noise),
        lambda: codec.dataset_from_bytes(noise),
    ):
        with pytest.raises(RemoteProtocolError):
            act()


@given(PINGS, st.data())
def test_a_damaged_message_is_a_message_or_a_remote_error(ping: Ping, data: st.DataObject) -> None:
    good = bytearray(codec.encode(ping))
    good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    del good[data.draw(st.integers(0, len(good))) :]
    with contextlib.suppress(RemoteProtocolError):
        assert isinstance(codec.decode(bytes(good), Ping), Ping)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "ends too early"),
        (b"\xdd\xff\xff\xff\xff", "more items than it has bytes"),
        (b"\xdf\xff\xff\xff\xff", "more items than it has bytes"),
        (b"\xdc\x00\x80" * 200 + bytes(200), "nested|more items"),
        (b"\x91" * 100 + b"\x00", "nested deeper than 32"),
        (b"\xc6\xff\xff\xff\xff\x00", "ends too early"),
        (b"\xc6\xff", "ends too early"),
        (b"\x81\x01\x02", "not allowed for map key"),
        (b"\x81\xc4\x01a\x02", "key of a map is not text"),
        (b"\xd6\xff\x00\x00\x00\x00", "extension"),
        (b"\xc1", "unused"),
        (b"\x80\x80", "1 bytes follow"),
        (b"\xa2\xff\xfe", "malformed|utf-8"),
        (b"\x07", "field"),
        (msgpack.packb({"kind": "ping", "extra": 1}), "extra"),
        (msgpack.packb({"kind": "pong"}), "kind"),
        (msgpack.packb({"kind": "ping", "ratio": float("nan")}), "ratio"),
        (msgpack.packb({"kind": "ping", "number": "x" * 10_000}), "number"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(data: bytes, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason) as caught:
        codec.decode(data, Ping)
    assert len(str(caught.value)) < 500


def test_a_message_larger_than_allowed_is_refused_before_it_is_read() -> None:
    with pytest.raises(RemoteProtocolError, match="more than the 100 allowed"):
        codec.decode(codec.encode(Ping(block=bytes(200))), Ping, max_bytes=100)


@pytest.mark.parametrize("value", [{3: 1}, object(), 2**64, "\ud800", np.zeros(3)])
def test_what_cannot_travel_is_our_own_error(value: object) -> None:
    with pytest.raises(LocalProtocolError):
        codec.encode(Ping.model_construct(kind="ping", names=value))  # type: ignore[arg-type]


@pytest.mark.parametrize("dtype", codec.DTYPES)
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (2, 0, 4)])
def test_arrays_come_back_with_type_shape_and_bits(dtype: str, shape: tuple[int, ...]) -> None:
    array = np.arange(int(np.prod(shape)), dtype=dtype).reshape(shape)
    header, arrays = codec.decode_arrays(codec.encode_arrays({"a": [1, None, "x"]}, {"one": array, "two": array.T}))
    assert header == {"a": [1, None, "x"]}
    for decoded, expected in ((arrays["one"], array), (arrays["two"], array.T)):
        assert decoded.dtype == expected.dtype
        assert decoded.shape == expected.shape
        assert decoded.tobytes() == expected.tobytes()


@pytest.mark.parametrize("array", [np.array(["text"]), np.array([None]), np.zeros(2, dtype=bool), np.zeros((1,) * 5)])
def test_other_types_of_arrays_do_not_travel(array: np.ndarray) -> None:
    with pytest.raises(LocalProtocolError, match="cannot be sent"):
        codec.encode_arrays({}, {"x": array})


def _block(head: object, rest: bytes = b"") -> bytes:
    packed = msgpack.packb(head)
    start = b"atollar1" + len(packed).to_bytes(8, "little") + packed
    return start + bytes(-len(start) % 64) + rest


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "begin"),
        (b"atollar1" + b"\xff" * 8, "early"),
        (_block([]), "head"),
        (_block({"header": {}, "arrays": 3}), "iterable|int"),
        (_block({"header": {}, "arrays": [["x", "O", [1]]]}), "not allowed"),
        (_block({"header": {}, "arrays": [["x", "f8", [-1]]]}), "shape"),
        (_block({"header": {}, "arrays": [["x", "f8", [True]]]}), "shape"),
        (_block({"header": {}, "arrays": [["x", "f8", [2**62, 2**62]]]}, bytes(8)), "longer"),
        (_block({"header": {}, "arrays": [["x", "f8", [1]], ["x", "f8", [0]]]}, bytes(64)), "twice"),
        (_block({"header": {}, "arrays": [["x", "f8", [1]]]}, bytes(9)), "were found"),
        (_block({"header": {}, "arrays": [[3, "f8", [1]]]}, bytes(8)), "name"),
        (_block({"header": {}, "arrays": [["x", "f8"]]}, bytes(8)), "unpack"),
    ],
)
def test_a_malformed_block_of_arrays_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason):
        codec.decode_arrays(data)


def _dataset(values: np.ndarray | None = None) -> Dataset:
    inputs = np.array([[1.0, 2.0, 3.0], [-0.0, 1e-300, 0.1]])
    values = np.array([0.1, -1.0, 5.0]) if values is None else values
    target = Target("v [m/s]", "dv/dt", values, 1e-9, np.float64(0.5), 0)
    return Dataset(("v", "θ"), inputs, (target,), {"v [m/s]": "v", "θ": "θ"}, ("a warning",))


def test_a_dataset_comes_back_with_the_same_digest() -> None:
    data = codec.dataset_to_bytes(_dataset())
    back = codec.dataset_from_bytes(data)
    assert back.digest == _dataset().digest
    assert (back.names, back.symbols, back.warnings) == (("v", "θ"), {"v [m/s]": "v", "θ": "θ"}, ("a warning",))
    assert back.targets[0].lhs == "dv/dt"
    assert codec.dataset_to_bytes(back) == data


def test_groups_of_rows_come_back_and_are_checked() -> None:
    whole = _dataset()
    rows = whole.inputs.shape[1]
    grouped = replace(whole, groups=np.arange(rows) % 2)
    back = codec.dataset_from_bytes(codec.dataset_to_bytes(grouped))
    assert back.groups is not None
    assert back.groups.tolist() == (np.arange(rows) % 2).tolist()
    assert back.digest == grouped.digest != whole.digest
    for wrong in (np.arange(rows + 1), np.arange(rows) - 1):
        with pytest.raises(RemoteProtocolError, match="groups of rows"):
            codec.dataset_from_bytes(codec.dataset_to_bytes(replace(whole, groups=wrong)))


def test_arrays_of_a_decoded_dataset_are_aligned_writable_and_contiguous() -> None:
    back = codec.dataset_from_bytes(codec.dataset_to_bytes(_dataset()))
    for array in (back.inputs, back.targets[0].values):
        assert array.flags.carray


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (np.array([1.0, np.nan, 0.0]), "NaN"),
        (np.zeros(4), "shape"),
        (np.zeros((3, 1)), "shape"),
        (np.zeros(3, "i8"), "numbers"),
    ],
)
def test_a_dataset_that_is_not_finite_or_does_not_fit_is_refused(values: np.ndarray, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason):
        codec.dataset_from_bytes(codec.dataset_to_bytes(_dataset(values)))


class Item(Frozen):
    number: int
    text: str


class Many(Frozen):
    items: tuple[Item, ...]


def long_array(count: int, item: bytes) -> bytes:
    """Return a message whose `items` are so many times the same bytes."""
    return b"\x81\xa5items\xdd" + count.to_bytes(4, "big") + item * count


@pytest.mark.parametrize("item", [b"\x80", b"\x90", b"\xe0", b"\xa2ab", b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00"])
def test_many_wrong_items_cost_no_more_memory_than_a_multiple_of_their_number(item: bytes) -> None:
    data = long_array(50_000, item)
    tracemalloc.start()
    try:
        with pytest.raises(RemoteProtocolError, match="items"):
            codec.decode(data, Many)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 50_000 * 120


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (long_array(100_001, b"\x00"), "exceeds max_array_len"),
        (long_array(50_000, b"\x91\x00"), "more than 2000000 items"),
        (long_array(100_000, b"\x80"), "more than 2000000 items"),
        (b"\xde\x10\x01" + b"".join(b"\xa4%04d\x00" % number for number in range(4097)), "exceeds max_map_len"),
        (b"\x91" * 100_000, "nested deeper"),
    ],
)
def test_too_much_is_refused_while_it_is_built(data: bytes, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "MAX_ITEMS", 100_000)
    with pytest.raises(RemoteProtocolError, match=reason):
        codec.decode(data, Many)
