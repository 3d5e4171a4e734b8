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
