"""Bytes of values that programs exchange: frozen dataclasses, arrays, programs, configurations. Never executable code.

Only the expected type decides how bytes are read. `_codec` returns a reader and a writer for each type. They encode a
dataclass as a map of its fields; a tuple, sequence or set as a list; a mapping as a list of pairs; a union as the
number of the member and its value; an array as its type, shape, order and bytes; and a pydantic model as its own
message. Numbers, texts and lengths of tuples must have exactly the expected type. Equal values give equal bytes on
every machine; decoded values are equal to the bit, NaN and infinity included, and decoded arrays are writable. Anything
that does not fit raises a RemoteProtocolError.

Supported types: dataclasses whose fields have supported types, None, bool, int of 64 bits, float, str, bytes, Fraction,
tuples, sequences, mappings, sets, literals, unions, arrays of `DTYPES`, of bool and of complex numbers, `Program`,
pydantic models such as JobConfig, and nested tuples of plain values where a type says ``Hashable``. A new kind of type
is added in `_codec`.
"""

import dataclasses
import types
from collections.abc import Callable, Hashable, Iterable, Mapping, Set
from collections.abc import Sequence as AnySequence
from fractions import Fraction
from functools import cache, partial
from typing import Any, Final, Literal, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from atoll_core.config import Frozen
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.program import Program
from atoll_core.wire.codec import (
    BROKEN,
    DTYPES,
    MAX_ARRAYS_BYTES,
    MAX_DIMENSIONS,
    array_size,
    decode,
    encode,
    pack,
    require,
    unpack,
)

V = TypeVar("V")

_DTYPES: Final = frozenset((*DTYPES, "b1", "c16"))
_MOST_VARIABLES: Final = 2**15
"""Limit of a variable's index in a program: the number of variables of its problem is checked where it is known."""
_MISFITS: Final = (*BROKEN, ArithmeticError, AttributeError, LocalProtocolError, RemoteProtocolError)
"""Errors of reading or writing a value of another type."""
_NONE: Final = type(None)


def encode_value(value: object, kind: object = None) -> bytes:
    """Return the bytes of a value of the type `kind` (default: its class).

    Raises:
        LocalProtocolError: the value has parts that cannot be encoded, or is of another type.
    """
    expected = type(value) if kind is None else kind
    try:
        return pack(_codec(expected).write(value))
    except _MISFITS as error:
        raise LocalProtocolError(f"a value of {_name(expected)} cannot be encoded: {error}"[:300]) from error


def decode_value(data: bytes, kind: type[V], max_bytes: int = MAX_ARRAYS_BYTES) -> V:
    """Return the value of the type `kind` in `data`; memory in addition to the value is a small multiple of `data`.

    Raises:
        RemoteProtocolError: `data` is oversized or malformed, or holds no value of that type.
    """
    try:
        return cast(V, _codec(cast(Hashable, kind)).read(unpack(data, max_bytes)))
    except _MISFITS as error:
        raise RemoteProtocolError(f"bytes do not hold a value of {_name(kind)}: {error}"[:300]) from error


def _name(kind: object) -> str:
    return getattr(kind, "__name__", None) or str(kind)


class _Codec(NamedTuple):
    """Two functions: `write` turns a value of one type into a plain tree, and `read` turns the tree into the value."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


@cache
def _codec(kind: Any) -> _Codec:
    origin, parts = get_origin(kind), get_args(kind)
    if kind in _PLAIN or origin is np.ndarray:
        return _PLAIN[origin or kind]
    if isinstance(kind, type) and issubclass(kind, Frozen):
        return _Codec(lambda tree: decode(_exactly(bytes, tree), kind), encode)
    if dataclasses.is_dataclass(kind):
        return _dataclass_codec(kind)
    if origin is Literal:
        return _Codec(lambda tree: _literal(tree, parts), lambda value: value)
    if origin in (Union, types.UnionType):
        return _union_codec(kind, parts)
    if origin is tuple and parts[-1:] != (Ellipsis,):
        return _tuple_codec(() if parts == ((),) else parts)
    if origin in _COLLECTIONS:
        return _collection_codec(_COLLECTIONS[origin], _codec(parts[0]))
    if origin in (Mapping, dict):
        return _mapping_codec(*map(_codec, parts))
    raise TypeError(f"{kind} is not a type that can be encoded")


def _dataclass_codec(kind: Any) -> _Codec:
    hints, fields = get_type_hints(kind), [field for field in dataclasses.fields(kind) if field.init]
    needed = {field.name for field in fields if field.default is field.default_factory}  # both are MISSING
    codecs = {field.name: _codec(hints[field.name]) for field in fields}
    fields_expected = f"the fields of a {_name(kind)} are {', '.join(codecs)}"

    def read(tree: Any) -> Any:
        require(needed <= _exactly(dict, tree).keys() <= codecs.keys(), fields_expected)
        return kind(**{name: codecs[name].read(part) for name, part in tree.items()})

    return _Codec(read, lambda value: {name: codec.write(getattr(value, name)) for name, codec in codecs.items()})


def _union_codec(kind: Any, parts: tuple[Any, ...]) -> _Codec:
    """Return the codec of a union: None and a single other member are encoded as they are, several members with their
    number."""
    members = [part for part in parts if part is not _NONE]
    codecs = [_codec(member) for member in members]
    classes = [get_origin(member) or member for member in members]

    def read(tree: Any) -> Any:
        if tree is None and _NONE in parts:
            return None
        if len(members) == 1:
            return codecs[0].read(tree)
        number, value = _list(tree, 2)
        require(type(number) is int and 0 <= number < len(members), f"{number!r:.20} is no member of {kind}")
        return codecs[number].read(value)

    def write(value: Any) -> Any:
        if value is None:
            return None
        if len(members) == 1:
            return codecs[0].write(value)
        number = next((place for place, one in enumerate(classes) if isinstance(value, one)), -1)
        require(number >= 0, f"{type(value).__name__} is no member of {kind}")
        return [number, codecs[number].write(value)]

    return _Codec(read, write)


def _tuple_codec(parts: tuple[Any, ...]) -> _Codec:
    codecs = [_codec(part) for part in parts]
    return _Codec(
        lambda tree: tuple(codec.read(item) for codec, item in zip(codecs, _list(tree, len(codecs)), strict=True)),
        lambda value: [codec.write(item) for codec, item in zip(codecs, value, strict=True)],
    )


def _collection_codec(make: Callable[[Iterable[Any]], Any], item: _Codec) -> _Codec:
    arranged: Callable[[Any], Any] = sorted if make is _set else iter
    return _Codec(
        lambda tree: make([item.read(part) for part in _list(tree)]),
        lambda value: [item.write(part) for part in arranged(value)],
    )


def _mapping_codec(key: _Codec, item: _Codec) -> _Codec:
    def read(tree: Any) -> Any:
        pairs = [_list(pair, 2) for pair in _list(tree)]
        mapping = {key.read(name): item.read(value) for name, value in pairs}
        require(len(mapping) == len(pairs), "a mapping has a key twice")
        return mapping

    return _Codec(read, lambda value: [[key.write(name), item.write(part)] for name, part in value.items()])


def _set(items: list[Any]) -> frozenset[Any]:
    require(len(set(items)) == len(items), "a set has an item twice")
    return frozenset(items)


def _exactly(kind: type, value: Any) -> Any:
    if type(value) is not kind:  # `require` would need a sentence for each number, which takes longer than reading it
        raise ValueError(f"{type(value).__name__} was found where {kind.__name__} was expected")
    return value


def _float(value: Any) -> float:
    """Return a number; an integer is accepted where a float is expected, as in Python."""
    return cast(float, value if type(value) is int else _exactly(float, value))


def _list(value: Any, length: int | None = None) -> list[Any]:
    if length not in (None, len(_exactly(list, value))):
        raise ValueError(f"{len(value)} items were found where {length} were expected")
    return cast(list[Any], value)


def _fraction(tree: Any) -> Fraction:
    numerator, denominator = _list(tree, 2)
    return Fraction(_exactly(int, numerator), _exactly(int, denominator))


def _tuples(tree: Any) -> Hashable:
    """Return nested sequences as tuples."""
    if type(tree) is list:
        return tuple(map(_tuples, tree))
    require(tree is None or type(tree) in (bool, int, float, str, bytes), "a map was found among plain values")
    return cast(Hashable, tree)


def _literal(value: Any, choices: tuple[Any, ...]) -> Any:
    is_one = any(value == choice and type(value) is type(choice) for choice in choices)
    require(is_one, f"{value!r:.80} is none of {choices}")
    return value


def _array_tree(array: AnyArray) -> list[Any]:
    """Return type, shape, whether the bytes are in column-major order, and the bytes (little endian).

    The order is kept, because sums depend on it.
    """
    dtype = array.dtype.str[1:]
    if dtype not in _DTYPES or array.ndim > MAX_DIMENSIONS:  # the name of a dtype is slow to make: only for the error
        raise ValueError(f"an array of {array.dtype}, {array.ndim} dimensions")
    by_columns = array.flags.f_contiguous and not array.flags.c_contiguous
    little = np.asarray(array, array.dtype.newbyteorder("<"))
    return [dtype, list(array.shape), by_columns, little.tobytes("F" if by_columns else "C")]


def _array(tree: Any) -> AnyArray:
    dtype, shape, by_columns, data = _list(tree, 4)
    size = array_size("an array", dtype, shape, _DTYPES)
    require(type(by_columns) is bool, "an array does not say in which order it is")
    require(len(_exactly(bytes, data)) == size, f"an array of shape {shape} has {len(data)} bytes")
    require(dtype != "b1" or max(data, default=0) <= 1, "an array of truth values holds others")
    numbers: AnyArray = np.frombuffer(data, "<" + dtype).astype(dtype)
    return numbers.reshape(shape, order="F" if by_columns else "C")


_PLAIN: Final[dict[Any, _Codec]] = {
    **{kind: _Codec(partial(_exactly, kind), lambda value: value) for kind in (bool, int, str, bytes, _NONE)},
    float: _Codec(_float, lambda value: float(value) if isinstance(value, float) else value),
    Fraction: _Codec(_fraction, lambda number: [number.numerator, number.denominator]),
    Program: _Codec(lambda tree: Program.from_bytes(_exactly(bytes, tree), _MOST_VARIABLES), Program.to_bytes),
    Hashable: _Codec(_tuples, lambda value: value),
    np.ndarray: _Codec(_array, _array_tree),
}
_COLLECTIONS: Final[dict[Any, Any]] = {tuple: tuple, AnySequence: tuple, list: list, frozenset: _set, Set: _set}
"""Types of many items of one type, and the types in which items are decoded."""
