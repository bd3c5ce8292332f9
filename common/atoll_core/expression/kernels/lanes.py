"""Operations on one block of rows: each loads 16 float64 numbers into vector registers, computes, and stores them.

A compiled operation is a few vector instructions that this module emits directly. A loop over 16 numbers would need a
proof that its arrays do not overlap before it is vectorised. An interpreted operation (``NUMBA_DISABLE_JIT=1``) is
numpy on views, with the same bits. A *place* is a reference to 16 numbers in an array: an address when compiled, a view
when interpreted. Each lane uses only IEEE 754 + - * / and square roots. `total` adds the lanes in one fixed tree. No
bounds are checked.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from atoll_core.compilation.jit import IS_COMPILED, cgutils, intrinsic, types

LANES: Final = 16
"""Rows in a block."""

CHUNK: Final = 32
"""Numbers that `move`, `blend` and `differing` process in a few instructions: the list length of preset ``paper``."""


def square_root(x: Any) -> Any:
    """Return the square roots of a block in `lane_operation`."""
    return np.sqrt(x) if isinstance(x, np.ndarray) else x.root()


def _lane_operation(function: Callable[..., Any], *, onto: bool = False, ignored: int = 0) -> Any:
    """Return the operation ``out = function(a, ...)`` on places.

    Args:
        function: computes with + - * /, `abs`, `square_root` and literal numbers.
        onto: whether the first argument of `function` is the content of `out`.
        ignored: the number of further arguments that the operation accepts and ignores, so that all operations can be
            called in the same way.
    """
    count = function.__code__.co_argcount

    def apply(out: Any, *arguments: Any) -> None:
        blocks = (out, *arguments) if onto else arguments
        out[...] = function(*blocks[:count])

    return apply


def _place(array: Any, row: int, start: int) -> Any:
    """Return the place of the LANES numbers in array[row, start:]; `array` is C-contiguous."""
    return array[row, start : start + LANES]


def _place_in(array: Any, start: int) -> Any:
    """Return the place of the LANES numbers in array[start:]; `array` is one-dimensional."""
    return array[start : start + LANES]


def _fill(out: Any, x: float) -> None:
    out[...] = x


def _copy(out: Any, a: Any) -> None:
    out[...] = a


def _add_scaled(out: Any, factor: float, a: Any) -> None:
    out[...] = out + factor * a


def _centre(out: Any, a: Any, mean: float, mask: Any) -> None:
    out[...] = (a - mean) * mask


def _total(a: Any, b: Any) -> float:
    x = a * b
    x = x[:8] + x[8:]
    x = x[:4] + x[4:]
    return float((x[0] + x[2]) + (x[1] + x[3]))


def _total_magnitude(a: Any, b: Any) -> float:
    return _total(np.abs(a), b)


def _move(out: Any, p: int, source: Any, q: int, first: int, last: int) -> None:
    """Copy source[q, first:last] to out[p, first:last]; both arrays are C-contiguous and have the same type."""
    out[p, first:last] = source[q, first:last]


def _blend(out: Any, p: int, one: Any, i: int, other: Any, j: int, start: int, cut: int) -> None:
    """Write CHUNK numbers to out[p, start:]: from one[i] before index `cut`, from other[j] at `cut` and after it."""
    middle = min(max(cut, start), start + CHUNK)
    out[p, start:middle] = one[i, start:middle]
    out[p, middle : start + CHUNK] = other[j, middle : start + CHUNK]


def _differing(one: Any, p: int, other: Any, q: int, start: int) -> np.uint64:
    """Compare the bits of CHUNK numbers from `start` on in one[p] and other[q]; bit k is set where number k differs."""
    width = f"u{one.dtype.itemsize}"
    a, b = one[p, start : start + CHUNK].view(width), other[q, start : start + CHUNK].view(width)
    return np.uint64(sum(1 << int(k) for k in np.flatnonzero(a != b)))


def _get(a: Any, k: int) -> float:
    return a[k]  # type: ignore[no-any-return]


def _put(out: Any, k: int, x: float) -> None:
    out[k] = x


def _lowest_bit(x: int) -> int:
    return (int(x) & -int(x)).bit_length() - 1


def _highest_bit(x: int) -> int:
    return int(x).bit_length() - 1


if IS_COMPILED:
    from llvmlite import ir

    _DOUBLE = ir.DoubleType()
    _WORD = ir.IntType(64)
    _VECTOR = ir.VectorType(_DOUBLE, LANES)
    _NUMBERS = {"p": types.int64, "i": types.int64, "x": types.float64}

    def _load(builder: Any, place: Any) -> Any:
        return builder.load(builder.inttoptr(place, _VECTOR.as_pointer()), align=8)

    def _store(builder: Any, value: Any, place: Any) -> None:
        builder.store(value, builder.inttoptr(place, _VECTOR.as_pointer()), align=8)

    def _splat(builder: Any, x: Any) -> Any:
        single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), x, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
        return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), zeros)

    def _half(builder: Any, x: Any, first: int, count: int) -> Any:
        kind = ir.VectorType(ir.IntType(32), count)
        index = ir.Constant(kind, [ir.Constant(ir.IntType(32), first + k) for k in range(count)])
        return builder.shuffle_vector(x, ir.Constant(x.type, ir.Undefined), index)

    def _tree(builder: Any, x: Any) -> Any:
        x = builder.fadd(_half(builder, x, 0, 8), _half(builder, x, 8, 8))
        x = builder.fadd(_half(builder, x, 0, 4), _half(builder, x, 4, 4))
        x = builder.fadd(_half(builder, x, 0, 2), _half(builder, x, 2, 2))
        zero, one = ir.Constant(ir.IntType(32), 0), ir.Constant(ir.IntType(32), 1)
        return builder.fadd(builder.extract_element(x, zero), builder.extract_element(x, one))

    def _library(builder: Any, name: str, x: Any) -> Any:
        full_name = f"llvm.{name}.v{LANES}f64"
        function = builder.module.globals.get(full_name)
        if function is None:
            function = ir.Function(builder.module, ir.FunctionType(x.type, [x.type]), full_name)
        return builder.call(function, [x])

    def _constant(number: float) -> Any:
        return ir.Constant(_VECTOR, [ir.Constant(_DOUBLE, number)] * LANES)

    class _Registers:
        """A block in vector registers; its arithmetic operators emit instructions."""

        def __init__(self, builder: Any, value: Any) -> None:
            self._builder = builder
            self.value = value

        def _made(self, name: str, *values: Any) -> "_Registers":
            return _Registers(self._builder, getattr(self._builder, name)(*values))

        def __add__(self, other: "_Registers") -> "_Registers":
            return self._made("fadd", self.value, other.value)

        def __sub__(self, other: "_Registers") -> "_Registers":
            return self._made("fsub", self.value, other.value)

        def __mul__(self, other: "_Registers") -> "_Registers":
            return self._made("fmul", self.value, other.value)

        def __truediv__(self, other: "_Registers") -> "_Registers":
            return self._made("fdiv", self.value, other.value)

        def __rtruediv__(self, number: float) -> "_Registers":
            return self._made("fdiv", _constant(number), self.value)

        def __neg__(self) -> "_Registers":
            return self._made("fneg", self.value)

        def __abs__(self) -> "_Registers":
            return _Registers(self._builder, _library(self._builder, "fabs", self.value))

        def root(self) -> "_Registers":
            return _Registers(self._builder, _library(self._builder, "sqrt", self.value))

    def lane_operation(function: Callable[..., Any], *, onto: bool = False, ignored: int = 0) -> Any:
        count = function.__code__.co_argcount  # see `_lane_operation`

        def emit(builder: Any, arguments: tuple[Any, ...]) -> None:
            blocks = arguments if onto else arguments[1:]
            value = function(*(_Registers(builder, _load(builder, place)) for place in blocks[:count])).value
            _store(builder, value, arguments[0])

        return _operation("p" * (count + ignored + (not onto)), types.void, emit)

    def _signature(kinds: str, result: Any) -> Any:
        return result(*(_NUMBERS[kind] for kind in kinds))

    def _operation(kinds: str, result: Any, emit: Callable[[Any, tuple[Any, ...]], Any]) -> Any:
        """Return the intrinsic whose code `emit` writes; argument `kinds`: p (place), i (index), x (number)."""
        signature = _signature(kinds, result)

        def generate(context: Any, builder: Any, _: Any, arguments: tuple[Any, ...]) -> Any:
            value = emit(builder, arguments)
            return context.get_dummy_value() if value is None else value

        def typed_2(typing: Any, a: Any, b: Any) -> Any:
            return signature, generate

        def typed_3(typing: Any, a: Any, b: Any, c: Any) -> Any:
            return signature, generate

        def typed_4(typing: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
            return signature, generate

        def typed_7(typing: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any) -> Any:
            return signature, generate

        typed: dict[int, Callable[..., Any]] = {2: typed_2, 3: typed_3, 4: typed_4, 7: typed_7}
        return intrinsic(typed[len(kinds)])

    def _unary(function: Callable[[Any, Any], Any]) -> Any:
        """Return the operation ``out = function(a)`` on places."""

        def emit(builder: Any, arguments: tuple[Any, ...]) -> None:
            out, a = arguments
            _store(builder, function(builder, _load(builder, a)), out)

        return _operation("pp", types.void, emit)

    def _emit_fill(builder: Any, arguments: tuple[Any, ...]) -> None:
        _store(builder, _splat(builder, arguments[1]), arguments[0])

    def _emit_add_scaled(builder: Any, arguments: tuple[Any, ...]) -> None:
        out, factor, a = arguments
        value = builder.fmul(_splat(builder, factor), _load(builder, a))
        _store(builder, builder.fadd(_load(builder, out), value), out)

    def _emit_centre(builder: Any, arguments: tuple[Any, ...]) -> None:
        out, a, mean, mask = arguments
        value = builder.fsub(_load(builder, a), _splat(builder, mean))
        _store(builder, builder.fmul(value, _load(builder, mask)), out)

    def _emit_total(builder: Any, arguments: tuple[Any, ...]) -> Any:
        return _tree(builder, builder.fmul(_load(builder, arguments[0]), _load(builder, arguments[1])))

    def _emit_total_magnitude(builder: Any, arguments: tuple[Any, ...]) -> Any:
        magnitude = _library(builder, "fabs", _load(builder, arguments[0]))
        return _tree(builder, builder.fmul(magnitude, _load(builder, arguments[1])))

    def _pointer(builder: Any, place: Any, k: Any) -> Any:
        return builder.gep(builder.inttoptr(place, _DOUBLE.as_pointer()), [k])

    def _emit_get(builder: Any, arguments: tuple[Any, ...]) -> Any:
        return builder.load(_pointer(builder, *arguments))

    def _emit_put(builder: Any, arguments: tuple[Any, ...]) -> None:
        builder.store(arguments[2], _pointer(builder, *arguments[:2]))

    def _address(context: Any, builder: Any, kind: Any, array: Any, offsets: list[tuple[Any, Any]]) -> Any:
        """Return the address of the number at `offsets`: pairs of an index and its stride in bytes."""
        place = builder.ptrtoint(context.make_array(kind)(context, builder, array).data, _WORD)
        for index, step in offsets:
            place = builder.add(place, builder.mul(index, step))
        return place

    @intrinsic
    def place(typing: Any, array: Any, row: Any, start: Any) -> Any:  # see `_place`
        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            strides = context.make_array(signature.args[0])(context, builder, arguments[0]).strides
            steps = [builder.extract_value(strides, 0), ir.Constant(_WORD, 8)]
            offsets = list(zip(arguments[1:], steps, strict=True))
            return _address(context, builder, signature.args[0], arguments[0], offsets)

        return types.int64(array, types.int64, types.int64), generate

    @intrinsic
    def place_in(typing: Any, array: Any, start: Any) -> Any:  # see `_place_in`
        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            offsets = [(arguments[1], ir.Constant(_WORD, 8))]
            return _address(context, builder, signature.args[0], arguments[0], offsets)

        return types.int64(array, types.int64), generate

    @intrinsic
    def lowest_bit(typing: Any, x: Any) -> Any:  # see `_lowest_bit`
        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

        return types.int64(types.uint64), generate

    @intrinsic
    def highest_bit(typing: Any, x: Any) -> Any:  # see `_highest_bit`
        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            zeros = builder.ctlz(arguments[0], ir.Constant(ir.IntType(1), 1))
            return builder.sub(ir.Constant(_WORD, 63), zeros)

        return types.int64(types.uint64), generate

    @intrinsic
    def call_at(typing: Any, address: Any, operator: Any, count: Any, out: Any, a: Any, b: Any) -> Any:
        """Call the compiled function at `address`, see `atoll_core.compilation.jit.callback`."""

        def generate(context: Any, builder: Any, _: Any, arguments: tuple[Any, ...]) -> Any:
            function = ir.FunctionType(ir.VoidType(), [_WORD] * 5)
            builder.call(builder.inttoptr(arguments[0], function.as_pointer()), arguments[1:])
            return context.get_dummy_value()

        return types.void(*[types.int64] * 6), generate

    def _width(context: Any, kind: Any) -> int:
        """Return the size in bytes of one number in an array of type `kind`."""
        return int(context.get_abi_sizeof(context.get_data_type(kind.dtype)))

    def _bytes_at(context: Any, builder: Any, kind: Any, array: Any, row: Any, start: Any) -> Any:
        """Return a pointer to array[row, start]."""
        strides = context.make_array(kind)(context, builder, array).strides
        steps = ir.Constant(_WORD, _width(context, kind))
        offsets = [(row, builder.extract_value(strides, 0)), (start, steps)]
        address = _address(context, builder, kind, array, offsets)
        return builder.inttoptr(address, ir.IntType(8).as_pointer())

    def _chunk(context: Any, builder: Any, kind: Any, array: Any, row: Any, start: Any) -> tuple[Any, int]:
        """Return a pointer to the CHUNK numbers in array[row, start:], typed as integers, and their width in bytes."""
        width = _width(context, kind)
        pointer = ir.VectorType(ir.IntType(8 * width), CHUNK).as_pointer()
        return builder.bitcast(_bytes_at(context, builder, kind, array, row, start), pointer), width

    @intrinsic
    def blend(typing: Any, out: Any, p: Any, one: Any, i: Any, other: Any, j: Any, start: Any, cut: Any) -> Any:
        """See `_blend`."""

        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            out, p, one, i, other, j, start, cut = arguments
            kinds = signature.args
            target, width = _chunk(context, builder, kinds[0], out, p, start)
            a = builder.load(_chunk(context, builder, kinds[2], one, i, start)[0], align=width)
            b = builder.load(_chunk(context, builder, kinds[4], other, j, start)[0], align=width)
            short = ir.IntType(8)
            before = builder.sub(cut, start)
            none, all_ = ir.Constant(_WORD, 0), ir.Constant(_WORD, CHUNK)
            before = builder.select(builder.icmp_signed("<", before, none), none, before)
            before = builder.select(builder.icmp_signed(">", before, all_), all_, before)
            lanes = ir.VectorType(short, CHUNK)
            single = builder.insert_element(
                ir.Constant(lanes, ir.Undefined), builder.trunc(before, short), ir.Constant(ir.IntType(32), 0)
            )
            zeros = ir.Constant(ir.VectorType(ir.IntType(32), CHUNK), None)
            limit = builder.shuffle_vector(single, ir.Constant(lanes, ir.Undefined), zeros)
            index = ir.Constant(lanes, [ir.Constant(short, k) for k in range(CHUNK)])
            is_first = builder.icmp_unsigned("<", index, limit)
            builder.store(builder.select(is_first, a, b), target, align=width)
            return context.get_dummy_value()

        word = types.int64
        return types.void(out, word, one, word, other, word, word, word), generate

    @intrinsic
    def differing(typing: Any, one: Any, p: Any, other: Any, q: Any, start: Any) -> Any:
        """See `_differing`."""

        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            one, p, other, q, start = arguments
            pointer, width = _chunk(context, builder, signature.args[0], one, p, start)
            a = builder.load(pointer, align=width)
            b = builder.load(_chunk(context, builder, signature.args[2], other, q, start)[0], align=width)
            unequal = builder.icmp_unsigned("!=", a, b)
            return builder.zext(builder.bitcast(unequal, ir.IntType(CHUNK)), _WORD)

        word = types.int64
        return types.uint64(one, word, other, word, word), generate

    @intrinsic
    def move(typing: Any, out: Any, p: Any, source: Any, q: Any, first: Any, last: Any) -> Any:
        """See `_move`."""

        def generate(context: Any, builder: Any, signature: Any, arguments: tuple[Any, ...]) -> Any:
            target, p, origin, q, first, last = arguments
            width = _width(context, signature.args[0])
            to = _bytes_at(context, builder, signature.args[0], target, p, first)
            source = _bytes_at(context, builder, signature.args[2], origin, q, first)
            count = builder.sub(last, first)
            is_chunk = builder.icmp_signed("==", count, ir.Constant(_WORD, CHUNK))
            with builder.if_else(is_chunk) as (whole, part):
                with whole:
                    kind = ir.VectorType(ir.IntType(8 * width), CHUNK).as_pointer()
                    chunk = builder.load(builder.bitcast(source, kind), align=width)
                    builder.store(chunk, builder.bitcast(to, kind), align=width)
                with part:
                    cgutils.raw_memcpy(builder, to, source, count, width)
            return context.get_dummy_value()

        word = types.int64
        return types.void(out, word, source, word, word, word), generate

    fill = _operation("px", types.void, _emit_fill)
    get = _operation("pi", types.float64, _emit_get)
    put = _operation("pix", types.void, _emit_put)
    copy = _unary(lambda builder, a: a)
    add_scaled = _operation("pxp", types.void, _emit_add_scaled)
    centre = _operation("ppxp", types.void, _emit_centre)
    total = _operation("pp", types.float64, _emit_total)
    total_magnitude = _operation("pp", types.float64, _emit_total_magnitude)
else:
    place, place_in = _place, _place_in
    lane_operation = _lane_operation
    fill, copy, get, put, move = _fill, _copy, _get, _put, _move
    add_scaled, centre, total, total_magnitude = _add_scaled, _centre, _total, _total_magnitude
    blend, differing = _blend, _differing
    lowest_bit, highest_bit = _lowest_bit, _highest_bit
