"""Bytes on the wire and in the store: msgpack for messages, a small header and raw columns for arrays.

The only module that imports msgpack. Bytes from a peer are not trusted. First their structure is walked once, before
anything is allocated: size, and lengths that fit the available bytes. Items are counted while they are built. Then the
model checks them, and stops at the first wrong item of a sequence. All failures raise a RemoteProtocolError with one
sentence. No executable code (pickle) is ever sent, and nothing is compressed.
"""

import math
import struct
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Final, TypeVar, cast

import msgpack
import numpy as np
from pydantic import Field, ValidationError

from atoll_core.config import Frozen
from atoll_core.data.dataset import AnyArray, Dataset, FloatArray, Target
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD

M = TypeVar("M", bound=Frozen)
_Size = Annotated[float, Field(ge=0.0)]

MAX_NESTING: Final = 32
MAX_ITEMS: Final = 2_000_000
"""Most items in a message; keys and values count separately. The largest message then has eight bytes per item."""

MAX_MAP: Final = 4096
"""Most entries of a map: no model has more fields, and no job more variables."""

MAX_ARRAYS_BYTES: Final = 2**31
MAX_DIMENSIONS: Final = 4
DTYPES: Final = ("f8", "i8", "i4", "i2", "i1", "u1", "u8")

_SMALL: Final = 64 * 1024  # fewer bytes hold too few items to be worth counting
_MAGIC: Final = b"atollar1"
_ALIGNMENT: Final = 64
BROKEN: Final = (
    ValueError,
    TypeError,
    KeyError,
    OverflowError,
    RecursionError,
    MemoryError,
    msgpack.exceptions.UnpackException,
)
"""Errors that reading foreign bytes, or using the values in them, may raise."""


def encode(model: Frozen) -> bytes:
    """Return the msgpack bytes of a message. Keys of maps must be text.

    Raises:
        LocalProtocolError: the message holds a value that cannot be encoded.
    """
    return pack(model.model_dump(warnings="none"))


def decode(data: bytes, kind: type[M], max_bytes: int = MAX_PAYLOAD) -> M:
    """Return the message in `data`, checked by the model `kind`.

    Raises:
        RemoteProtocolError: `data` is oversized, malformed or not of this `kind`.
    """
    tree = unpack(data, max_bytes)
    try:
        return kind.model_validate(tree)
    except BROKEN as error:
        raise RemoteProtocolError(f"a message does not fit {kind.__name__}: {_brief(error)}") from error


def encode_arrays(header: Mapping[str, object], arrays: Mapping[str, AnyArray]) -> bytes:
    """Return one block of bytes: magic, length of the head, the head (msgpack), then every array's bytes, aligned.

    The same header and arrays give the same bytes on every machine (little endian, C order).

    Raises:
        LocalProtocolError: an array is not of a type in `DTYPES`, or the header cannot be encoded.
    """
    plain: dict[str, AnyArray] = {}
    for name, array in arrays.items():
        if array.dtype.str[1:] not in DTYPES or array.ndim > MAX_DIMENSIONS:
            raise LocalProtocolError(f"array {name!r} of type {array.dtype} and {array.ndim} dimensions cannot be sent")
        plain[name] = np.asarray(array, dtype=array.dtype.newbyteorder("<"), order="C")
    head = pack({"header": dict(header), "arrays": [[n, a.dtype.str[1:], list(a.shape)] for n, a in plain.items()]})
    parts = [_MAGIC, struct.pack("<Q", len(head)), head]
    place = len(_MAGIC) + 8 + len(head)
    for array in plain.values():
        gap = -place % _ALIGNMENT
        parts += [bytes(gap), array.tobytes()]
        place += gap + array.nbytes
    return b"".join(parts)


def decode_arrays(data: bytes) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Return header and arrays of `encode_arrays`. The arrays are read-only views of `data`.

    Raises:
        RemoteProtocolError: the block is oversized or malformed, or its shapes do not fit its bytes.
    """
    if len(data) > MAX_ARRAYS_BYTES:
        raise RemoteProtocolError(f"a block of arrays has {len(data)} bytes, more than the {MAX_ARRAYS_BYTES} allowed")
    start = len(_MAGIC) + 8
    try:
        require(data[: len(_MAGIC)] == _MAGIC and len(data) >= start, "it does not begin as one")
        (head_bytes,) = struct.unpack_from("<Q", data, len(_MAGIC))
        place = start + head_bytes
        head = unpack(bytes(data[start:place]), min(len(data) - start, MAX_PAYLOAD))
        if not isinstance(head, dict) or head.keys() != {"header", "arrays"} or not isinstance(head["header"], dict):
            raise ValueError("its head is not a header and a list of arrays")
        arrays: dict[str, AnyArray] = {}
        for name, dtype, shape in head["arrays"]:
            require(isinstance(name, str), "an array has no name")
            require(name not in arrays, f"array {name!r} is there twice")
            size = array_size(f"array {name!r}", dtype, shape)
            place += -place % _ALIGNMENT
            require(place + size <= len(data), f"array {name!r} is longer than the block")
            arrays[name] = np.frombuffer(data, "<" + dtype, math.prod(shape), place).reshape(shape)
            place += size
        require(place == len(data), f"{len(data)} bytes were found and {place} expected")
    except BROKEN as error:
        raise RemoteProtocolError(f"a block of arrays is malformed: {_brief(error)}") from error
    return head["header"], arrays


class _DatasetHeader(Frozen):
    """A dataset without its arrays; `targets` are variable, left side, uncertainty, standard deviation and noise."""

    names: tuple[str, ...]
    symbols: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    targets: tuple[tuple[str, str, _Size, _Size, _Size], ...]


def dataset_to_bytes(dataset: Dataset) -> bytes:
    """Return the bytes of a prepared dataset, for the store and for messages."""
    header = {
        "names": dataset.names,
        "symbols": tuple(dataset.symbols.items()),
        "warnings": dataset.warnings,
        "targets": [
            [t.variable, t.lhs, float(t.uncertainty), float(t.standard_deviation), float(t.noise)]
            for t in dataset.targets
        ],
    }
    arrays: dict[str, AnyArray] = {"inputs": dataset.inputs}
    arrays |= {f"target {index}": target.values for index, target in enumerate(dataset.targets)}
    if dataset.groups is not None:
        arrays["groups"] = dataset.groups
    return encode_arrays(header, arrays)


def dataset_from_bytes(data: bytes) -> Dataset:
    """Return the dataset in `data`: finite, shapes checked, arrays aligned and writable as compiled kernels expect.

    Raises:
        RemoteProtocolError: `data` holds no dataset.
    """
    tree, arrays = decode_arrays(data)
    try:
        header = _DatasetHeader.model_validate(tree)
        inputs = _finite("inputs", arrays["inputs"], (len(header.names), -1))
        rows = inputs.shape[1]
        targets = tuple(
            Target(variable, lhs, _finite(f"values of target {variable!r}", arrays[f"target {index}"], (rows,)), *sizes)
            for index, (variable, lhs, *sizes) in enumerate(header.targets)
        )
        groups = arrays.get("groups")
        if groups is not None:
            fits = groups.dtype == np.int64 and groups.shape == (rows,) and bool((groups >= 0).all())
            require(fits, "the groups of rows are not numbers from 0, one for each row")
            groups = np.array(groups, dtype=np.int64, order="C")
        return Dataset(header.names, inputs, targets, dict(header.symbols), header.warnings, groups)
    except BROKEN as error:
        raise RemoteProtocolError(f"a dataset is malformed: {_brief(error)}") from error


def pack(tree: object) -> bytes:
    """Return the msgpack bytes of plain values; raises LocalProtocolError if a value cannot be encoded."""
    try:
        _check_tree(tree)
        return cast(bytes, msgpack.packb(tree, default=_plain))
    except BROKEN as error:
        raise LocalProtocolError(f"a message cannot be encoded: {_brief(error)}") from error


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent")


def unpack(data: bytes, max_bytes: int) -> object:
    """Return the plain values in msgpack bytes; raises RemoteProtocolError for other bytes, or too many."""
    if len(data) > max_bytes:
        raise RemoteProtocolError(f"a message has {len(data)} bytes, more than the {max_bytes} allowed")
    try:
        _walk(data)
        tree = _built(data)
        _check_tree(tree)
        return tree
    except BROKEN as error:
        raise RemoteProtocolError(f"a message is not well-formed msgpack: {_brief(error)}") from error


def _built(data: bytes) -> object:
    """Return the contents of well-formed msgpack bytes; raises ValueError as soon as they are too many.

    An empty container has one byte in a message, and takes up to ninety bytes of memory when built.
    """
    left = MAX_ITEMS

    def count(built: Collection[object]) -> Collection[object]:
        nonlocal left
        left -= 1 + len(built) * (2 if isinstance(built, dict) else 1)
        if left < 0:
            raise ValueError(_TOO_MANY)
        return built

    limits: dict[str, Any] = {"raw": False, "strict_map_key": True, "max_map_len": MAX_MAP}
    if len(data) > _SMALL:
        limits |= {"max_array_len": MAX_ITEMS, "list_hook": count, "object_hook": count}
    return msgpack.unpackb(data, **limits)


def _walk(data: bytes) -> None:
    """Check the structure of msgpack bytes without building it: one item, which ends where the bytes end.

    Every item takes at least one byte, so that an announced length beyond the remaining bytes is false; this bounds the
    memory of unpacking by a small multiple of `len(data)`.
    """
    unpacker = msgpack.Unpacker(max_buffer_size=max(1, len(data)))
    unpacker.feed(data)
    try:
        unpacker.skip()
    except msgpack.OutOfData:
        raise ValueError("it ends too early, or announces more items than it has bytes") from None
    except msgpack.StackError:
        raise ValueError(_TOO_DEEP) from None
    except msgpack.FormatError:
        raise ValueError("it holds an unused type") from None
    if unpacker.tell() != len(data):
        raise ValueError(f"{len(data) - unpacker.tell()} bytes follow its end")


def _check_tree(tree: object) -> None:
    """Check that a message has plain values, text as keys, and at most `MAX_NESTING` levels.

    It goes level by level, which is much faster than container by container.
    """
    level: list[Any] = [[tree]]
    for _ in range(MAX_NESTING + 1):
        items: list[object] = []
        for container in level:
            if type(container) is dict:
                if not _TEXT.issuperset(map(type, container)):
                    raise ValueError("the key of a map is not text")
                items.extend(container.values())
            else:
                items.extend(container)
        kinds = set(map(type, items))
        if not kinds.isdisjoint(_REFUSED):
            raise ValueError("it holds an extension type")
        if kinds.isdisjoint(_CONTAINERS):
            return
        level = [item for item in items if type(item) in _CONTAINERS]
    raise ValueError(_TOO_DEEP)


_TEXT: Final = frozenset({str})
_CONTAINERS: Final = frozenset({list, tuple, dict})
_REFUSED: Final = frozenset({msgpack.ExtType, msgpack.Timestamp})
_TOO_MANY: Final = f"it holds more than {MAX_ITEMS} items"
_TOO_DEEP: Final = f"it is nested deeper than {MAX_NESTING} levels"


def _brief(error: BaseException) -> str:
    """Return an error in one line; for a model, the first invalid field."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        return f"field {'.'.join(map(str, first['loc'])) or '(whole)'}: {first['msg']}"[:300]
    return f"{error}"[:300] or type(error).__name__


def array_size(name: str, dtype: object, shape: object, allowed: Collection[str] = DTYPES) -> int:
    """Return the bytes of an array of this announced type and shape; raises ValueError if they are not allowed."""
    require(isinstance(dtype, str) and dtype in allowed, f"{name} is of a type that is not allowed")
    require(isinstance(shape, list) and len(shape) <= MAX_DIMENSIONS, f"{name} has no proper shape")
    sizes = cast(list[object], shape)
    require(all(type(size) is int and size >= 0 for size in sizes), f"{name} has no proper shape")
    return math.prod(cast(list[int], sizes)) * int(cast(str, dtype)[1:])


def require(condition: bool, sentence: str) -> None:
    """Raise ValueError with this sentence unless the condition holds."""
    if not condition:
        raise ValueError(sentence)


def _finite(name: str, array: AnyArray, shape: tuple[int, ...]) -> FloatArray:
    require(array.dtype == np.float64 and array.ndim == len(shape), f"{name} are not numbers of the right shape")
    fits = all(wanted in (-1, length) for length, wanted in zip(array.shape, shape, strict=True))
    require(fits, f"{name} have shape {array.shape} instead of {shape}")
    require(bool(np.isfinite(array).all()), f"{name} hold NaN or infinity")
    return np.array(array, dtype=np.float64, order="C")
