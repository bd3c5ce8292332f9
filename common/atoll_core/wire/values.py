"""Bytes of values that programs hand each other: frozen dataclasses, arrays, programs, configurations. No code.

The type that is expected decides how bytes are read, never the bytes: dataclasses by their fields (cattrs), unions by
the number of the member, numbers, texts and lengths of tuples by exact type, and arrays with the type and shape that
are written before their bytes. The same value gives the same bytes on every machine, and what is read of them is equal
to the bit, NaN and infinity included, in arrays that may be written to. Whatever does not fit is a RemoteProtocolError.

What may be in a value: dataclasses whose fields have types of this kind again, None, truth values, whole numbers of 64
bits, floats, texts, bytes, fractions, tuples, sequences, mappings, sets, literals, optional and other unions, arrays of
`codec.DTYPES` and truth values, `Program`, models such as JobConfig, and nested tuples of plain ones where a type says
``Hashable``.
"""

import math
import types
from collections.abc import Callable, Hashable, Mapping, Set
from collections.abc import Sequence as AnySequence
from dataclasses import is_dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Final, Literal, TypeVar, Union, cast, get_args, get_origin

import numpy as np
from cattrs import Converter
from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError, StructureHandlerNotFoundError

from atoll_core.config import Frozen
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.program import Program
from atoll_core.wire.codec import BROKEN, DTYPES, MAX_ARRAYS_BYTES, MAX_DIMENSIONS, decode, encode, pack, unpack

V = TypeVar("V")

_DTYPES: Final = frozenset((*DTYPES, "b1"))
_MOST_VARIABLES: Final = 2**15
"""More than the index of a variable can tell apart: whose program it is decides how many there are."""
_MISFITS: Final = (
    *BROKEN,
    ArithmeticError,
    AttributeError,
    BaseValidationError,
    ForbiddenExtraKeysError,
    RemoteProtocolError,
)
"""What taking a value of one type for one of another raises."""
_NONE: Final = type(None)


def encode_value(value: object, kind: object = None) -> bytes:
    """Return the bytes of a value of the type `kind`: its own class, unless given.

    Raises:
        LocalProtocolError: it holds something that cannot travel, or is none of that type.
    """
    expected = type(value) if kind is None else kind
    try:
        return pack(_converter().unstructure(value, unstructure_as=expected))
    except (*_MISFITS, LocalProtocolError, StructureHandlerNotFoundError) as error:
        raise LocalProtocolError(f"a value of {_name(expected)} cannot be encoded: {error}"[:300]) from error


def decode_value(data: bytes, kind: type[V], max_bytes: int = MAX_ARRAYS_BYTES) -> V:
    """Return the value of the type `kind` in `data`; memory beyond that of the value is a small multiple of `data`.

    Raises:
        RemoteProtocolError: `data` is oversized, malformed, or holds no value of that type.
    """
    try:
        return _converter().structure(unpack(data, max_bytes), kind)
    except _MISFITS as error:
        raise RemoteProtocolError(f"bytes do not hold a value of {_name(kind)}: {error}"[:300]) from error


def _name(kind: object) -> str:
    return getattr(kind, "__name__", None) or str(kind)


@cache
def _converter() -> Converter:
    """Return what takes values apart and puts them together; it learns each dataclass once."""
    made = Converter(detailed_validation=False, forbid_extra_keys=True)
    for plain in (bool, int, str, bytes, _NONE):
        made.register_structure_hook(plain, _exactly(plain))
    made.register_structure_hook(float, _float)
    made.register_unstructure_hook(float, _plain_float)
    made.register_structure_hook(Fraction, lambda pair, _: Fraction(*_integers(pair, 2)))
    made.register_unstructure_hook(Fraction, lambda number: [number.numerator, number.denominator])
    made.register_structure_hook(Program, lambda data, _: Program.from_bytes(_bytes(data), _MOST_VARIABLES))
    made.register_unstructure_hook(Program, Program.to_bytes)
    made.register_structure_hook_func(_is(Hashable), lambda tree, _: _frozen(tree))
    made.register_unstructure_hook_func(_is(Hashable), lambda value: value)
    made.register_structure_hook_func(_is_model, lambda data, kind: decode(_bytes(data), kind))
    made.register_unstructure_hook_func(_is_model, encode)
    made.register_structure_hook_func(_is_array, lambda tree, _: _array(tree))
    made.register_unstructure_hook_func(_is_array, _array_tree)
    made.register_structure_hook_func(_has_origin(Literal), _literal)
    for is_kind, read, write in (
        (_is_tuple, _tuple_reader, _tuple_writer),
        (_is_sequence, _sequence_reader, _sequence_writer),
        (_is_set, _set_reader, _set_writer),
        (_is_mapping, _mapping_reader, _mapping_writer),
        (_is_union, _union_reader, _union_writer),
    ):
        made.register_structure_hook_factory(is_kind, _made_with(made, read))
        made.register_unstructure_hook_factory(is_kind, _made_with(made, write))
    return made


_Read = Callable[[Any, Any], Any]
_Write = Callable[[Any], Any]


def _made_with(converter: Converter, make: Callable[[Converter, Any], Any]) -> Callable[[Any], Any]:
    return lambda kind: make(converter, kind)


# -------------------------------------------------------------------------------------------------- which types


def _is(kind: object) -> Callable[[Any], bool]:
    return lambda other: other is kind


def _has_origin(origin: object) -> Callable[[Any], bool]:
    return lambda kind: get_origin(kind) is origin


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Frozen)


def _is_array(kind: Any) -> bool:
    return kind is np.ndarray or get_origin(kind) is np.ndarray


def _is_tuple(kind: Any) -> bool:
    return get_origin(kind) is tuple


def _is_sequence(kind: Any) -> bool:
    return get_origin(kind) in (AnySequence, list)


def _is_set(kind: Any) -> bool:
    return get_origin(kind) in (frozenset, Set)


def _is_mapping(kind: Any) -> bool:
    return get_origin(kind) in (Mapping, dict)


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType)


# --------------------------------------------------------------------------------------------------- plain values


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise ValueError(sentence)


def _exactly(kind: type) -> _Read:
    def read(value: Any, _: Any) -> Any:
        _require(type(value) is kind, f"{type(value).__name__} was found where {kind.__name__} was expected")
        return value

    return read


def _float(value: Any, _: Any) -> float:
    """Return a number; a whole one stands for itself where floats are expected, as in Python."""
    _require(type(value) in (float, int), f"{type(value).__name__} was found where a number was expected")
    return cast(float, value)


def _plain_float(value: Any) -> Any:
    return float(value) if isinstance(value, float) else value


def _bytes(value: Any) -> bytes:
    _require(type(value) is bytes, f"{type(value).__name__} was found where bytes were expected")
    return cast(bytes, value)


def _list(value: Any, length: int | None = None) -> list[Any]:
    _require(type(value) is list, f"{type(value).__name__} was found where a sequence was expected")
    _require(length is None or len(value) == length, f"{len(value)} items were found where {length} were expected")
    return cast(list[Any], value)


def _integers(value: Any, count: int) -> list[int]:
    numbers = _list(value, count)
    _require(all(type(number) is int for number in numbers), "whole numbers were expected")
    return numbers


def _frozen(tree: Any) -> Hashable:
    """Return nested sequences as tuples."""
    if type(tree) is list:
        return tuple(map(_frozen, tree))
    _require(tree is None or type(tree) in (bool, int, float, str, bytes), "a map was found among plain values")
    return cast(Hashable, tree)


def _literal(value: Any, kind: Any) -> Any:
    choices = get_args(kind)
    _require(
        any(value == choice and type(value) is type(choice) for choice in choices),
        f"{value!r:.80} is none of {choices}",
    )
    return value


# -------------------------------------------------------------------------------------------------------- arrays


def _array_tree(array: AnyArray) -> list[Any]:
    """Return type, shape, whether columns come first, and bytes; little endian. Sums depend on the order of axes."""
    dtype = array.dtype.str[1:]
    if dtype not in _DTYPES or array.ndim > MAX_DIMENSIONS:  # a type's name takes as long as the rest
        raise ValueError(f"an array of {array.dtype}, {array.ndim} dimensions")
    by_columns = array.flags.f_contiguous and not array.flags.c_contiguous
    little = np.asarray(array, array.dtype.newbyteorder("<"))
    return [dtype, list(array.shape), by_columns, little.tobytes("F" if by_columns else "C")]


def _array(tree: Any) -> AnyArray:
    dtype, shape, by_columns, data = _list(tree, 4)
    _require(type(dtype) is str and dtype in _DTYPES, "an array is of a type that is not allowed")
    sizes = _integers(shape, len(_list(shape)))
    _require(len(sizes) <= MAX_DIMENSIONS and all(size >= 0 for size in sizes), "an array has no proper shape")
    _require(type(by_columns) is bool, "an array does not say in which order it is")
    count = math.prod(sizes)
    _require(len(_bytes(data)) == count * int(dtype[1]), f"an array of shape {sizes} has {len(data)} bytes")
    _require(dtype != "b1" or max(data, default=0) <= 1, "an array of truth values holds others")
    numbers: AnyArray = np.frombuffer(data, "<" + dtype).astype(dtype)
    return numbers.reshape(sizes, order="F" if by_columns else "C")


# ---------------------------------------------------------------------------------------------- values with parts


def _tuple_reader(converter: Converter, kind: Any) -> _Read:
    parts = get_args(kind)
    if len(parts) == 2 and parts[1] is Ellipsis:
        part, read = parts[0], converter.get_structure_hook(parts[0])
        return lambda tree, _: tuple([read(item, part) for item in _list(tree)])
    parts = () if parts == ((),) else parts
    reads = [converter.get_structure_hook(part) for part in parts]
    return lambda tree, _: tuple(
        [read(item, part) for read, item, part in zip(reads, _list(tree, len(reads)), parts, strict=True)]
    )


def _tuple_writer(converter: Converter, kind: Any) -> _Write:
    parts = get_args(kind)
    if len(parts) == 2 and parts[1] is Ellipsis:
        write = converter.get_unstructure_hook(parts[0])
        return lambda value: [write(item) for item in value]
    writes = [converter.get_unstructure_hook(part) for part in (() if parts == ((),) else parts)]
    return lambda value: [write(item) for write, item in zip(writes, value, strict=True)]


def _sequence_reader(converter: Converter, kind: Any) -> _Read:
    (part,) = get_args(kind)
    read, made = converter.get_structure_hook(part), list if get_origin(kind) is list else tuple
    return lambda tree, _: made([read(item, part) for item in _list(tree)])


def _sequence_writer(converter: Converter, kind: Any) -> _Write:
    write = converter.get_unstructure_hook(get_args(kind)[0])
    return lambda value: [write(item) for item in value]


def _set_reader(converter: Converter, kind: Any) -> _Read:
    (part,) = get_args(kind)
    read = converter.get_structure_hook(part)

    def made(tree: Any, _: Any) -> Any:
        items = [read(item, part) for item in _list(tree)]
        _require(len(set(items)) == len(items), "a set has an item twice")
        return frozenset(items)

    return made


def _set_writer(converter: Converter, kind: Any) -> _Write:
    write = converter.get_unstructure_hook(get_args(kind)[0])
    return lambda value: [write(item) for item in sorted(value)]


def _mapping_reader(converter: Converter, kind: Any) -> _Read:
    key, item = get_args(kind)
    read_key, read_item = converter.get_structure_hook(key), converter.get_structure_hook(item)

    def made(tree: Any, _: Any) -> Any:
        pairs = [_list(pair, 2) for pair in _list(tree)]
        mapping = {read_key(name, key): read_item(value, item) for name, value in pairs}
        _require(len(mapping) == len(pairs), "a mapping has a key twice")
        return mapping

    return made


def _mapping_writer(converter: Converter, kind: Any) -> _Write:
    key, item = get_args(kind)
    write_key, write_item = converter.get_unstructure_hook(key), converter.get_unstructure_hook(item)
    return lambda value: [[write_key(name), write_item(value)] for name, value in value.items()]


def _union_reader(converter: Converter, kind: Any) -> _Read:
    members, others = _members(kind)
    reads = [converter.get_structure_hook(member) for member in members]

    def made(tree: Any, _: Any) -> Any:
        if tree is None and _NONE in others:
            return None
        if len(members) == 1:
            return reads[0](tree, members[0])
        number, value = _list(tree, 2)
        _require(type(number) is int and 0 <= number < len(members), f"{number!r:.20} is no member of {kind}")
        return reads[number](value, members[number])

    return made


def _union_writer(converter: Converter, kind: Any) -> _Write:
    members, _ = _members(kind)
    writes = [converter.get_unstructure_hook(member) for member in members]
    classes = [_class_of(member) for member in members]

    def made(value: Any) -> Any:
        if value is None:
            return None
        if len(members) == 1:
            return writes[0](value)
        number = next((place for place, one in enumerate(classes) if isinstance(value, one)), -1)
        _require(number >= 0, f"{type(value).__name__} is no member of {kind}")
        return [number, writes[number](value)]

    return made


def _members(kind: Any) -> tuple[list[Any], list[Any]]:
    """Return the members of a union but for None, which stands for itself, and None if it is one."""
    members = get_args(kind)
    return [member for member in members if member is not _NONE], [member for member in members if member is _NONE]


def _class_of(kind: Any) -> Any:
    return get_origin(kind) or (kind if isinstance(kind, type) or is_dataclass(kind) else object)
