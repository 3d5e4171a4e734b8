"""The typed door to numba: every kernel of the core is compiled through here, with the same options."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def kernel(function: Kernel) -> Kernel:
    """Compile a numeric kernel: no Python objects, the interpreter lock released, the machine code cached.

    Fast-math stays off: kernels must give the same bits on every machine.
    """
    return cast(Kernel, numba.njit(function, cache=True, nogil=True, fastmath=False, error_model="numpy"))
