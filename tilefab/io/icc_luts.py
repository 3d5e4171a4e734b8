"""Tables and curves of ICC profiles, read into stages that take and give the 0 to 1 of their encoding.

Sizes are added up from the counts in an element and compared with its bytes before anything is made from them, so a
damaged count costs no memory.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.stages import Curves, Grid, Matrix, Stage
from tilefab.io.icc_tags import damaged

Float64Array = NDArray[np.float64]

MOST_VALUES = 1 << 25
"""Values in the largest grid that is read: 256 MiB as float64."""

FINE_ENTRIES = 65536
_ENTRIES = 4096
_CURVE_TOLERANCE = 1e-5
_FIXED_ONE = 65536.0
_PARAMETERS = (1, 3, 4, 5, 7)
_STRAIGHT = np.array([0.0, 1.0])


@dataclass(frozen=True)
class Element:
    """A tag's bytes, with the names that messages give.

    Attributes
    ----------
    body
        The element, type signature first.
    tag
        Its tag.
    name
        The profile.
    """

    body: bytes = field(repr=False)
    tag: str
    name: str

    @property
    def kind(self) -> str:
        """Type signature, 4 characters."""
        return self.body[:4].decode("latin-1")

    def need(self, end: int, what: str) -> None:
        """Raise `ProfileError` unless the element has ``end`` bytes."""
        if end > len(self.body):
            raise damaged(self.name, self.tag, f"{what} would end at byte {end} of {len(self.body)}")


def read_lut(element: Element, inputs: int, outputs: int, *, xyz_input: bool) -> tuple[Stage, ...]:
    """Stages of a lut8Type, lut16Type, lutAToBType or lutBToAType.

    Parameters
    ----------
    element
        The tag.
    inputs, outputs
        Channels that the profile's header asks for.
    xyz_input
        Whether the inputs are XYZ: only then has the matrix of lut8Type and lut16Type a meaning.

    Raises
    ------
    ProfileError
        If the element is of another type or other channels, cut short, or holds what can't be computed.

    References
    ----------
    ICC.1:2010 sections 10.8 to 10.11; ICC.1:2001-04 sections 6.5.7 and 6.5.8.
    """
    if element.kind not in ("mft1", "mft2", "mAB ", "mBA "):
        raise damaged(element.name, element.tag, f"type {element.kind!r} is no table")
    element.need(32, "its head")
    found = tuple(element.body[8:10])
    if found != (inputs, outputs):
        raise damaged(
            element.name, element.tag, f"goes from {found[0]} to {found[1]} channels, not {inputs} to {outputs}"
        )
    if element.kind in ("mft1", "mft2"):
        stages = _mft(element, inputs, outputs, xyz_input)
    else:
        stages = _lut_a_b(element, inputs, outputs)
    return _without_idle_curves(stages)


def _mft(element: Element, inputs: int, outputs: int, xyz_input: bool) -> list[Stage]:
    wide = element.kind == "mft2"
    nodes = element.body[10]
    start = 52 if wide else 48
    element.need(start, "its head")
    entries_in, entries_out = struct.unpack_from(">2H", element.body, 48) if wide else (256, 256)
    if min(entries_in, entries_out) < 2:
        raise damaged(element.name, element.tag, f"curves of {min(entries_in, entries_out)} entries")
    width = 2 if wide else 1
    grid_at = start + width * entries_in * inputs
    shape = (nodes,) * inputs
    after_at = grid_at + _grid_bytes(element, shape, outputs, width)
    element.need(after_at + width * entries_out * outputs, "its table")
    stages: list[Stage] = []
    matrix = _fixed(element, 12, 9).reshape(3, 3)
    if xyz_input and not np.array_equal(matrix, np.eye(3)):
        stages.append(Matrix(matrix, np.zeros(3)))
    before = _unit_values(element, start, inputs * entries_in, width).reshape(inputs, entries_in)
    after = _unit_values(element, after_at, outputs * entries_out, width).reshape(outputs, entries_out)
    stages.append(Curves(tuple(before)))
    stages.append(_grid(element, grid_at, shape, outputs, width))
    stages.append(Curves(tuple(after)))
    return stages


def _lut_a_b(element: Element, inputs: int, outputs: int) -> list[Stage]:
    """The device's curves are called A, the connection space's B; M and the matrix stand between grid and B."""
    b_at, matrix_at, m_at, grid_at, a_at = struct.unpack_from(">5I", element.body, 12)
    to_pcs = element.kind == "mAB "
    near_device, near_pcs = (inputs, outputs) if to_pcs else (outputs, inputs)
    a_stage = _curves_at(element, a_at, near_device) if a_at else None
    m_stage = _curves_at(element, m_at, near_pcs) if m_at else None
    b_stage = _curves_at(element, b_at, near_pcs) if b_at else None
    matrix = _matrix(element, matrix_at, near_pcs) if matrix_at else None
    grid = _grid_element(element, grid_at, inputs, outputs) if grid_at else None
    if grid is None and inputs != outputs:
        raise damaged(element.name, element.tag, f"no grid from {inputs} to {outputs} channels")
    order: tuple[Stage | None, ...] = (a_stage, grid, m_stage, matrix, b_stage)
    stages = [stage for stage in (order if to_pcs else order[::-1]) if stage is not None]
    if not stages:
        raise damaged(element.name, element.tag, "neither curves nor a grid")
    return stages


def _grid_bytes(element: Element, shape: tuple[int, ...], outputs: int, width: int) -> int:
    """Bytes of a grid's values, which may be more than there are, but no more than can be handled."""
    if min(shape) < 2:
        raise damaged(element.name, element.tag, f"a grid with {min(shape)} nodes on an axis")
    values = math.prod(shape) * outputs
    if values > MOST_VALUES:
        raise damaged(element.name, element.tag, f"a grid of {values:.3g} values, above {MOST_VALUES}")
    return values * width


def _grid(element: Element, at: int, shape: tuple[int, ...], outputs: int, width: int) -> Grid:
    element.need(at + _grid_bytes(element, shape, outputs, width), "its grid")
    values = _unit_values(element, at, math.prod(shape) * outputs, width)
    return Grid(values.reshape(*shape, outputs))


def _grid_element(element: Element, at: int, inputs: int, outputs: int) -> Grid:
    element.need(at + 20, "its grid")
    width = element.body[at + 16]
    if width not in (1, 2):
        raise damaged(element.name, element.tag, f"grid values of {width} bytes")
    return _grid(element, at + 20, tuple(element.body[at : at + inputs]), outputs, width)


def _matrix(element: Element, at: int, channels: int) -> Matrix:
    if channels != 3:
        raise damaged(element.name, element.tag, f"a matrix for {channels} channels")
    numbers = _fixed(element, at, 12)
    return Matrix(numbers[:9].reshape(3, 3), numbers[9:])


def _curves_at(element: Element, at: int, channels: int) -> Curves:
    curves = []
    for _ in range(channels):
        curve, end = read_curve(element, at)
        curves.append(curve)
        at = -(-end // 4) * 4
    return Curves(tuple(curves))


def _unit_values(element: Element, at: int, count: int, width: int) -> Float64Array:
    element.need(at + count * width, "its values")
    codes = np.frombuffer(element.body, dtype=f">u{width}", count=count, offset=at)
    return np.asarray(codes / (255.0 if width == 1 else 65535.0), dtype=np.float64)


def _fixed(element: Element, at: int, count: int) -> Float64Array:
    """s15Fixed16 numbers."""
    element.need(at + 4 * count, "its numbers")
    codes = np.frombuffer(element.body, dtype=">i4", count=count, offset=at)
    return np.asarray(codes / _FIXED_ONE, dtype=np.float64)


def read_curve(element: Element, at: int = 0) -> tuple[Float64Array, int]:
    """A curveType or parametricCurveType at ``at``: its values at even steps, 0 to 1, and where it ends.

    A formula is sampled at 4,096 steps, and at every 16-bit code where straight lines between those would be off by
    more than 1e-5.

    Raises
    ------
    ProfileError
        If it is neither, is cut short, or its formula has no value somewhere.

    References
    ----------
    ICC.1:2010 sections 10.5 (curveType) and 10.15 (parametricCurveType).
    """
    element.need(at + 12, "a curve")
    kind = element.body[at : at + 4]
    if kind == b"curv":
        (count,) = struct.unpack_from(">I", element.body, at + 8)
        end = at + 12 + 2 * count
        element.need(end, f"a curve of {count} entries")
        if count == 0:
            return _STRAIGHT, end
        if count > 1:
            return _unit_values(element, at + 12, count, 2), end
        (power,) = struct.unpack_from(">H", element.body, at + 12)
        return _sampled(element, 0, np.array([power / 256.0])), end
    if kind == b"para":
        (form,) = struct.unpack_from(">H", element.body, at + 8)
        if form >= len(_PARAMETERS):
            raise damaged(element.name, element.tag, f"a curve of the unknown formula {form}")
        return _sampled(element, form, _fixed(element, at + 12, _PARAMETERS[form])), at + 12 + 4 * _PARAMETERS[form]
    raise damaged(element.name, element.tag, f"a curve of the unknown type {kind!r}")


def _sampled(element: Element, form: int, numbers: Float64Array) -> Float64Array:
    if form == 0 and numbers[0] == 1.0:
        return _STRAIGHT
    fine = _formula(element, form, numbers, np.linspace(0.0, 1.0, 2 * _ENTRIES - 1))
    even = fine[::2]
    if np.abs(fine[1::2] - 0.5 * (even[1:] + even[:-1])).max() <= _CURVE_TOLERANCE:
        return np.ascontiguousarray(even)
    return _formula(element, form, numbers, np.linspace(0.0, 1.0, FINE_ENTRIES))


def _formula(element: Element, form: int, numbers: Float64Array, x: Float64Array) -> Float64Array:
    """Formulas 0 to 4 of parametricCurveType, clipped to 0 to 1."""
    power, a, b, c, d, e, f = np.concatenate([numbers, np.zeros(7 - len(numbers))])
    if form == 0:
        a, b = 1.0, 0.0
    base = a * x + b
    with np.errstate(all="ignore"):
        curve = np.maximum(base, 0.0) ** power
        if form in (1, 2):
            y = np.where(base >= 0.0, curve, 0.0) + c
        elif form in (3, 4):
            y = np.where(x >= d, curve + e, c * x + f)
        else:
            y = curve
    if not np.isfinite(y).all():
        raise damaged(element.name, element.tag, "a curve whose formula has no value")
    return np.asarray(np.clip(y, 0.0, 1.0), dtype=np.float64)


def _without_idle_curves(stages: list[Stage]) -> tuple[Stage, ...]:
    """Stages without straight curves that stand beside a grid, where they don't even clip."""
    kept = []
    for index, stage in enumerate(stages):
        beside = stages[max(index - 1, 0) : index] + stages[index + 1 : index + 2]
        if not (isinstance(stage, Curves) and _is_straight(stage) and any(isinstance(s, Grid) for s in beside)):
            kept.append(stage)
    return tuple(kept)


def _is_straight(stage: Curves) -> bool:
    return all(np.allclose(curve, np.linspace(0.0, 1.0, len(curve)), rtol=0.0, atol=1e-9) for curve in stage.curves)
