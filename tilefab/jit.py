"""The typed door to numba: every kernel of the core is compiled through here, with the same options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
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
