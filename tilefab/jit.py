"""The typed door to numba: every kernel of the core is compiled through here, with the same options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def kernel(function: Kernel) -> Kernel:
    """Compile a numeric kernel: no Python objects, the interpreter lock released, the machine code cached.

    Fast-math stays off: kernels must give the same bits on every machine.
    """
    return cast(Kernel, numba.njit(function, cache=True, nogil=True, fastmath=False, error_model="numpy"))


def summing_kernel(function: Kernel) -> Kernel:
    """As `kernel`, but long sums may be taken in any order, several terms at once.

    For models and fits only, whose results are rounded far above a last bit; never where print data are made.
    """
    relaxed = {"reassoc", "nsz", "contract"}
    return cast(Kernel, numba.njit(function, cache=True, nogil=True, fastmath=relaxed, error_model="numpy"))


def _copy_elements(_typing: Any, out: Any, to: Any, source: Any, begin: Any, count: Any) -> Any:
    signature = types.void(out, to, source, begin, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        out_type, _, source_type, _, _ = signature.args
        target = context.make_array(out_type)(context, builder, arguments[0])
        origin = context.make_array(source_type)(context, builder, arguments[2])
        cgutils.raw_memcpy(
            builder,
            builder.gep(target.data, [arguments[1]]),
            builder.gep(origin.data, [arguments[3]]),
            arguments[4],
            context.get_abi_sizeof(context.get_value_type(out_type.dtype)),
        )
        return context.get_dummy_value()

    return signature, generate


copy_elements: Callable[[NDArray[Any], int, NDArray[Any], int, int], None] = cast(Any, intrinsic(_copy_elements))
"""``copy_elements(out, to, source, begin, count)``, within kernels only: copy a run between flat arrays of one dtype.

One call of the C library's memcpy; a loop over elements is ten times slower, for numba guards each index. Nothing is
checked: the caller answers for bounds.
"""


_LINE_BYTES = 64
_LANES = 16
_SHORTEST_STREAM_BYTES = 256


def _stream_elements(_typing: Any, out: Any, to: Any, source: Any, begin: Any, count: Any) -> Any:
    signature = types.void(out, to, source, begin, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        out_type, _, source_type, _, _ = signature.args
        target = context.make_array(out_type)(context, builder, arguments[0])
        origin = context.make_array(source_type)(context, builder, arguments[2])
        byte, long = ir.IntType(8), ir.IntType(64)

        def number(value: int) -> Any:
            return ir.Constant(long, value)

        def bytes_at(array: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(array.data, [index]), byte.as_pointer())

        to_bytes, from_bytes = bytes_at(target, arguments[1]), bytes_at(origin, arguments[3])
        size = builder.mul(
            builder.sext(arguments[4], long), number(context.get_abi_sizeof(context.get_value_type(out_type.dtype)))
        )
        with builder.if_else(builder.icmp_signed("<", size, number(_SHORTEST_STREAM_BYTES))) as (short, long_enough):
            with short:
                cgutils.raw_memcpy(builder, to_bytes, from_bytes, size, 1)
            with long_enough:
                head = builder.and_(builder.neg(builder.ptrtoint(to_bytes, long)), number(_LINE_BYTES - 1))
                cgutils.raw_memcpy(builder, to_bytes, from_bytes, head, 1)
                rest = builder.sub(size, head)
                lines = builder.udiv(rest, number(_LINE_BYTES))
                to_line, from_line = builder.gep(to_bytes, [head]), builder.gep(from_bytes, [head])
                lanes = ir.VectorType(byte, _LANES).as_pointer()
                with cgutils.for_range(builder, lines) as loop:
                    at = builder.mul(loop.index, number(_LINE_BYTES))
                    places = [builder.add(at, number(k)) for k in range(0, _LINE_BYTES, _LANES)]
                    parts = [
                        builder.load(builder.bitcast(builder.gep(from_line, [place]), lanes), align=1)
                        for place in places
                    ]
                    for place, part in zip(places, parts, strict=True):
                        store = builder.store(part, builder.bitcast(builder.gep(to_line, [place]), lanes), align=_LANES)
                        store.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)]))
                done = builder.mul(lines, number(_LINE_BYTES))
                tail = builder.sub(rest, done)
                cgutils.raw_memcpy(builder, builder.gep(to_line, [done]), builder.gep(from_line, [done]), tail, 1)
        return context.get_dummy_value()

    return signature, generate


stream_elements: Callable[[NDArray[Any], int, NDArray[Any], int, int], None] = cast(Any, intrinsic(_stream_elements))
"""As `copy_elements`, but written past the processor's cache: for outputs larger than it, which nobody reads at once.

An ordinary store first fetches the line that it overwrites; for long runs that is a third of all traffic. `settle`
must be called before another thread may read what was written.
"""


def _settle(_typing: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate


settle: Callable[[], None] = cast(Any, intrinsic(_settle))
"""``settle()``, within kernels only: everything written by `stream_elements` is in memory for all to see."""


FRACTION_BITS = {16: 16, 32: 23}
"""For the bits of a node: as many bits of a fraction, 1 included; the rest of a 32-bit position is the cell."""

FINISH_SHIFTS = {(16, 8): 24, (16, 16): 16, (32, 16): 38, (32, 32): 23}
"""For the bits of a node and of a result: how far a weighted sum of nodes is shifted down."""


def _sorting_network(count: int) -> list[tuple[int, int]]:
    # Batcher's odd-even merge sort (Knuth, The Art of Computer Programming 3, algorithm 5.2.2M), without branches.
    pairs = []
    run = 1
    while run < count:
        step = run
        while step >= 1:
            for first in range(step % run, count - step, 2 * step):
                pairs += [
                    (place, place + step)
                    for place in range(first, first + min(step, count - first - step))
                    if place // (2 * run) == (place + step) // (2 * run)
                ]
            step //= 2
        run *= 2
    return pairs


def _blend_simplex(
    _typing: Any, image: Any, at: Any, positions: Any, strides: Any, nodes: Any, lanes: Any, out: Any, to: Any
) -> Any:
    signature = types.void(image, at, positions, strides, nodes, lanes, out, to)
    inputs, width = strides.count, lanes.count
    real = isinstance(nodes.dtype, types.Float)
    fraction_bits = FRACTION_BITS[nodes.dtype.bitwidth]
    node_bits, count_bits, out_bits = nodes.dtype.bitwidth, image.dtype.bitwidth, out.dtype.bitwidth

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word, long = ir.IntType(32), ir.IntType(64)
        image_data, position_data, node_data, out_data = (
            context.make_array(signature.args[place])(context, builder, arguments[place]).data for place in (0, 2, 4, 6)
        )
        lane = ir.FloatType() if real else ir.IntType(2 * node_bits)
        vector = ir.VectorType(lane, width)

        def number(value: int) -> Any:
            return ir.Constant(long, value)

        def everywhere(value: Any) -> Any:
            one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(word, 0))
            first = ir.Constant(ir.VectorType(word, width), [0] * width)
            return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), first)

        def nodes_at(place: Any) -> Any:
            stored = ir.VectorType(ir.FloatType() if real else ir.IntType(node_bits), width)
            address = builder.bitcast(builder.gep(node_data, [place]), stored.as_pointer())
            loaded = builder.load(address, align=node_bits // 8)
            return loaded if real else builder.zext(loaded, vector)

        def weighted(weight: Any, place: Any) -> Any:
            if real:
                scale = ir.Constant(ir.FloatType(), 0.5**fraction_bits)
                return builder.fmul(everywhere(builder.fmul(builder.uitofp(weight, lane), scale)), nodes_at(place))
            factor = weight if lane.width == 64 else builder.trunc(weight, lane)
            return builder.mul(everywhere(factor), nodes_at(place))

        # Fraction above, stride below: sorting one number sorts both. Equal fractions share no weight in between.
        keys, place = [], number(0)
        for channel in range(inputs):
            count = builder.load(builder.gep(image_data, [builder.add(arguments[1], number(channel))]))
            if count_bits < 32:
                row = number(channel << count_bits)
                count = builder.load(builder.gep(position_data, [builder.add(builder.zext(count, long), row)]))
            position = builder.zext(count, long)
            stride = builder.extract_value(arguments[3], channel)
            cell = builder.lshr(position, number(fraction_bits + 1))
            place = builder.add(place, builder.mul(cell, stride))
            fraction = builder.and_(position, number((2 << fraction_bits) - 1))
            keys.append(builder.or_(builder.shl(fraction, number(32)), stride))
        for high, low in _sorting_network(inputs):
            ordered = builder.icmp_unsigned(">", keys[high], keys[low])
            keys[high], keys[low] = (
                builder.select(ordered, keys[high], keys[low]),
                builder.select(ordered, keys[low], keys[high]),
            )
        upper = number(1 << fraction_bits)
        total: Any = ir.Constant(vector, [0.0 if real else 0] * width)
        for key in keys:
            lower = builder.lshr(key, number(32))
            total = (builder.fadd if real else builder.add)(total, weighted(builder.sub(upper, lower), place))
            place = builder.add(place, builder.and_(key, number(0xFFFFFFFF)))
            upper = lower
        total = (builder.fadd if real else builder.add)(total, weighted(upper, place))
        if not real:
            shift = FINISH_SHIFTS[node_bits, out_bits]
            half = ir.Constant(vector, [1 << (shift - 1)] * width)
            total = builder.lshr(builder.add(total, half), ir.Constant(vector, [shift] * width))
            total = builder.trunc(total, ir.VectorType(ir.IntType(out_bits), width))
        address = builder.bitcast(builder.gep(out_data, [arguments[7]]), total.type.as_pointer())
        builder.store(total, address, align=out_bits // 8)
        return context.get_dummy_value()

    return signature, generate


blend_simplex: Callable[
    [NDArray[Any], int, NDArray[Any], tuple[int, ...], NDArray[Any], tuple[int, ...], NDArray[Any], int], None
] = cast(Any, intrinsic(_blend_simplex))
"""``blend_simplex(image, at, positions, strides, nodes, lanes, out, to)``, within kernels only: a pixel through a grid.

Flat arrays; ``strides``, a tuple of int64, one for each channel, and ``lanes``, a tuple of as many numbers as results
are computed side by side, tell their lengths to the compiler, which unrolls everything. ``positions`` has a row for
each channel with the position of every count: the cell shifted up by `FRACTION_BITS` + 1, and the fraction; an image of
uint32 holds positions itself. Nodes are uint16 (results uint8 or uint16), uint32 (uint16 or uint32) or float32
(float32); integers are rounded after the shift of `FINISH_SHIFTS`. All lanes are stored, from ``out[to]`` on. Nothing
is checked: the caller answers for bounds and for sums that fit.
"""


SQUARED_LANES = 40
"""How many values `squared_row` compares."""


def _squared_row(_typing: Any, first: Any, at: Any, second: Any, begin: Any) -> Any:
    signature = types.int64(first, at, second, begin)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        short, word = ir.IntType(16), ir.IntType(32)
        starts = [
            builder.gep(
                context.make_array(signature.args[place])(context, builder, arguments[place]).data,
                [arguments[place + 1]],
            )
            for place in (0, 2)
        ]

        def picked(vector: Any, lanes: list[int]) -> Any:
            mask = ir.Constant(ir.VectorType(word, len(lanes)), lanes)
            return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), mask)

        def squares(begin: int, count: int) -> Any:
            # Products of neighbours added at once: what every processor has one instruction for.
            whole = ir.VectorType(short, count)
            values = [
                builder.load(
                    builder.bitcast(builder.gep(start, [ir.Constant(word, begin)]), whole.as_pointer()), align=2
                )
                for start in starts
            ]
            difference = builder.sub(*values)
            wide = ir.VectorType(word, count // 2)
            even = builder.sext(picked(difference, list(range(0, count, 2))), wide)
            odd = builder.sext(picked(difference, list(range(1, count, 2))), wide)
            return builder.add(builder.mul(even, even), builder.mul(odd, odd))

        def halved(vector: Any) -> Any:
            half = vector.type.count // 2
            return builder.add(picked(vector, list(range(half))), picked(vector, list(range(half, 2 * half))))

        total = builder.add(halved(halved(squares(0, 32))), squares(32, 8))
        total = halved(halved(total))
        return builder.zext(builder.extract_element(total, ir.Constant(word, 0)), ir.IntType(64))

    return signature, generate


squared_row: Callable[[NDArray[Any], int, NDArray[Any], int], int] = cast(Any, intrinsic(_squared_row))
"""``squared_row(first, at, second, begin)``, within kernels only: squared differences of 40 values each, added up.

Flat int16 arrays whose differences fit into int16; the sum must stay below 2**31. Eight times as fast as a loop.
"""
