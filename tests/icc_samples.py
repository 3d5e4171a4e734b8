"""Small ICC profiles for tests: of tilefab's own making, and put together element by element."""

from __future__ import annotations

import datetime
import itertools
import struct
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.lut import BackwardTables, ForwardTable, backward_axes
from tilefab.colour.stages import ColourTable, Grid
from tilefab.errors import ProfileError
from tilefab.io.icc import (
    encode_device_link,
    encode_output_profile,
    measurement_text,
    parse_icc_profile,
    require_press_profile,
)
from tilefab.io.icc_elements import assemble, shown_text
from tilefab.io.icc_tables import device_to_pcs, link_table, pcs_to_device, read_table

Float64Array = NDArray[np.float64]

INK_NAMES = ("Blue", "Brown", "Yellow", "Black", "Pink", "Beige", "Green", "White")
TEXT = "CTI3\nsome measurements\n"
DAY = datetime.date(2026, 11, 22)


def small_tables(inks: int, grid: int = 3, back_grid: int = 5) -> tuple[ForwardTable, BackwardTables]:
    """Random tables; no ink is white."""
    draw = np.random.default_rng(inks)
    forward = draw.uniform([20, -40, -40], [95, 40, 40], (grid,) * inks + (3,))
    forward[(0,) * inks] = (100.0, 0.0, 0.0)
    curves = backward_axes(back_grid).curves
    back = draw.random((3, *(back_grid,) * 3, inks))
    ink_curves = np.tile(np.linspace(0.0, 1.0, 256) ** 0.8, (inks, 1))
    gamut = draw.random((back_grid,) * 3)
    return ForwardTable(ink_curves, forward), BackwardTables(curves, back[0], back[1], back[2], gamut)


def small_profile(inks: int, version: int, grid: int = 3, back_grid: int = 5, **changes: object) -> bytes:
    """An output profile of `small_tables`."""
    forward, backward = small_tables(inks, grid, back_grid)
    arguments: dict[str, object] = {
        "white_xyz": (0.797, 0.827, 0.643),
        "black_xyz": (0.02, 0.02, 0.016),
        "description": "A press – near us",
        "copyright_text": "Nobody's",
        "ink_names": INK_NAMES[:inks],
        "measurement_text": TEXT,
        "created": DAY,
        "version": version,
    }
    return encode_output_profile(forward, backward, **(arguments | changes))  # type: ignore[arg-type]


def link_grid(inputs: int, outputs: int, grid: int = 3) -> Float64Array:
    """Random grid of a link."""
    return np.random.default_rng(10 * inputs + outputs).random((grid,) * inputs + (outputs,))


def small_link(inputs: int, outputs: int, version: Literal[2, 4], source: Literal["ink", "rgb"] = "ink") -> bytes:
    """A device link of `link_grid`, its curves square roots."""
    return encode_device_link(
        input_curves=np.tile(np.sqrt(np.linspace(0.0, 1.0, 1024)), (inputs, 1)),
        grid=link_grid(inputs, outputs),
        ink_names_in=() if source == "rgb" else INK_NAMES[:inputs],
        ink_names_out=INK_NAMES[:outputs],
        description="A link",
        copyright_text="Nobody's",
        created=DAY,
        version=version,
        source_space=source,
    )


def make_profile(
    device_class: str, space: str, pcs: str, tags: list[tuple[str, bytes]], version: Literal[2, 4] = 2
) -> bytes:
    """A profile of any elements, with a name."""
    named = [("desc", shown_text("made up", version)), *tags]
    return assemble(named, version=version, device_class=device_class, colour_space=space, pcs=pcs, day=DAY)


def fixed(*values: float) -> bytes:
    """s15Fixed16 numbers."""
    return struct.pack(f">{len(values)}i", *(round(value * 65536.0) for value in values))


def para(form: int, *numbers: float) -> bytes:
    """A parametricCurveType."""
    return b"para" + bytes(4) + struct.pack(">H2x", form) + fixed(*numbers)


def curv(*codes: int) -> bytes:
    """A curveType, padded."""
    body = b"curv" + bytes(4) + struct.pack(">I", len(codes)) + struct.pack(f">{len(codes)}H", *codes)
    return body + bytes(-len(body) % 4)


def lut_mft(
    kind: str, before: NDArray[np.integer], grid: NDArray[np.integer], after: NDArray[np.integer], matrix: Float64Array
) -> bytes:
    """A lut8Type (``mft1``) or lut16Type (``mft2``) of integer codes."""
    word = ">u1" if kind == "mft1" else ">u2"
    head = struct.pack(">4s4x3Bx", kind.encode(), len(before), len(after), grid.shape[0]) + fixed(*matrix.ravel())
    if kind == "mft2":
        head += struct.pack(">2H", before.shape[1], after.shape[1])
    return head + b"".join(part.astype(word).tobytes() for part in (before, grid, after))


def lut_a_b(
    kind: str,
    *,
    channels: tuple[int, int],
    b: bytes = b"",
    matrix: bytes = b"",
    m: bytes = b"",
    grid: NDArray[np.integer] | None = None,
    width: int = 2,
    a: bytes = b"",
) -> bytes:
    """A lutAToBType (``mAB``) or lutBToAType (``mBA``) of whole parts; those left out are absent."""
    clut = b""
    if grid is not None:
        clut = struct.pack("16sB3x", bytes(grid.shape[:-1]), width) + grid.astype(f">u{width}").tobytes()
        clut += bytes(-len(clut) % 4)
    out, places = b"", []
    for part in (b, matrix, m, clut, a):
        places.append(32 + len(out) if part else 0)
        out += part
    return struct.pack(">4s4x2B2x5I", f"{kind} ".encode(), *channels, *places) + out


def fuzz_seeds() -> list[bytes]:
    """Small profiles of every kind, to be damaged: most of their bytes are counts, places and formulas."""
    srgb_curve = para(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    grid = np.arange(24).reshape(2, 2, 2, 3) * 2700
    matrix = fixed(0.9, 0.1, 0.0, 0.0, 0.9, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    every_part = {
        "b": para(0, 2.2) * 3,
        "matrix": matrix,
        "m": srgb_curve * 3,
        "grid": grid,
        "a": curv(0, 9, 65535) * 3,
    }
    both_ways = [
        (tag, lut_a_b(kind, channels=(3, 3), **every_part)) for tag, kind in (("A2B0", "mAB"), ("B2A0", "mBA"))
    ]
    narrow = np.tile(np.arange(256), (3, 1))
    primaries = [
        (tag, b"XYZ \0\0\0\0" + fixed(*xyz)) for tag, xyz in zip(("rXYZ", "gXYZ", "bXYZ"), np.eye(3), strict=True)
    ]
    return [
        small_profile(4, 2, 2, 2),
        small_profile(6, 4, 2, 2),
        small_profile(1, 2, 2, 2),
        small_link(4, 6, 2),
        small_link(3, 4, 4, "rgb"),
        make_profile("mntr", "RGB ", "Lab ", both_ways, version=4),
        make_profile("prtr", "CMY ", "XYZ ", both_ways, version=4),
        make_profile("scnr", "RGB ", "Lab ", [("A2B0", lut_mft("mft1", narrow, grid // 256, narrow, np.eye(3)))]),
        make_profile("mntr", "RGB ", "XYZ ", [*primaries, *((f"{c}TRC", srgb_curve) for c in "rgb")]),
        make_profile("prtr", "GRAY", "Lab ", [("kTRC", curv(0, 20000, 65535))]),
    ]


def exercise(data: bytes) -> int:
    """Read all that a profile may hold, and use it; the number of tables that were sound.

    Nothing but `ProfileError` may come out of reading, and nothing but finite numbers out of a table.
    """
    try:
        profile = parse_icc_profile(data, "some.icc")
    except ProfileError:
        return 0
    tags = ("A2B0", "A2B1", "A2B2", "B2A0", "B2A1", "B2A2", "gamt")
    readers: list[Callable[[], ColourTable]] = [partial(link_table, profile)]
    readers += [partial(read_table, profile, tag) for tag in tags]
    for intent in ("perceptual", "relative", "saturation"):
        readers += [partial(device_to_pcs, profile, intent), partial(pcs_to_device, profile, intent)]
    with suppress(ProfileError):
        require_press_profile(profile)
    with suppress(ProfileError):
        measurement_text(profile)
    sound = 0
    for read in readers:
        try:
            table = read()
        except ProfileError:
            continue
        sound += 1
        channels = 3 if table.source in ("lab", "xyz", "rgb") else profile.channels
        out = table(np.linspace(0.0, 1.0, 4 * channels).reshape(4, channels))
        assert np.isfinite(out).all()
        assert len(out) == 4
    return sound


def multilinear(table: ColourTable, values: Float64Array) -> Float64Array:
    """A table's results with grids interpolated along every axis, as Little CMS does from Lab and ArgyllCMS always."""
    for stage in table.stages:
        values = _multilinear(stage.values, values) if isinstance(stage, Grid) else stage(values)
    return values if table.target in ("lab", "xyz") else np.clip(values, 0.0, 1.0)


def _multilinear(grid: Float64Array, values: Float64Array) -> Float64Array:
    counts = np.array(grid.shape[:-1])
    place = np.clip(values, 0.0, 1.0) * (counts - 1)
    cell = np.minimum(place.astype(np.int64), counts - 2)
    fraction = place - cell
    out = np.zeros((len(values), grid.shape[-1]))
    for corner in itertools.product((0, 1), repeat=len(counts)):
        weight = np.prod(np.where(corner, fraction, 1.0 - fraction), axis=1)
        out += weight[:, np.newaxis] * grid[tuple((cell + corner).T)]
    return out
